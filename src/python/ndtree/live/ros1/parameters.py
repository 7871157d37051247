# SPDX-License-Identifier: BSD-3-Clause
"""Parameters of the node, from the parameter server of ROS 1."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ndtree.base.options import MAP_OPTIONS
from ndtree.live.ros.parameters import CHANGING, ROWS

_ROWS = {row.key: row for row in ROWS}
_OPTIONS = {option.name: option for option in MAP_OPTIONS}


class Parameters:
    """Values of all parameters; those that may change are looked up each time.

    `given`: What the server has for the node.
    `current`: Tells what the server has of a name now.
    `warn`: Called with what is wrong with a value that was set while the node maps; the one of before holds.
    Raises ValueError if there is no parameter of a name, or a value is not of its type or out of its limits.
    """

    def __init__(
        self, given: dict[str, Any], current: Callable[[str, Any], Any], warn: Callable[[str], None]
    ) -> None:
        self._current, self._warn = current, warn
        self._warned: dict[str, Any] = {}
        for name in given:
            if name not in _ROWS and name not in _OPTIONS:
                known = ", ".join(sorted([*_ROWS, *_OPTIONS]))
                raise ValueError(f"~{name}: there is no such parameter, expected one of {known}")
        self._values = {row.key: row.taken(given.get(row.key, row.start)) for row in ROWS}
        self.map_options = {
            name: option.taken(given[name]) for name, option in _OPTIONS.items() if name in given
        }

    def value(self, name: str) -> Any:
        """Of a parameter, as it is now."""
        if name not in CHANGING:
            return self._values[name]
        found = self._current(name, self._values[name])
        try:
            self._values[name] = _ROWS[name].taken(found)
        except ValueError as error:
            if self._warned.get(name) != found:
                self._warned[name] = found
                self._warn(f"{error}; {self._values[name]} holds")
        return self._values[name]
