# SPDX-License-Identifier: BSD-3-Clause
"""What an option is: its flag, its key in a file, its parameter of a node, and what each of them takes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from ndtree._errors import WrongValue
from ndtree.base import checks
from ndtree.base.checks import Check, integer, number, one_of, text, true_or_false

#: Up to where a number of a node may be set, where nothing else is said.
MOST = 1e6
#: Instead of what holds in a command if an option is left out.
MUST_BE_GIVEN = "must be given"


@dataclass(frozen=True)
class Option:
    """A row of the table of options.

    `type`: bool, int, float, str, Path, tuple[float, float]; list[float], which is typed with commas; or the
        words that it may be.
    `without`: What holds if it is left out, in words; behind the default if there is one.
    `of`: The commands that take it, and "node".
    `default`: What the program takes instead; `...` where it must be given.
    `limits`, `node_limits`: The least and the largest value; those of the nodes, where they differ.
    `flags`: Where they are not made of the name, as "--output -o" and "--loops/--no-loops".
    `parameter`: Its name for the nodes if that is another one.
    `but`: Instead of the default, what holds in some commands.
    `role`: What it says in a `Config`: "read", "format" (see `READER_OPTIONS`), "select", "mapping", "map" or
        "kind"; empty if it is none of its words.
    """

    name: str
    type: Any
    help: str
    value: str = ""  # What is typed behind the flag; empty for a switch, and where words say it.
    without: str = ""
    when: str = ""  # When to touch it.
    of: str = ""
    default: Any = None
    unit: str = ""
    limits: tuple[float, float] | None = None
    above: bool = False  # Whether the least value is refused as well.
    flags: str = ""
    repeated: bool = False  # Whether it may be given several times.
    parameter: str = ""
    but: Mapping[str, str] = field(default_factory=dict)
    role: str = ""
    section: str = "log"  # Of a file of a `Config`.
    changes: bool = False  # Whether a node takes another value while it maps.
    node_limits: tuple[float, float] | None = None
    of_node: str = ""  # Its help for the nodes, where it means something else there.
    read_by: tuple[str, ...] = ()  # Refinements of the maps: "evidence", "paper", "fixed", "octomap".

    @property
    def words(self) -> tuple[str, ...]:
        """All that it may be, if they are some words."""
        return self.type if isinstance(self.type, tuple) else ()

    @property
    def flag(self) -> str:
        """Its flag, the longest of them."""
        return max(self.flags.split("/")[0].split(), key=len, default=f"--{self.name.replace('_', '-')}")

    @property
    def placeholder(self) -> str:
        """What is typed behind the flag; empty for a switch."""
        return self.value or "|".join(self.words)

    @property
    def check(self) -> Check:
        """What a value in a file must be."""
        return checks.numbers if self.type == list[float] else self._check_of(self.limits)

    def _check_of(self, limits: tuple[float, float] | None) -> Check:
        one = one_of(*self.words) if self.words else text
        if self.repeated:
            return checks.one_or_more(one)
        low, high = limits or (-math.inf, math.inf)
        of_type: dict[Any, Check] = {
            bool: true_or_false, int: integer(low, high), float: number(low, high, above=self.above),
        }  # fmt: skip
        return of_type.get(self.type, one)

    def require(self, value: Any) -> None:
        """Refuse what is none of its words, or not within its limits; raises WrongValue."""
        given = getattr(value, "item", lambda: value)()  # Of NumPy's numbers, those of Python.
        try:
            if self.words or self.limits:
                self.check(given)
        except ValueError:
            raise WrongValue.of(self.name, f"{given!r}", self.check.expected) from None

    @property
    def expected(self) -> str:
        """What must be typed, in words."""
        if self.words:
            return one_of(*self.words).expected
        return self.check.expected if self.type in (int, float) else self.value or "a value"

    def taken_by(self, command: str) -> bool:
        """Whether a command, or "node", takes it."""
        return command in self.of.split()

    def shown(self, command: str) -> str:
        """What holds in a command if it is left out, with its unit."""
        other = next((said for commands, said in self.but.items() if command in commands.split()), None)
        if other is not None or self.default is ...:
            return other or MUST_BE_GIVEN
        if self.default is None or isinstance(self.default, bool):
            on_or_off = "on" if self.default else "off"
            return self.without or (on_or_off if self.type is bool else "none")
        number = f"{self.default:g}" if isinstance(self.default, float) else str(self.default)
        return f"{number} {self.unit}".strip() + self.without

    # --- Of the nodes, whose parameters always have a value ------------------------------------------

    @property
    def key(self) -> str:
        """Name of the parameter."""
        return self.parameter or self.name

    @property
    def description(self) -> str:
        """What a node says of the parameter; of a command's help not that it is of bags alone."""
        _, of_bags, said = self.help.rpartition("ROS bags: ")
        return self.of_node or (said[:1].upper() + said[1:] if of_bags else said)

    @property
    def kind(self) -> type:
        """Type of the parameter."""
        return self.type if self.type in (bool, int, float) else list if self.repeated else str

    @property
    def start(self) -> Any:
        """Value of the parameter until another one is set; 0, false or empty where nothing is said."""
        return [""] if self.kind is list else self.kind() if self.default is None else self.default

    @property
    def range(self) -> tuple[float, float] | None:
        """From where to where it may be set; None where nothing limits it."""
        limits = self.node_limits or self.limits or (0, MOST)
        if self.kind not in (int, float) or self.role == "map" or limits == (-math.inf, math.inf):
            return None
        low, high = limits
        return min(low, self.start), min(high, MOST)

    def taken(self, value: Any) -> Any:
        """A value that a node takes, where also the one that it starts with stands for nothing.

        Of a list, what is empty or comes again is left out. Raises WrongValue.
        """
        given, expected = value, ""
        if self.repeated:
            some = list(given or ()) if isinstance(given, (list, tuple, type(None))) else [given]
            value = [one for i, one in enumerate(some) if one != "" and one not in some[:i]] or self.start
            expected = "a list of names"
        is_number = self.kind is float and type(value) is int  # As 0 is typed for ROS 1.
        if value == self.start and (type(value) is self.kind or is_number):
            return self.start
        check = self._check_of(self.range)
        try:
            return check(value)
        except ValueError:
            raise WrongValue.of(self.key, given, expected or check.expected) from None
