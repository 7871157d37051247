# SPDX-License-Identifier: BSD-3-Clause
"""A study's jobs, each in a process of its own; what is done stays, whatever becomes of the rest."""

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
from ndtree.base.engines import ProcessEngine
from ndtree.base.files import replaced, require_no_input
from ndtree.base.progress import Progress, no_progress
from ndtree.evaluation.comparison import compare
from ndtree.logs import Log, simulate
from ndtree.maps.kinds import make_map
from ndtree.study.config import ParameterSet, Study, StudyLog
from ndtree.study.results import StudyTable

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
    for file in sorted(one for one in path.rglob("*") if one.is_file()):
        whole.update(f"{file.relative_to(path)}\0{_file_hash(file, file.stat().st_mtime_ns)}\0".encode())
    return whole.hexdigest()


@functools.cache
def _file_hash(path: Path, _written: int) -> str:
    """Each file is read once for all jobs, unless it is written anew meanwhile."""
    content = hashlib.sha256()
    with open(path, "rb") as file:
        while chunk := file.read(_CHUNK):
            content.update(chunk)
    return content.hexdigest()


def run(study: Study, *, processes: int | None = None, progress: Progress | None = None) -> StudyTable:
    """Map each log with each set of parameters, but for those that are done already, and write the results.

    A script calls it below ``if __name__ == "__main__":``, as each job's process reads the script, too.

    Parameters
    ----------
    study : Study
        From `load`.
    processes : int, optional
        This many jobs at once. Left out: one for each processor. Times are best with 1.
    progress : callable, optional
        Called as ``progress(what, done, total)`` with numbers of jobs.

    Returns
    -------
    StudyTable
        A row for each job. In the study's folder there is ``results/HASH.json`` for each that went well, the
        rows as ``table.csv``, ``table.json`` and ``table.md``, and ``truth.png``. The hash is of the log's
        content, the parameters and the version of ndtree: the same study once more maps nothing.

    Raises
    ------
    OSError
        If the folder cannot be written.
    ValueError
        If `processes` is less than 1.
    ImportError
        If the study wants pictures, and matplotlib is not installed; it names the extra.
    """
    if processes is not None and processes < 1:
        raise ValueError(f"processes = {processes}: must be >= 1")
    if study.pictures:
        from ndtree.plot import truth_against_cells  # It names the extra where matplotlib is missing.
    progress = progress or no_progress
    require_no_input(study.output, study.inputs)
    folder = study.output / "results"
    folder.mkdir(parents=True, exist_ok=True)
    jobs = jobs_of(study)
    rows: dict[int, dict[str, Any]] = {}
    open_: list[tuple[int, Job, Path]] = []
    for i, job in enumerate(jobs):
        progress("looking for what is done", i, len(jobs))
        try:
            file = folder / f"{job.key()}.json"
        except OSError as error:
            rows[i] = _failed(f"{error.filename}: {error.strerror}")
            continue
        done = _read(file)
        if done is None:
            open_.append((i, job, file))
        else:
            rows[i] = done
    most = processes or os.cpu_count() or 1
    for i, row in _finished(open_, most):
        rows[i] = row
        progress(jobs[i].name, len(rows), len(jobs))
    table = StudyTable(
        study.file,
        [{"log": job.log.name, "map": job.parameters.name, **rows[i]} for i, job in enumerate(jobs)],
    )
    table.write(study.output)
    for ending in study.pictures if table.done else ():
        truth_against_cells(table.done, study.output / f"truth.{ending}")
    return table


def _read(file: Path) -> dict[str, Any] | None:
    """What a job has written; None if it has not, or what is there is no such thing."""
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
        return found["figures"] if isinstance(found["figures"]["cells"], int) else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _failed(reason: str) -> dict[str, Any]:
    return {"error": " ".join(reason.split())}


def _finished(jobs: list[tuple[int, Job, Path]], most: int) -> Iterator[tuple[int, dict[str, Any]]]:
    """Number and row of each job, as they end. No threads or open files of this process go into theirs."""
    engine = ProcessEngine(most, method="spawn", most_deaths=1)
    try:
        left = {engine.submit(_work, job, file): (number, file) for number, job, file in jobs}
        while left:
            for handle in engine.done_of(left):
                number, file = left.pop(handle)
                yield number, _outcome(engine, handle, file)
    finally:
        engine.close()


def _outcome(engine: ProcessEngine, handle: Any, file: Path) -> dict[str, Any]:
    try:
        engine.result(handle)
    except OSError as error:
        return _failed(f"{error.filename}: {error.strerror}" if error.filename else str(error))
    except Exception as error:
        nothing_said = "not enough memory" if isinstance(error, MemoryError) else type(error).__name__
        return _failed(str(error) or nothing_said)
    row = _read(file)
    return _failed("its results are not to be read") if row is None else row


def _work(job: Job, file: Path) -> None:
    """One job in its own process: the results go into a file, which appears whole or not at all."""
    content = {"version": _core.__version__, "job": job.described(), "figures": job.figures()}
    with replaced(file) as part:
        part.write_text(json.dumps(content, indent=2, allow_nan=False) + "\n", encoding="utf-8")
