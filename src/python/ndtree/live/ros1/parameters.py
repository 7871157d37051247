# SPDX-License-Identifier: BSD-3-Clause
"""Parameters of the node, from the parameter server of ROS 1."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ndtree.base.option import Option
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
                raise ValueError(f"~{name}: there is no such parameter, expected one of {_names()}")
        self._values = {row.key: _checked(row, given.get(row.key, row.start)) for row in ROWS}
        self.map_options = {
            name: _typed(name, option.type, given[name]) for name, option in _OPTIONS.items() if name in given
        }

    def value(self, name: str) -> Any:
        """Of a parameter, as it is now."""
        if name not in CHANGING:
            return self._values[name]
        found = self._current(name, self._values[name])
        try:
            self._values[name] = _checked(_ROWS[name], found)
        except ValueError as error:
            if self._warned.get(name) != found:
                self._warned[name] = found
                self._warn(f"{error}; {self._values[name]} holds")
        return self._values[name]


def _names() -> str:
    return ", ".join(sorted([*_ROWS, *_OPTIONS]))


def _checked(row: Option, value: Any) -> Any:
    if row.kind is list:
        values = [value] if isinstance(value, str) else value
        if not isinstance(values, list) or not all(isinstance(one, str) for one in values):
            raise ValueError(f"~{row.key} = {value}: must be a list of names")
        return values
    value = _typed(row.key, row.kind, value)
    row.require_word(value)
    if row.range is not None and not row.range[0] <= value <= row.range[1]:
        low, high = row.range
        raise ValueError(f"~{row.key} = {value}: must be from {low:g} to {high:g}")
    return value


def _typed(name: str, kind: type, value: Any) -> Any:
    """A value of a type; whole numbers are numbers, but True is none."""
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
        what = {bool: "true or false", int: "a whole number", float: "a number", str: "text"}[kind]
        raise ValueError(f"~{name} = {value}: must be {what}")
    return value
