# SPDX-License-Identifier: BSD-3-Clause
"""The jobs of a study: one log with one set of parameters, known by a hash of all that they depend on."""

from __future__ import annotations

import functools
import hashlib
import json
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ndtree._native import _core
from ndtree.evaluation.comparison import compare
from ndtree.logs import Log, simulate
from ndtree.maps.kinds import make_map
from ndtree.study.config import ParameterSet, Study, StudyLog

#: Counted up when what is written for a job means something else than before.
LAYOUT = 1
_CHUNK = 1 << 22


@dataclass(frozen=True)
class Job:
    """One log with one set of parameters."""

    log: StudyLog
    parameters: ParameterSet
    held_out: int
    repeat: int

    @property
    def name(self) -> str:
        return f"{self.log.name}: {self.parameters.name}"

    def described(self) -> dict[str, Any]:
        """All that the figures depend on, but for the content of files and the version."""
        config = {name: one.value for name, one in self.log.config.values.items()}
        return {
            "log": {"world": self.log.world, "simulating": self.log.simulating, **config},
            "map": {"kind": self.parameters.kind, **self.parameters.options},
            "held_out": self.held_out,
            "repeat": self.repeat,
        }

    def key(self) -> str:
        """The hash under which the figures are kept.

        Raises OSError if a file cannot be read.
        """
        path = self.log.path
        content = None if path is None else content_hash(path)
        beside = {
            name: content_hash(Path(value))
            for name, value in self.log.config.reading.items()
            if isinstance(value, str) and os.path.exists(value)
        }
        parts = [LAYOUT, _core.__version__, content, beside, self.described()]
        return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:24]

    def figures(self) -> dict[str, Any]:
        """Map the log: one row of a `Comparison`, with what was counted of the log."""
        log = opened(self.log)
        config = self.log.config
        kind, options = self.parameters.kind, {**config.options, **self.parameters.options}
        make = functools.partial(make_map, kind, dim=log.dim, **options)
        found = compare(
            log,
            {"map": make},
            held_out=self.held_out,
            repeat=self.repeat,
            max_range=config.max_range,
            no_return=config.no_return,
        )
        row = {key: value for key, value in found["maps"][0].items() if key != "map"}
        about = {key: found[key] for key in ("dim", "scans", "scans_mapped", "beams", "parameters")}
        return {**about, **row}


def jobs_of(study: Study) -> list[Job]:
    """All logs with all sets, the sets of one log after each other."""
    return [Job(log, one, study.held_out, study.repeat) for log in study.logs for one in study.sets]


def opened(log: StudyLog) -> Log:
    """The log, or the part of it that the study wants."""
    if log.path is None:
        return simulate(log.world, **log.simulating)  # type: ignore[arg-type]
    return log.config.read(log.path)


def content_hash(path: Path) -> str:
    """Of a file, or of all files in a folder with their names."""
    if not path.is_dir():
        return _file_hash(path, path.stat().st_mtime_ns)
    whole = hashlib.sha256()
    for file in _files_in(path):
        whole.update(f"{file.relative_to(path)}\0{_file_hash(file, file.stat().st_mtime_ns)}\0".encode())
    return whole.hexdigest()


def _files_in(folder: Path) -> Iterator[Path]:
    yield from sorted(file for file in folder.rglob("*") if file.is_file())


@functools.cache
def _file_hash(path: Path, _written: int) -> str:
    """Each file is read once for all jobs, unless it is written anew meanwhile."""
    content = hashlib.sha256()
    with open(path, "rb") as file:
        while chunk := file.read(_CHUNK):
            content.update(chunk)
    return content.hexdigest()
