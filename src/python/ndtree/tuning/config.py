# SPDX-License-Identifier: BSD-3-Clause
"""How a log is read and mapped: every decision with its source and its reason, and the same as a file."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast

from ndtree._errors import WrongOption, key, marked
from ndtree._native import _core
from ndtree._native._checked import checked
from ndtree._native._core import OccupancyMap
from ndtree.base import checks
from ndtree.base.checks import Check, Table, number, one_of
from ndtree.base.files import begins_with, replaced
from ndtree.base.options import MAP_OPTIONS, OPTIONS
from ndtree.base.scan import COLOR, COLOR_RULE, Scan
from ndtree.base.words import in_full
from ndtree.evaluation.sampling import AUTO
from ndtree.logs import FORMATS, Log, read
from ndtree.logs.core.rules import GIVEN, MEASURED, USUAL, Decision
from ndtree.logs.core.silence import CutOff

if TYPE_CHECKING:  # It loads all that looks into logs.
    from ndtree.tuning.first_look import FirstLook


def _checks(*roles: str) -> dict[str, Check]:
    return {one.name: one.check for one in OPTIONS if one.role in roles}


#: What a log of a file takes: words of `ndtree.read`, of its format, and of `Log.select`; and what any takes.
READING = {**_checks("read"), "format": one_of(*FORMATS)}
OF_FORMATS, SELECTING, MAPPING = map(_checks, ("format", "select", "mapping"))
OF_MAPS = {one.name: one.check for one in MAP_OPTIONS}
#: All words; the last two are decided, and not typed.
WORDS: Mapping[str, Check] = {
    **READING, **OF_FORMATS, **SELECTING, **MAPPING, **OF_MAPS, **_checks("kind"),
    "cut_off": checks.pair_or_none, "believed_range": number(0.0, above=True),
}  # fmt: skip
#: The sections of a file, by word.
_SECTIONS = {
    **{one.name: one.section for one in OPTIONS if one.role},
    **dict.fromkeys(("cut_off", "believed_range"), "sensor"),
}
AnyLog = TypeVar("AnyLog", bound=Log)
#: Ways to say where poses are from: one given takes the place of another that a file says.
_OF_POSES = {"fixed_frame", "odometry", "poses", "trajectory", "still"}


@checked
@dataclass(frozen=True)
class Config:
    """Decisions of how a log is read and mapped, by the words of `read`, `Log.select` and the maps.

    What is not in it is as usual. It does not change while a log is read.

    Parameters
    ----------
    look : FirstLook, optional
        What was measured.
    notes : tuple of str
        What a user should know of how it was decided, a line each.

    Examples
    --------
    >>> from ndtree.tuning.config import Config
    >>> config = Config.of(min_cell_size=0.1, max_range=20.0, no_return="free")
    >>> config.options, config.max_range
    ({'min_cell_size': 0.1}, 20.0)
    """

    values: Mapping[str, Decision] = field(default_factory=dict)
    look: FirstLook | None = field(default=None, compare=False)
    notes: tuple[str, ...] = field(default=(), compare=False)

    @staticmethod
    def of(**given: Any) -> Config:
        """Of values that were given; None is as if left out.

        Raises
        ------
        TypeError
            If there is no such word.
        """
        for name in given:
            if name not in WORDS:
                raise TypeError(f"{name}: no such value, expected one of {', '.join(WORDS)}")
        return Config({name: Decision(value) for name, value in given.items() if value is not None})

    @staticmethod
    def load(path: str | os.PathLike[str]) -> Config:
        """What `save` has written, or who edits it.

        Raises
        ------
        OSError
            If it cannot be read.
        ValueError
            If it is not what it should be: file, key, value, and what was expected.
        """
        file = Path(path)
        whole = checks.parsed(file)
        values: dict[str, Any] = {}
        for section in ("log", "sensor", "map"):
            content = whole.pop(section, {})
            if not isinstance(content, dict):
                raise Table(file, "", {}).wrong(section, content, f"a section [{section}]")
            table = Table(file, section, content)
            values.update(table.take_all({name: WORDS[name] for name in WORDS if _SECTIONS[name] == section}))
            table.finish()
        Table(file, "", whole).finish("[log], [sensor] and [map]")
        values = beside(file, values)
        return Config({name: Decision(value, GIVEN, f"in {file}") for name, value in values.items()})

    def overridden(self, given: Mapping[str, Decision]) -> Config:
        """These values, some of them replaced."""
        left = {
            name: one
            for name, one in self.values.items()
            if not (given.keys() & _OF_POSES and name in _OF_POSES)
        }
        return Config({**left, **given}, self.look, self.notes)

    def get(self, name: str, default: Any = None) -> Any:
        """A value; the default where it is as usual."""
        return self.values[name].value if name in self.values else default

    def _some(self, names: Mapping[str, Check]) -> dict[str, Any]:
        return {name: one.value for name, one in self.values.items() if name in names}

    @property
    def says_poses(self) -> bool:
        """Whether it says where poses are from."""
        return not self.values.keys().isdisjoint(_OF_POSES)

    @property
    def reading(self) -> dict[str, Any]:
        """Words of the log's format."""
        return self._some(OF_FORMATS)

    @property
    def selection(self) -> dict[str, Any]:
        """Words of `Log.select`, as they were given."""
        return self._some(SELECTING)

    @property
    def options(self) -> dict[str, Any]:
        """Options of the map."""
        return self._some(OF_MAPS)

    def new_map(self, dim: int, options: Mapping[str, Any] | None = None) -> OccupancyMap:
        """An empty map of a dimension, with other options in their place if there are some."""
        make: Any = _core.FixedMap if self.get("fixed") else _core.AdaptiveMap
        layers = {COLOR: COLOR_RULE} if self.get("colors") else None
        held = make(dim=dim, layers=layers, **(self.options if options is None else options))
        return cast(OccupancyMap, held)

    @property
    def typed(self) -> list[str]:
        """Options of the map that are not from a file."""
        return [name for name in self.options if not self.values[name].why]

    @property
    def max_range(self) -> float:
        """Longer beams are free up to there [m]; infinite where there is no limit."""
        return float(self.get("max_range", self.get("believed_range", math.inf)))

    @property
    def no_return(self) -> str:
        """What beams without return say: "free", "ignore", or "auto" where that is not decided."""
        return str(self.get("no_return", AUTO))

    def parts(self, dim: int) -> dict[str, Any]:
        """What of a log of a dimension is selected, as for `Log.select`."""
        selection = self.selection
        for name, count in (("box", 2 * dim), ("origin", dim)):
            if name in selection:
                selection[name] = _point(name, selection[name], count)
        if "box" in selection:
            selection["box"] = (selection["box"][:dim], selection["box"][dim:])
        return selection

    def read(self, path: str | os.PathLike[str]) -> Log:
        """Open a log as `ndtree.read`, or the part of it that is selected; raises as that."""
        reading = {name: self.get(name) for name in READING if name in self.values}
        log = self.ruled(read(path, **reading, **self.reading))
        parts = self.parts(log.dim)
        try:
            return log.select(**parts) if parts else log
        except ValueError as error:
            raise WrongOption(marked(error)) from None

    def ruled(self, log: AnyLog) -> AnyLog:
        """An open log, read as this says."""
        changes: dict[str, Any] = {}
        if "max_range" in self.values:
            changes["no_return_range"] = self.get("max_range")
        if "zero_is" in self.values and log.may_be_zero:
            changes["zero_is"] = self.get("zero_is")
        if "cut_off" in self.values:
            changes["cut_off"] = CutOff(*self.get("cut_off")) if self.get("cut_off") else None
        return log.ruled(**changes)

    def usable(self, scan: Scan) -> Scan:
        """A scan without the beams that say nothing: with `no_return` "ignore", those without return."""
        return scan.returned_only() if self.no_return == "ignore" else scan

    @property
    def chosen(self) -> list[str]:
        """Options that were not given and change the map, with their values."""
        if self.look is None:
            return []
        rows = [f"{key('dim')} {self.look.dim}"]
        for name in ("range_sigma", "range_sigma_quadratic", "no_return", "believed_range"):
            one = self.values.get(name, Decision(None))
            if one.source == MEASURED or (one.source == USUAL and name != "no_return"):
                value = in_full(one.value, 6) if isinstance(one.value, float) else one.value
                rows.append(f"{key(name.replace('believed', 'max'))} {value}")
        return rows

    def toml(self) -> str:
        """Text of a file, whose comments say the source of each value and its reason."""
        return "\n".join("\n".join([f"[{name}]", *rows, ""]) for name, rows in self._rows())

    def _rows(self) -> Iterator[tuple[str, list[str]]]:
        for section in ("log", "sensor", "map"):
            rows = [
                f"{name} = {_toml(one.value)}  # {one.source}" + f": {one.why}" * bool(one.why)
                for name, one in self.values.items()
                if _SECTIONS[name] == section
            ]
            if rows:
                yield section, rows

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write `toml` to a file, which appears whole or not at all."""
        values = dict(self.values)
        for name, value in self.reading.items():  # A file is found from everywhere.
            if isinstance(value, str) and os.path.isfile(value):
                values[name] = replace(values[name], value=os.path.abspath(value))
        with replaced(path, lambda target: begins_with(target, rb"\[")) as part:
            part.write_text(replace(self, values=values).toml(), encoding="utf-8")


def _toml(value: Any) -> str:
    if isinstance(value, float) and math.isfinite(value):
        return in_full(value)
    return json.dumps(value, ensure_ascii=False)


def beside(file: Path, values: Mapping[str, Any]) -> dict[str, Any]:
    """Values of a file, in which others are named from where it is."""

    def named(name: str, value: Any) -> Any:
        is_file = name in OF_FORMATS and isinstance(value, str) and (file.parent / value).is_file()
        return str(file.parent / value) if is_file else value

    return {name: named(name, value) for name, value in values.items()}


def _point(name: str, value: Any, count: int) -> list[float]:
    try:
        numbers = [float(one) for one in (value.split(",") if isinstance(value, str) else value)]
    except ValueError:
        numbers = []
    if len(numbers) != count:
        raise WrongOption(f"{key(name)} = {value}: expected {count} numbers with commas between them")
    return numbers
