# SPDX-License-Identifier: BSD-3-Clause
"""The parameters of the nodes: the rows of the table of options that they take."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ndtree._errors import WrongValue, leading_key, marked, spelled
from ndtree.base.options import MAP_OPTIONS, options_of
from ndtree.base.words import numbers_in
from ndtree.live.options import LiveOptions
from ndtree.live.slam import scans_beside
from ndtree.tuning.config import Config

#: All but the maps' options, which stay unset until they are given.
ROWS = tuple(one for one in options_of("node") if one.role != "map")
CHANGING = {row.key for row in ROWS if row.changes}


@dataclass(frozen=True)
class Layer:
    """A grid of cells between two heights [m]."""

    name: str
    low: float
    high: float

    @staticmethod
    def of(text: str) -> Layer:
        """Of NAME:LOW,HIGH; ValueError if it is none."""
        name, _, heights = text.partition(":")
        found = numbers_in(heights)
        low, high = found if len(found) == 2 else (math.nan, math.nan)
        if not (re.fullmatch("[A-Za-z0-9_]+", name) and -math.inf < low < high < math.inf):
            raise WrongValue.of("grid_layers", text, "NAME:LOW,HIGH with heights in m")
        return Layer(name, low, high)


def layers_of(texts: Sequence[str]) -> list[Layer]:
    """Of a list of NAME:LOW,HIGH; ValueError if one is none, or comes twice."""
    layers = [Layer.of(text) for text in dict.fromkeys(texts) if text]
    names = [layer.name for layer in layers]
    if len(set(names)) < len(names):
        raise WrongValue.of("grid_layers", ", ".join(texts), "of different names")
    return layers


def check(name: str, value: Any) -> None:
    """Refuse a value that a parameter cannot have; raises ValueError."""
    for row in ROWS:
        if row.key == name:
            row.taken(value)


def config_of(value: Callable[[str], Any], options: dict[str, Any] | None = None) -> Config:
    """What a user said, of a function that tells the value of a parameter, and of the options of the map.

    A parameter that is at its default leaves what the file says.
    """
    taken = [(row, row.taken(value(row.key))) for row in ROWS]
    given = {row.name: one for row, one in taken if row.role and one != row.start}
    whole = Config.load(value("config")) if value("config") else Config()
    return whole.overridden(Config.of(**given, **(options or {})).values)


def in_parameters(text: str | Exception) -> str:
    """A text of the library with its options named as parameters, without ways that are no parameter's."""
    keys = {one.name: one.key for one in options_of("node")}

    def name_of(option: str) -> str:
        return keys.get(option, option)

    def is_way(line: str) -> bool:
        option = leading_key(line.lstrip())
        return not option or option in keys or option in keys.values()

    lines = filter(is_way, marked(text).split("\n"))
    return "\n".join(spelled(line, name_of, " = ") for line in lines)


def live_options_of(value: Callable[[str], Any]) -> LiveOptions:
    """What a user said of the map, of a function that tells the value of a parameter."""
    said = {row.name: value(row.key) for row in ROWS if row.default is not None or value(row.key)}
    file = value("map_file")
    kept = scans_beside(file) if value("slam") and file else Path(file)
    is_there = bool(file) and kept.exists()
    said["resume"] = (file or "map_file") if value("resume") and (is_there or value("localize")) else None
    return LiveOptions(said)


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
