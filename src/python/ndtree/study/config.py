# SPDX-License-Identifier: BSD-3-Clause
"""What a study's file says: its logs, its sets of parameters, and where the results go."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any

from ndtree.base.checks import Table, list_of, one_of, one_or_more, parsed, text
from ndtree.base.options import option
from ndtree.maps.kinds import KINDS
from ndtree.tuning.config import MAPPING, OF_FORMATS, OF_MAPS, READING, SELECTING, Config, beside

_SIMULATING = {name: option(name).check for name in ("scans", "seed")}
PICTURES = ("png", "pdf", "svg")


@dataclass(frozen=True)
class StudyLog:
    """A log of a study."""

    name: str  # Its own in the study.
    path: Path | None  # The file; None if it is simulated.
    world: str = ""  # The world that is simulated.
    simulating: dict[str, Any] = field(default_factory=dict)  # Keywords of `ndtree.simulate`.
    config: Config = field(default_factory=Config)  # How it is read and mapped.


@dataclass(frozen=True)
class ParameterSet:
    """How each log is mapped once: the kind of the map, and its options."""

    name: str
    kind: str
    options: dict[str, Any]


@dataclass(frozen=True)
class Study:
    """What is mapped, and how often.

    `file`: What it is from.
    `output`: Folder of the results.
    `held_out`: As in `compare`.
    `repeat`: As in `compare`.
    `pictures`: Endings of the pictures.
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
        TOML: tables ``[logs.NAME]`` with ``path`` or ``simulate``, and words of `read`, `Log.select` and
        `compare`, or ``config``, a file of `Config.save`; tables ``[maps.NAME]`` with ``kind`` and the
        options of maps, where a list stands for one map for each of its values; and ``output``,
        ``held_out``, ``repeat`` and ``pictures``.

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
    top = Table(file, "", parsed(file))
    output = top.take("output", text, f"{file.stem}-results")
    held_out, repeat = (
        top.take(one.name, one.check, one.default) for one in map(option, ("held_out", "repeat"))
    )
    if held_out == 1:
        raise top.wrong("held_out", 1, "0, or at least 2: else nothing is left to map")
    pictures = top.take("pictures", list_of(one_of(*PICTURES)), ["png"])
    logs = tuple(_log(name, table, file) for name, table in top.tables("logs"))
    sets = tuple(one for name, table in top.tables("maps") for one in _sets(name, table))
    top.finish()
    return Study(file, file.parent / output, logs, sets, held_out, repeat, tuple(pictures))


def _log(name: str, table: Table, file: Path) -> StudyLog:
    path = table.take("path", text, None)
    world = table.take("simulate", option("world").check, None)
    if (path is None) == (world is None):
        raise ValueError(f"{file}: logs.{name}: expected either path or simulate")
    if world is not None:
        simulating = table.take_all(_SIMULATING)
        config = Config.of(**table.take_all(MAPPING))
        table.finish(*_SIMULATING, *MAPPING, "simulate")
        return StudyLog(name, None, world, simulating, config)
    base = table.take("config", text, None)
    given = Config.of(**beside(file, table.take_all({**READING, **OF_FORMATS, **SELECTING, **MAPPING})))
    table.finish(*READING, *SELECTING, *MAPPING, "path", "config")
    config = given if base is None else Config.load(file.parent / base).overridden(given.values)
    return StudyLog(name, file.parent / path, "", {}, config)


def _sets(name: str, table: Table) -> list[ParameterSet]:
    """A set for each combination of the values in lists."""
    kind = table.take("kind", one_of(*KINDS), name if name in KINDS else "adaptive")
    options = table.take_all({name: one_or_more(check) for name, check in OF_MAPS.items()})
    table.finish("kind", *OF_MAPS)
    varied = {key: value for key, value in options.items() if isinstance(value, list)}
    sets = []
    for values in product(*varied.values()):
        chosen = dict(zip(varied, values))
        label = ", ".join([name, *(f"{key} {value}" for key, value in chosen.items())])
        sets.append(ParameterSet(label, kind, {**options, **chosen}))
    return sets
