# SPDX-License-Identifier: BSD-3-Clause
"""Logs of a fleet into one tiled map, on many machines, bit for bit as one machine makes it."""

from __future__ import annotations

import json
import math
import os
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ndtree._native import _core
from ndtree._native._checked import settings_of
from ndtree._native._core import OccupancyMap
from ndtree.base.progress import Progress
from ndtree.distributed import plan
from ndtree.distributed.blocks import Block
from ndtree.distributed.engines import Engine, engine_of
from ndtree.distributed.moving import Moves
from ndtree.distributed.plan import run_all
from ndtree.distributed.report import FleetReport, Times, report_of
from ndtree.distributed.scans import ScanIndex, StoredScans, index_name
from ndtree.distributed.stages import BlockRecord, FleetSettings, Job, entries_of, integrate, prepare
from ndtree.tiles.grid import MapKind, Tile, TileGrid, with_counters
from ndtree.tiles.manifest import TILES, Manifest, TileEntry, commit, open_manifest, store_bytes, tidy
from ndtree.tiles.order import Sources, named, opened
from ndtree.tiles.resident import Growth
from ndtree.tiles.storage import Storage, storage_of


def map(
    logs: Sources,
    url: str | os.PathLike[str],
    *,
    engine: str | Engine = "processes",
    like: OccupancyMap | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
    **how: Any,
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
    workers : int, optional
        Tasks at a time. Left out: what the engine has.
    progress : callable, optional
        Called as ``progress(what, done, total)``.
    **how
        Fields of `FleetSettings`: ``tile_size``, ``max_range``, ``no_return`` ...

    Raises
    ------
    ValueError
        If something of the call is wrong, or of a log; it is named.
    OSError
        If a log, or the folder, cannot be read or written.
    ImportError
        If the engine is not installed; it names the extra.
    """
    times, settings, sources = Times(), settings_of(FleetSettings(), "map", how), named(logs)
    target = _core.AdaptiveMap(dim=_dim_of(next(iter(sources.values())))) if like is None else like
    storage = storage_of(url)
    before: Manifest | None = None
    with suppress(FileNotFoundError):
        before = open_manifest(storage)
    revision = before.revision + 1 if before is not None else 1
    grid = TileGrid.of(target, settings.tile_size)
    job = Job(_everywhere(url), f"run-{revision:06d}", revision, MapKind.of(target), grid, settings)
    _begin(storage, job, _sizes(sources))
    made_from = _made_from(job, sources)
    with _engine(engine, workers, times) as chosen:
        run = _Run(chosen, job, storage, before, progress)
        prepared, at_engine = run.prepare(sources)
        return times.of(run.mapped(run.indexes(sources), None, made_from), prepared, at_engine)


def _made_from(job: Job, logs: Iterable[str]) -> dict[str, Any]:
    """What a manifest says of how its map was made."""
    return {
        "run": job.run,
        "max_range": job.how.max_range if math.isfinite(job.how.max_range) else None,
        "no_return": job.how.no_return,
        "checkpoint_beams": job.how.checkpoint_beams,
        "block_beams": job.how.block_beams,
        "moves": {},
        "indexes": {log: index_name(job.run, log) for log in logs},
    }


@contextmanager
def _engine(engine: str | Engine, workers: int | None, times: Times) -> Iterator[Engine]:
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
    times = Times()
    storage = storage_of(url)
    manifest = open_manifest(storage)
    held = manifest.made_from
    if "run" not in held:
        raise ValueError(
            f"{os.fspath(url)}: holds no scans: only what ndtree.distributed.map made can be mapped anew"
        )
    limit = math.inf if held["max_range"] is None else float(held["max_range"])
    numbers = {name: int(held[name]) for name in ("checkpoint_beams", "block_beams")}
    how = FleetSettings(max_range=limit, no_return=held["no_return"], **numbers)
    revision = manifest.revision + 1
    job = Job(_everywhere(url), held["run"], revision, manifest.kind, manifest.grid, how)
    move = Moves(storage, job, held)
    for log, of_log in poses.items():
        move.log(log, of_log)
    job = replace(job, moves=tuple(move.moves.items()))
    storage.remove_folder(f"{job.run}/work")  # Of a call that was killed, perhaps with other poses.
    touched = sorted(move.touched, key=lambda block: block.lower)
    with _engine(engine, workers, times) as chosen:
        run = _Run(chosen, job, storage, manifest, progress)
        made_from = {**held, "moves": move.moves, "indexes": move.names}
        return times.of(run.mapped(list(move.indexes.values()), touched, made_from))


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
            blocks = plan.planned(scans, within, self.engine.workers, job.how.block_beams)
            plan.store_plan(storage, job, blocks)
            tasks = plan.stored_tasks(storage, job) or []
        records: list[BlockRecord]
        records, at_engine = run_all(
            self.engine, "mapping", [(integrate, job, task) for task in tasks], self.progress
        )
        tiles, done = _kept(before, touched)
        for record in records:
            tiles.update(entries_of(record))
            done.append({"block": record.block.as_json(), "counters": record.counters})
        frame = store_bytes(storage, self._frame(scans, done), f"{TILES}/frame")
        made_from = {**made_from, "blocks": sorted(done, key=lambda one: one["block"])}
        manifest = Manifest(job.kind, job.grid, job.revision, frame, tiles, made_from)
        commit(storage, manifest)
        tidy(storage, manifest)
        storage.remove_folder(f"{job.run}/work")
        if before is not None and before.made_from.get("run", job.run) != job.run:
            storage.remove_folder(before.made_from["run"])
        return report_of(records, scans, indexes, at_engine, self.engine.workers)

    def _frame(self, scans: list[Any], blocks: list[dict[str, Any]]) -> bytes:
        """The file of an empty map that has grown as one of all scans, with its counters."""
        job = self.job
        growth = Growth(job.kind.new())
        stored = StoredScans(self.storage, job.run, dict(job.moves))
        for ref, scan in scans:
            box = None if scan.box is None else (np.array(scan.box[0]), np.array(scan.box[1]))
            if not growth.contains(box):
                growth.include(stored.get(ref.log, ref.number, ref.where), job.how.max_range)
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


def _begin(storage: Storage, job: Job, logs: dict[str, int]) -> None:
    """Make the run's folder; one that was begun in another way, or of logs of other sizes, goes."""
    settings = json.dumps({**asdict(job), "logs": logs}, sort_keys=True).encode()
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


def _dim_of(source: Any) -> int:
    scans: Iterable[Any] = opened(source)
    dim = getattr(scans, "dim", None)
    if dim is None:
        first = next(iter(scans), None)
        if first is None:
            raise ValueError("the first log: no scans, expected at least one")
        dim = first.dim
    return int(dim)
