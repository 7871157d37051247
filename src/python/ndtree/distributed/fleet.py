# SPDX-License-Identifier: BSD-3-Clause
"""Logs of a fleet into one tiled map, on many machines, bit for bit as one machine makes it."""

from __future__ import annotations

import json
import math
import os
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ndtree._errors import WrongValue
from ndtree._native import _core
from ndtree._native._core import OccupancyMap, pose_matrix
from ndtree.base.progress import Progress
from ndtree.distributed import plan
from ndtree.distributed.blocks import Block
from ndtree.distributed.engines import Engine, engine_of
from ndtree.distributed.plan import run_all
from ndtree.distributed.scans import ScanIndex, StoredScans, index_name, moved, moves_name
from ndtree.distributed.stages import BlockRecord, Job, entries_of, indexed, integrate, prepare
from ndtree.tiles.grid import Tile, TileGrid
from ndtree.tiles.kind import MapKind, with_counters
from ndtree.tiles.manifest import TILES, Manifest, TileEntry, commit, open_manifest, store_bytes, tidy
from ndtree.tiles.order import Sources, named, opened
from ndtree.tiles.resident import Growth
from ndtree.tiles.storage import Storage, storage_of

BLOCK_BEAMS = 50_000_000
BATCH_BEAMS = 250_000
CHECKPOINT_BEAMS = 20_000_000


@dataclass(frozen=True)
class FleetReport:
    """What a run did.

    Attributes
    ----------
    scans, beams : int
        Taken in; each once, however many blocks it crosses.
    refused, ignored : int
        Scans that no map of the kind takes, and beams left out because they did not return.
    tiles, blocks : int
        That were mapped.
    block_beams : int
        Beams over all blocks: those of a scan that crosses several count in each.
    scan_bytes : int
        Of the stored scans.
    bytes_read, written_bytes : int
        Beams that tasks have looked at, and all that was written: scans, states and tiles.
    seconds : float
        From beginning to end [s].
    start_seconds : float
        Of these, until the engine was there [s].
    prepare_seconds, task_seconds, insert_seconds : float
        Sums over all tasks: of reading logs, of blocks, and of these, insertion itself [s].
    state_seconds, store_seconds : float
        Of the time of blocks, what their states took, and the tiles in the end [s].
    engine_seconds : float
        Sum over all tasks, from when the engine got them to when it gave their results, without what they
        took themselves: its scheduling, its messages, and the start of its workers [s].
    cpu_seconds : float
        Processor time of all tasks, and of the thread that called [s]; without the engine's own processes.
    peak_memory : int
        Of the worker that took most, as the system counts it, mapped files included [bytes].
    longest_block_seconds : float
        Of the block that took longest [s]: no number of workers is faster.
    records : list of BlockRecord
        Of each block.
    """

    scans: int
    beams: int
    refused: int
    ignored: int
    tiles: int
    blocks: int
    block_beams: int
    scan_bytes: int
    bytes_read: int
    written_bytes: int
    seconds: float
    start_seconds: float
    prepare_seconds: float
    task_seconds: float
    insert_seconds: float
    state_seconds: float
    store_seconds: float
    engine_seconds: float
    cpu_seconds: float
    peak_memory: int
    longest_block_seconds: float
    workers: int
    records: list[BlockRecord]

    @property
    def idle(self) -> float:
        """Share of the workers' time, once there were any, in which they did nothing, planning included."""
        there = (self.seconds - self.start_seconds) * self.workers
        return max(0.0, 1.0 - (self.prepare_seconds + self.task_seconds) / there)

    def figures(self) -> dict[str, Any]:
        """All but the records, ready for JSON."""
        return {
            **{k: v for k, v in asdict(replace(self, records=[])).items() if k != "records"},
            "idle": self.idle,
        }


def map(
    logs: Sources,
    url: str | os.PathLike[str],
    *,
    engine: str | Engine = "processes",
    like: OccupancyMap | None = None,
    tile_size: float | None = None,
    max_range: float = math.inf,
    no_return: str = "free",
    workers: int | None = None,
    block_beams: int = BLOCK_BEAMS,
    batch_beams: int = BATCH_BEAMS,
    checkpoint_beams: int = CHECKPOINT_BEAMS,
    progress: Progress | None = None,
) -> FleetReport:
    """Map logs into tiles, on an engine.

    The result is, byte for byte, that of inserting all scans into one map in the order of time, those of one
    time in the order of their logs' names, whatever the engine, the number of workers, and how many of them
    die.
    A run that was killed goes on where it was, if it is called in the same way.

    Parameters
    ----------
    logs : path, sequence of paths, or mapping of str to path or callable
        Workers open them: they need paths that they can reach, or functions without arguments that return
        scans. What one file is called is the name of its log; others get one in a mapping.
    url : str or path
        Where the tiled map becomes, and what workers tell each other through: a folder that all of them
        see, or what fsspec knows.
    engine : {"processes", "ray", "dask", "local"}, or Engine
        "processes": of this machine; "local": threads of this process.
    like : OccupancyMap, optional
        A map with the options of the one to make. Left out: an adaptive one of the first log's dimension.
    tile_size : float, optional
        [m]; rounded up to a power of the branching of `max_cell_size`. Left out: 16 of these.
    max_range : float
        As for insert() [m].
    no_return : {"free", "ignore"}
        What a beam without return says: that the space up to its end is free, or nothing.
    workers : int, optional
        Tasks at a time. Left out: what the engine has.
    block_beams : int
        What a worker maps at a time, a block of tiles, is made of at most this many beams, if it is more than
        one tile; the part of each scan that is in it counts. With several workers there are a few for each,
        whose scans are surveyed in every one that they cross.
    batch_beams : int
        Beams in a file of scans.
    checkpoint_beams : int
        A block's state is written whenever it has taken this many in: what a killed worker has to do again.
    progress : callable, optional
        Called as ``progress(what, done, total)``.

    Raises
    ------
    ValueError
        If something of the call is wrong, or of a log; it is named.
    OSError
        If a log, or the folder, cannot be read or written.
    ImportError
        If the engine is not installed; it names the extra.
    """
    times, sources = _Times(), named(logs)
    sizes = {"block_beams": block_beams, "batch_beams": batch_beams, "checkpoint_beams": checkpoint_beams}
    _check(max_range, no_return, sizes)
    target = _core.AdaptiveMap(dim=_dim_of(next(iter(sources.values())))) if like is None else like
    storage = storage_of(url)
    before = _manifest(storage)
    job = replace(_job_of(url, before, target, tile_size), max_range=max_range, no_return=no_return)
    job = replace(job, batch_beams=batch_beams, checkpoint_beams=checkpoint_beams)
    _begin(storage, job, {"logs": _sizes(sources), "block_beams": block_beams})
    made_from = {**_made_from(job, sources), "block_beams": block_beams}
    with _engine(engine, workers, times) as chosen:
        run = _Run(chosen, job, storage, before, progress)
        prepared, at_engine = run.prepare(sources)
        return times.of_all(run.mapped(run.indexes(sources), None, made_from), prepared, at_engine)


def _check(max_range: float, no_return: str, sizes: Mapping[str, int]) -> None:
    if no_return not in ("free", "ignore"):
        raise WrongValue.of("no_return", f"{no_return!r}", "'free' or 'ignore'")
    if not max_range > 0:
        raise WrongValue.of("max_range", f"{max_range:g} m", "> 0")
    for name, value in sizes.items():
        if value < 1:
            raise WrongValue.of(name, value, ">= 1")


def _job_of(
    url: str | os.PathLike[str], before: Manifest | None, like: OccupancyMap, tile_size: float | None
) -> Job:
    revision = before.revision + 1 if before is not None else 1
    kind, grid = MapKind.of(like), TileGrid.of(like, tile_size)
    name = f"run-{revision:06d}"
    return Job(_everywhere(url), name, revision, kind, grid, math.inf, "free", BATCH_BEAMS, CHECKPOINT_BEAMS)


def _made_from(job: Job, logs: Iterable[str]) -> dict[str, Any]:
    """What a manifest says of how its map was made."""
    return {
        "run": job.run,
        "max_range": job.max_range if math.isfinite(job.max_range) else None,
        "no_return": job.no_return,
        "checkpoint_beams": job.checkpoint_beams,
        "moves": {},
        "indexes": {log: index_name(job.run, log) for log in logs},
    }


class _Times:
    """How long a call takes."""

    def __init__(self) -> None:
        self._begin, self._cpu_begin = time.perf_counter(), time.thread_time()
        self.start = 0.0  # Until the engine was there.

    def of(self, report: FleetReport) -> FleetReport:
        """A report of the blocks, with what the call took."""
        return replace(
            report,
            seconds=time.perf_counter() - self._begin,
            start_seconds=self.start,
            cpu_seconds=report.cpu_seconds + time.thread_time() - self._cpu_begin,
        )

    def of_all(self, report: FleetReport, prepared: list[Any], at_engine: float) -> FleetReport:
        """The same, with what reading the logs took."""
        seconds = sum(one.seconds for one in prepared)
        of_blocks = self.of(report)
        return replace(
            of_blocks,
            prepare_seconds=seconds,
            engine_seconds=report.engine_seconds + max(0.0, at_engine - seconds),
            cpu_seconds=of_blocks.cpu_seconds + sum(one.cpu_seconds for one in prepared),
            peak_memory=max(report.peak_memory, *(one.peak_memory for one in prepared)),
            written_bytes=report.written_bytes + report.scan_bytes,
        )


@contextmanager
def _engine(engine: str | Engine, workers: int | None, times: _Times) -> Iterator[Engine]:
    """An engine, which ends with the call that has begun it."""
    begin = time.perf_counter()
    chosen = engine_of(engine, workers)
    times.start = time.perf_counter() - begin
    try:
        yield chosen
    finally:
        if not isinstance(engine, Engine):
            chosen.close()


def remap(
    url: str | os.PathLike[str],
    poses: Mapping[str, Mapping[int, ArrayLike]],
    *,
    engine: str | Engine = "processes",
    workers: int | None = None,
    progress: Progress | None = None,
) -> FleetReport:
    """Move scans of a map that `map` made, as a pose graph says, and map anew what this touches.

    That is all blocks of tiles that the scans crossed, or cross now.

    The result is that of mapping everything anew with scans that were moved by `moved`.

    Parameters
    ----------
    poses : mapping
        Of a log's name and of the number of a scan in it, among those that were taken, to a pose as of
        `OccupancyMap.transformed`: from where its log had it to where it is. Those left out stay.
    engine, workers, progress
        As for `map`.

    Returns
    -------
    FleetReport
        Of what was mapped anew.

    Raises
    ------
    ValueError
        If the map holds no scans, or a log or a number is not known, or a motion is not rigid.
    """
    times = _Times()
    storage = storage_of(url)
    manifest = open_manifest(storage)
    held = manifest.made_from
    if "run" not in held:
        raise ValueError(
            f"{os.fspath(url)}: holds no scans: only what ndtree.distributed.map made can be mapped anew"
        )
    limit = math.inf if held["max_range"] is None else float(held["max_range"])
    job = Job(
        _everywhere(url),
        held["run"],
        manifest.revision + 1,
        manifest.kind,
        manifest.grid,
        limit,
        held["no_return"],
        1,
        int(held["checkpoint_beams"]),
    )
    move = _Moves(storage, job, held)
    for log, of_log in poses.items():
        move.log(log, of_log)
    job = replace(job, moves=tuple(move.moves.items()))
    storage.remove_folder(f"{job.run}/work")  # Of a call that was killed, perhaps with other poses.
    touched = sorted(move.touched, key=lambda block: block.lower)
    with _engine(engine, workers, times) as chosen:
        run = _Run(chosen, job, storage, manifest, progress)
        made_from = {**held, "moves": move.moves, "indexes": move.names}
        return times.of(run.mapped(list(move.indexes.values()), touched, made_from))


class _Moves:
    """Scans that move: their new places are written, and the blocks that they touch are collected."""

    def __init__(self, storage: Storage, job: Job, held: Mapping[str, Any]) -> None:
        self._storage, self._job = storage, job
        self.names, self.moves = dict(held["indexes"]), dict(held["moves"])
        self.indexes = {log: ScanIndex.from_bytes(storage.read(name)) for log, name in self.names.items()}
        self.touched: set[Block] = set()
        self._blocks = [Block.from_json(one["block"]) for one in held["blocks"]]
        self._original = StoredScans(storage, job.run, {})

    def log(self, log: str, poses: Mapping[int, ArrayLike]) -> None:
        """Move scans of a log."""
        if log not in self.indexes:
            raise ValueError(f"log {log!r}: must be one of {', '.join(self.indexes)}")
        job, index = self._job, self.indexes[log]
        motions = _motions(self._storage, self.moves.get(log), len(index.scans), job.kind.dim)
        for number, pose in sorted(poses.items()):
            if not 0 <= number < len(index.scans):
                raise ValueError(f"log {log!r}: scan {number}: there are {len(index.scans)}")
            matrix = pose_matrix(pose, dim=job.kind.dim, name=f"log {log!r}: scan {number}: pose")
            if not np.array_equal(matrix, motions[number]):
                motions[number] = matrix
                self._scan(log, index, number, matrix)
        self.moves[log] = moves_name(job.run, log, job.revision)
        self._storage.write_array(self.moves[log], motions)
        self.names[log] = index_name(job.run, log, job.revision)
        self._storage.write(self.names[log], index.as_bytes())

    def _scan(self, log: str, index: ScanIndex, number: int, matrix: Any) -> None:
        before = index.scans[number]
        at = (before.batch, before.position, before.row)
        scan = self._original.get(log, number, *at, before.beams)
        there = indexed(self._job, moved(scan, matrix), before.time, at)
        index.scans[number] = there
        tiles = {*before.tiles, *there.tiles}
        self.touched.update(block for block in self._blocks if any(tile in block for tile in tiles))


@dataclass(frozen=True)
class _Run:
    """A job, what works on it, and where it lies; `before` is the map that was there."""

    engine: Engine
    job: Job
    storage: Storage
    before: Manifest | None
    progress: Progress | None

    def prepare(self, sources: Mapping[str, Any]) -> tuple[list[Any], float]:
        """Have logs read; what each took, and the engine."""
        tasks = [(prepare, self.job, log, source) for log, source in sources.items()]
        return run_all(self.engine, "reading", tasks, self.progress)

    def indexes(self, logs: Iterable[str]) -> list[ScanIndex]:
        """Of the logs that were read."""
        found = [ScanIndex.from_bytes(self.storage.read(index_name(self.job.run, log))) for log in logs]
        if not any(index.scans for index in found):
            raise ValueError(f"{', '.join(logs)}: no scans, expected at least one")
        return found

    def mapped(
        self, indexes: list[ScanIndex], touched: list[Block] | None, made_from: dict[str, Any]
    ) -> FleetReport:
        """Map blocks, all of space or some, and write the manifest of these and of what else there was."""
        job, storage, before = self.job, self.storage, self.before
        scans = list(plan.in_order(indexes))
        tasks = plan.stored_tasks(storage, job)
        if tasks is None:
            within = [Block.everywhere(job.kind.dim)] if touched is None else touched
            blocks_of = int(made_from["block_beams"])
            plan.store_plan(storage, job, plan.planned(scans, within, self.engine.workers, blocks_of))
            tasks = plan.stored_tasks(storage, job) or []
        records: list[BlockRecord]
        records, at_engine = run_all(
            self.engine, "mapping", [(integrate, job, task) for task in tasks], self.progress
        )
        tiles, blocks = _kept(before, touched)
        for record in records:
            tiles.update(entries_of(record))
            blocks.append({"block": record.block.as_json(), "counters": record.counters})
        frame = store_bytes(storage, self._frame(scans, blocks), f"{TILES}/frame")
        made_from = {**made_from, "blocks": sorted(blocks, key=lambda one: one["block"])}
        manifest = Manifest(job.kind, job.grid, job.revision, frame, tiles, made_from)
        commit(storage, manifest)
        tidy(storage, manifest)
        storage.remove_folder(f"{job.run}/work")
        if before is not None and before.made_from.get("run", job.run) != job.run:
            storage.remove_folder(before.made_from["run"])
        return _report(records, scans, indexes, at_engine, self.engine.workers)

    def _frame(self, scans: list[Any], blocks: list[dict[str, Any]]) -> bytes:
        """The file of an empty map that has grown as one of all scans, with its counters."""
        job = self.job
        growth = Growth(job.kind.new())
        stored = StoredScans(self.storage, job.run, dict(job.moves))
        for ref, scan in scans:
            box = None if scan.box is None else (np.array(scan.box[0]), np.array(scan.box[1]))
            if not growth.contains(box):
                place = (ref.batch, ref.position, ref.row, ref.beams)
                growth.include(stored.get(ref.log, ref.number, *place), job.max_range)
        updates, splits, merges = (sum(one["counters"][i] for one in blocks) for i in range(3))
        return with_counters(growth.map.to_bytes(), updates, splits, merges, len(scans))


def _kept(
    before: Manifest | None, touched: list[Block] | None
) -> tuple[dict[Tile, TileEntry], list[dict[str, Any]]]:
    """Tiles and blocks of a map that are not mapped anew."""
    if touched is None or before is None:
        return {}, []
    tiles = {
        tile: entry for tile, entry in before.tiles.items() if not any(tile in block for block in touched)
    }
    return tiles, [one for one in before.made_from["blocks"] if Block.from_json(one["block"]) not in touched]


#: Of a report, what is a sum over blocks, and what of their records.
_SUMS = {
    "block_beams": "beams", "bytes_read": "bytes_read", "written_bytes": "written_bytes",
    "task_seconds": "seconds", "insert_seconds": "insert_seconds", "state_seconds": "state_seconds",
    "store_seconds": "store_seconds", "cpu_seconds": "cpu_seconds",
}  # fmt: skip


def _report(
    records: list[BlockRecord], scans: list[Any], indexes: list[ScanIndex], at_engine: float, workers: int
) -> FleetReport:
    sums = {name: sum(getattr(record, of) for record in records) for name, of in _SUMS.items()}
    return FleetReport(
        scans=len(scans),
        beams=sum(scan.beams for _, scan in scans),
        refused=sum(index.refused for index in indexes),
        ignored=sum(index.ignored for index in indexes),
        tiles=sum(len(record.entries) for record in records),
        blocks=len(records),
        scan_bytes=sum(index.stored_bytes for index in indexes),
        engine_seconds=max(0.0, at_engine - sums["task_seconds"]),
        peak_memory=max((record.peak_memory for record in records), default=0),
        longest_block_seconds=max((record.seconds for record in records), default=0.0),
        workers=workers,
        records=records,
        **dict.fromkeys(("seconds", "start_seconds", "prepare_seconds"), 0.0),
        **sums,
    )


def _begin(storage: Storage, job: Job, more: dict[str, Any]) -> None:
    """Make the run's folder; one that was begun in another way goes."""
    settings = json.dumps({**asdict(job), **more}, sort_keys=True).encode()
    name = f"{job.run}/settings.json"
    if storage.has(name) and storage.read(name) == settings:
        return
    storage.remove_folder(job.run)
    storage.write(name, settings)


def _everywhere(url: str | os.PathLike[str]) -> str:
    """The URL as workers understand it, whatever their working directory is."""
    text = os.fspath(url)
    return text if "://" in text else os.path.abspath(text)


def _sizes(sources: Mapping[str, Any]) -> dict[str, int]:
    """Of files, so that another file of the same name is told apart."""
    return {
        log: os.path.getsize(source)
        if isinstance(source, (str, os.PathLike)) and os.path.isfile(source)
        else 0
        for log, source in sources.items()
    }


def _manifest(storage: Storage) -> Manifest | None:
    try:
        return open_manifest(storage)
    except FileNotFoundError:
        return None


def _dim_of(source: Any) -> int:
    scans: Iterable[Any] = opened(source)
    dim = getattr(scans, "dim", None)
    if dim is None:
        first = next(iter(scans), None)
        if first is None:
            raise ValueError("the first log: no scans, expected at least one")
        dim = first.dim
    return int(dim)


def _motions(storage: Storage, name: str | None, scans: int, dim: int) -> Any:
    if name is None:
        return np.broadcast_to(np.eye(dim + 1), (scans, dim + 1, dim + 1)).copy()
    return np.array(storage.array(name))
