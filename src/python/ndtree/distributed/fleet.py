# SPDX-License-Identifier: BSD-3-Clause
"""Logs of a fleet into one tiled map, on many machines, bit for bit as one machine makes it."""

from __future__ import annotations

import io
import json
import math
import os
import time
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ndtree._native import _core
from ndtree._native._core import OccupancyMap, pose_matrix
from ndtree.base.progress import Progress
from ndtree.distributed import plan
from ndtree.distributed.engines import Engine, engine_of
from ndtree.distributed.run import run_all, run_chains
from ndtree.distributed.scans import ScanIndex, StoredScans, index_name, moved, moves_name
from ndtree.distributed.stages import BlockRecord, Job, block_of, entries_of, indexed, prepare
from ndtree.tiles.grid import Tile, TileGrid
from ndtree.tiles.growth import Growth
from ndtree.tiles.kind import MapKind, with_counters
from ndtree.tiles.manifest import TILES, Manifest, TileEntry, commit, open_manifest, store_bytes, tidy
from ndtree.tiles.order import Sources, named, opened
from ndtree.tiles.storage import Storage, storage_of

BLOCK = 4
BATCH_BEAMS = 250_000
RANGE_BEAMS = 4_000_000


@dataclass(frozen=True)
class FleetReport:
    """What a run did.

    Attributes
    ----------
    scans, beams : int
        Taken in; each once, however many tiles it crosses.
    refused, ignored : int
        Scans that no map of the kind takes, and beams left out because they did not return.
    tiles, blocks : int
        That were mapped.
    tasks : int
        Of blocks.
    task_beams : int
        Beams over all tasks: one that crosses several blocks counts in each.
    scan_bytes : int
        Of the stored scans.
    bytes_read, state_bytes : int
        Scans that tasks have read, and states and tiles that they have written.
    seconds : float
        From beginning to end [s].
    prepare_seconds, task_seconds, insert_seconds : float
        Sums over all tasks: of reading logs, of blocks, and of these, insertion itself [s].
    longest_chain_seconds : float
        Of the block whose tasks took longest [s]: no number of workers is faster.
    workers : int
    records : list of BlockRecord
        Of each task.
    """

    scans: int
    beams: int
    refused: int
    ignored: int
    tiles: int
    blocks: int
    tasks: int
    task_beams: int
    scan_bytes: int
    bytes_read: int
    state_bytes: int
    seconds: float
    prepare_seconds: float
    task_seconds: float
    insert_seconds: float
    longest_chain_seconds: float
    workers: int
    records: list[BlockRecord]

    @property
    def idle(self) -> float:
        """Share of the workers' time in which they did nothing, engine and planning included."""
        return max(0.0, 1.0 - (self.prepare_seconds + self.task_seconds) / (self.seconds * self.workers))

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
    engine: str | Engine = "ray",
    like: OccupancyMap | None = None,
    tile_size: float | None = None,
    max_range: float = math.inf,
    no_return: str = "free",
    workers: int | None = None,
    block: int = BLOCK,
    batch_beams: int = BATCH_BEAMS,
    range_beams: int = RANGE_BEAMS,
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
    engine : {"ray", "dask", "local"}, or Engine
        "local": threads of this process.
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
    block : int
        Tiles along the edge of what a task works on. A scan that crosses k blocks is surveyed k times; of
        fewer, larger ones, fewer can be worked on at a time.
    batch_beams, range_beams : int
        Beams in a file of scans, and in a task: a worker holds a block and some files.
    progress : callable, optional
        Called as ``progress(what, done, total)``.

    Returns
    -------
    FleetReport

    Raises
    ------
    ValueError
        If something of the call is wrong, or of a log; it is named.
    OSError
        If a log, or the folder, cannot be read or written.
    ImportError
        If the engine is not installed; it names the extra.
    """
    begin = time.perf_counter()
    sources = named(logs)
    if no_return not in ("free", "ignore"):
        raise ValueError(f"no_return = {no_return!r}: must be 'free' or 'ignore'")
    if not max_range > 0:
        raise ValueError(f"max_range = {max_range:g} m: must be > 0")
    for name, value in (("block", block), ("batch_beams", batch_beams), ("range_beams", range_beams)):
        if value < 1:
            raise ValueError(f"{name} = {value}: must be >= 1")
    if like is None:
        like = _core.AdaptiveMap(dim=_dim_of(next(iter(sources.values()))))
    storage = storage_of(url)
    before = _manifest(storage)
    revision = before.revision + 1 if before is not None else 1
    job = Job(
        _everywhere(url),
        f"run-{revision:06d}",
        revision,
        MapKind.of(like),
        TileGrid.of(like, tile_size),
        max_range,
        no_return,
        block,
        batch_beams,
    )
    _begin(storage, job, {"logs": _sizes(sources), "range_beams": range_beams})
    chosen = engine_of(engine, workers)
    try:
        prepared = run_all(
            chosen, "reading", [(prepare, job, log, source) for log, source in sources.items()], progress
        )
        indexes = [ScanIndex.from_bytes(storage.read(index_name(job.run, log))) for log in sources]
        if not any(index.scans for index in indexes):
            raise ValueError(f"{', '.join(sources)}: no scans, expected at least one")
        made_from = {"run": job.run, "max_range": max_range if math.isfinite(max_range) else None}
        made_from.update(no_return=no_return, range_beams=range_beams, block=block, moves={})
        made_from["indexes"] = {log: index_name(job.run, log) for log in sources}
        report = _mapped(chosen, job, storage, indexes, range_beams, None, before, made_from, progress)
    finally:
        if not isinstance(engine, Engine):
            chosen.close()
    return replace(report, seconds=time.perf_counter() - begin, prepare_seconds=sum(prepared))


def remap(
    url: str | os.PathLike[str],
    poses: Mapping[str, Mapping[int, ArrayLike]],
    *,
    engine: str | Engine = "ray",
    workers: int | None = None,
    progress: Progress | None = None,
) -> FleetReport:
    """Move scans of a map that `map` made, as a pose graph says, and map anew what this touches.

    That is all blocks of tiles that the scans crossed, or cross now.

    The result is that of mapping everything anew with scans that were moved by `moved`.

    Parameters
    ----------
    url : str or path
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
    begin = time.perf_counter()
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
        int(held["block"]),
        1,
    )
    names, moves = dict(held["indexes"]), dict(held["moves"])
    indexes = {log: ScanIndex.from_bytes(storage.read(name)) for log, name in names.items()}
    original = StoredScans(storage, job.run, {})
    touched: set[Tile] = set()
    for log, of_log in poses.items():
        if log not in indexes:
            raise ValueError(f"log {log!r}: must be one of {', '.join(indexes)}")
        index = indexes[log]
        motions = _motions(storage, moves.get(log), len(index.scans), job.kind.dim)
        for number, pose in sorted(of_log.items()):
            if not 0 <= number < len(index.scans):
                raise ValueError(f"log {log!r}: scan {number}: there are {len(index.scans)}")
            matrix = pose_matrix(pose, dim=job.kind.dim, name=f"log {log!r}: scan {number}: pose")
            if np.array_equal(matrix, motions[number]):
                continue
            motions[number] = matrix
            before = index.scans[number]
            scan = original.get(log, number, before.batch, before.position)
            there = indexed(job, moved(scan, matrix), before.time, before.batch, before.position)
            index.scans[number] = there
            touched |= {block_of(job, tile) for tile in (*before.tiles, *there.tiles)}
        file = io.BytesIO()
        np.save(file, motions)
        moves[log] = moves_name(job.run, log, job.revision)
        storage.write(moves[log], file.getvalue())
        names[log] = index_name(job.run, log, job.revision)
        storage.write(names[log], index.as_bytes())
    job = replace(job, moves=tuple(moves.items()))
    storage.remove_folder(f"{job.run}/work")  # Of a call that was killed, perhaps with other poses.
    chosen = engine_of(engine, workers)
    try:
        report = _mapped(
            chosen,
            job,
            storage,
            list(indexes.values()),
            int(held["range_beams"]),
            touched,
            manifest,
            {**held, "moves": moves, "indexes": names},
            progress,
        )
    finally:
        if not isinstance(engine, Engine):
            chosen.close()
    return replace(report, seconds=time.perf_counter() - begin)


def _mapped(
    engine: Engine,
    job: Job,
    storage: Storage,
    indexes: list[ScanIndex],
    range_beams: int,
    touched: set[Tile] | None,
    before: Manifest | None,
    made_from: dict[str, Any],
    progress: Progress | None,
) -> FleetReport:
    """Map blocks, all or some, and write the manifest of these and of what else there was."""
    scans = list(plan.in_order(indexes))
    chains = plan.chains(job, scans, range_beams, touched)
    records = run_chains(engine, job, storage, chains, progress)
    tiles: dict[Tile, TileEntry] = {}
    counters: dict[str, list[int]] = {}
    if touched is not None and before is not None:
        tiles = {tile: entry for tile, entry in before.tiles.items() if block_of(job, tile) not in touched}
        gone = {_key(block) for block in touched}
        counters = {key: of for key, of in before.made_from["counters"].items() if key not in gone}
    for record in records:
        tiles.update(entries_of(record))
        counters[_key(record.block)] = record.counters  # Of the last of its tasks.
    growth = Growth(job.kind.new())
    stored = StoredScans(storage, job.run, dict(job.moves))
    for ref, scan in scans:
        box = None if scan.box is None else (np.array(scan.box[0]), np.array(scan.box[1]))
        if not growth.contains(box):
            growth.include(stored.get(ref.log, ref.number, ref.batch, ref.position), job.max_range)
    updates, splits, merges = (sum(of[i] for of in counters.values()) for i in range(3))
    frame = with_counters(growth.map.to_bytes(), updates, splits, merges, len(scans))
    manifest = Manifest(
        job.kind,
        job.grid,
        job.revision,
        store_bytes(storage, frame, f"{TILES}/frame"),
        tiles,
        {**made_from, "counters": counters},
    )
    commit(storage, manifest)
    tidy(storage, manifest)
    storage.remove_folder(f"{job.run}/work")
    if before is not None and before.made_from.get("run", job.run) != job.run:
        storage.remove_folder(before.made_from["run"])
    seconds: dict[Tile, float] = {}  # Of blocks.
    for record in records:
        seconds[record.block] = seconds.get(record.block, 0.0) + record.seconds
    return FleetReport(
        scans=len(scans),
        beams=sum(scan.beams for _, scan in scans),
        refused=sum(index.refused for index in indexes),
        ignored=sum(index.ignored for index in indexes),
        tiles=sum(len(record.entries) for record in records),
        blocks=len(chains),
        tasks=len(records),
        task_beams=sum(record.beams for record in records),
        scan_bytes=sum(sum(index.batch_bytes) for index in indexes),
        bytes_read=sum(record.bytes_read for record in records),
        state_bytes=sum(record.state_bytes for record in records),
        seconds=0.0,
        prepare_seconds=0.0,
        task_seconds=sum(record.seconds for record in records),
        insert_seconds=sum(record.insert_seconds for record in records),
        longest_chain_seconds=max(seconds.values(), default=0.0),
        workers=engine.workers,
        records=records,
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


def _key(block: Tile) -> str:
    return "_".join([str(place) for place in block])


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
    return np.load(io.BytesIO(storage.read(name)), allow_pickle=False)
