# SPDX-License-Identifier: BSD-3-Clause
"""What a study's file says: its logs, its sets of parameters, and where the results go."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any

from ndtree.evaluation.comparison import NO_RETURN
from ndtree.logs import FORMATS, READER_OPTIONS
from ndtree.maps.kinds import KINDS, MAP_OPTIONS
from ndtree.study.checks import Check, Table, integer, number, numbers, one_of, text, true_or_false

#: What a log of a file takes besides ``path``: words of `ndtree.read`, and of `Log.select`.
_READING: Mapping[str, Check] = {
    "format": one_of(*FORMATS),
    "dim": one_of(2, 3),
    "keep_going": true_or_false,
    "strict": true_or_false,
}
_SELECTING: Mapping[str, Check] = {
    "every": integer(1),
    "start": number(0.0),
    "stop": number(0.0),
    "min_range": number(0.0),
    "stride": integer(1),
    "box": numbers,
    "origin": numbers,
}
_SIMULATING: Mapping[str, Check] = {"scans": integer(1), "seed": integer(0)}
#: What any log takes: words of `compare`.
_MAPPING: Mapping[str, Check] = {"max_range": number(0.0, above=True), "no_return": one_of(*NO_RETURN)}
_OF_TYPE: Mapping[type, Check] = {
    bool: true_or_false,
    int: integer(-math.inf),
    float: number(-math.inf),
    str: text,
}
PICTURES = ("png", "pdf", "svg")


@dataclass(frozen=True)
class StudyLog:
    """A log of a study.

    Parameters
    ----------
    name : str
        Its own in the study.
    path : Path or None
        The file; None if it is simulated.
    world : str
        The world that is simulated.
    reading, selecting, mapping : dict
        Keywords of `ndtree.read` or `ndtree.simulate`, of `Log.select` and of `compare`.
    """

    name: str
    path: Path | None
    world: str = ""
    reading: dict[str, Any] = field(default_factory=dict)
    selecting: dict[str, Any] = field(default_factory=dict)
    mapping: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class ParameterSet:
    """How each log is mapped once: the kind of the map, and its options."""

    name: str
    kind: str
    options: dict[str, Any]


@dataclass(frozen=True)
class Study:
    """What is mapped, and how often.

    Parameters
    ----------
    file : Path
        What it is from.
    output : Path
        Folder of the results.
    logs : tuple of StudyLog
    sets : tuple of ParameterSet
    held_out : int
        As in `compare`.
    repeat : int
        As in `compare`.
    pictures : tuple of str
        Endings of the pictures.
    """

    file: Path
    output: Path
    logs: tuple[StudyLog, ...]
    sets: tuple[ParameterSet, ...]
    held_out: int
    repeat: int
    pictures: tuple[str, ...]

    @property
    def inputs(self) -> list[Path]:
        """The files and folders that it reads."""
        return [self.file, *(one.path for one in self.logs if one.path is not None)]


def load(path: str | os.PathLike[str]) -> Study:
    """Read a study's file.

    Parameters
    ----------
    path : str or path
        TOML: tables ``[logs.NAME]`` with ``path`` or ``simulate`` and words of `read`, `Log.select` and
        `compare`; tables ``[maps.NAME]`` with ``kind`` and the options of maps, where a list stands for one
        map for each of its values; and ``output``, ``held_out``, ``repeat`` and ``pictures``.

    Raises
    ------
    OSError
        If it cannot be read.
    ValueError
        If it is not what it should be: file, key, value, and what was expected.
    ImportError
        If Python is older than 3.11 and has no tomli.
    """
    file = Path(path)
    top = Table(file, "", _parsed(file))
    output = top.take("output", text, f"{file.stem}-results")
    held_out = top.take("held_out", integer(0), 10)
    if held_out == 1:
        raise top.wrong("held_out", 1, "0, or at least 2: else nothing is left to map")
    repeat = top.take("repeat", integer(1), 1)
    pictures = top.take("pictures", _list_of(one_of(*PICTURES)), ["png"])
    logs = tuple(_log(name, table, file) for name, table in top.tables("logs"))
    sets = tuple(one for name, table in top.tables("maps") for one in _sets(name, table))
    top.finish()
    return Study(file, file.parent / output, logs, sets, held_out, repeat, tuple(pictures))


def _parsed(file: Path) -> dict[str, Any]:
    try:
        import tomllib
    except ModuleNotFoundError:
        try:
            import tomli as tomllib  # type: ignore[no-redef]
        except ImportError:
            raise ImportError(
                "before Python 3.11 ndtree.study needs tomli; "
                "install it with:\n  pip install 'ndtree-mapping[cli]'"
            ) from None
    try:
        with open(file, "rb") as opened:
            return tomllib.load(opened)
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{file}: {error}: expected TOML") from None


def _log(name: str, table: Table, file: Path) -> StudyLog:
    path = table.take("path", text, None)
    world = table.take("simulate", one_of("office", "apartment", "street"), None)
    if (path is None) == (world is None):
        raise ValueError(f"{file}: logs.{name}: expected either path or simulate")
    mapping = table.take_all(_MAPPING)
    if world is not None:
        reading = table.take_all(_SIMULATING)
        table.finish(*_SIMULATING, *_MAPPING, "simulate")
        return StudyLog(name, None, world, reading, {}, mapping)
    formats = {option.name: _OF_TYPE.get(option.type, text) for option in READER_OPTIONS}
    reading = table.take_all({**_READING, **formats})
    for key, value in reading.items():  # Files beside the log are named from where this file is.
        if isinstance(value, str) and key in formats and (file.parent / value).is_file():
            reading[key] = str(file.parent / value)
    selecting = table.take_all(_SELECTING)
    if "box" in selecting:
        half = len(selecting["box"]) // 2
        selecting["box"] = (selecting["box"][:half], selecting["box"][half:])
    table.finish(*_READING, *_SELECTING, *_MAPPING, "path")
    return StudyLog(name, file.parent / path, "", reading, selecting, mapping)


def _sets(name: str, table: Table) -> list[ParameterSet]:
    """A set for each combination of the values in lists."""
    kind = table.take("kind", one_of(*KINDS), name if name in KINDS else "adaptive")
    checks = {option.name: _one_or_more(_OF_TYPE[option.type]) for option in MAP_OPTIONS}
    options = table.take_all(checks)
    table.finish("kind", *checks)
    varied = {key: value for key, value in options.items() if isinstance(value, list)}
    sets = []
    for values in product(*varied.values()):
        chosen = dict(zip(varied, values))
        label = ", ".join([name, *(f"{key} {value}" for key, value in chosen.items())])
        sets.append(ParameterSet(label, kind, {**options, **chosen}))
    return sets


def _list_of(check: Check) -> Check:
    def checked(value: Any) -> list[Any]:
        if not isinstance(value, list):
            raise ValueError(f"a list, each {check.expected}")
        return [check(one) for one in value]

    return Check(checked, f"a list, each {check.expected}")


def _one_or_more(check: Check) -> Check:
    """A value, or several different ones in a list."""

    def checked(value: Any) -> Any:
        if not isinstance(value, list):
            return check(value)
        found = [check(one) for one in value]
        if not found or len(set(found)) != len(found):
            raise ValueError
        return found

    return Check(checked, f"{check.expected}, or a list of different ones")
