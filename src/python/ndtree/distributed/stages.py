# SPDX-License-Identifier: BSD-3-Clause
"""What tasks do, wherever they run: each may run twice, or be killed and run again, and nothing changes."""

from __future__ import annotations

import json
import math
import sys
import time
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndtree._errors import WrongValue
from ndtree._native import _core
from ndtree._native._checked import checked
from ndtree._native._core import OccupancyMap
from ndtree.base.scan import Scan
from ndtree.distributed.blocks import Block
from ndtree.distributed.scans import BatchWriter, IndexedScan, ScanIndex, StoredScans, Where, index_name
from ndtree.tiles.grid import MapKind, Tile, TileGrid, beams_of, reach_of
from ndtree.tiles.manifest import TileEntry, store_tile
from ndtree.tiles.order import Source, opened, placed
from ndtree.tiles.resident import Growth
from ndtree.tiles.storage import Storage, storage_of

try:
    import resource
except ImportError:  # Windows has none.
    resource = None  # type: ignore[assignment]

Floats = NDArray[np.float64]
_NEAR = 1 << 18  # In smallest cells: beams of such a length, ...
_FAR = 1 << 30  # ... and so far from the map's origin, are taken by every map.


@checked
@dataclass(frozen=True)
class FleetSettings:
    """How logs become tiles.

    Attributes
    ----------
    tile_size : float, optional
        [m]; rounded up to a power of the branching of `max_cell_size`. Left out: 16 of these.
    max_range : float
        As for insert() [m].
    no_return : {"free", "ignore"}
        What a beam without return says: that the space up to its end is free, or nothing.
    block_beams : int
        What a worker maps at a time, a block of tiles, is made of at most this many beams, if it is more than
        one tile; the part of each scan that is in it counts. With several workers there are a few for each,
        whose scans are surveyed in every one that they cross.
    batch_beams : int
        Beams in a file of scans.
    checkpoint_beams : int
        A block's state is written whenever it has taken this many in: what a killed worker has to do again.

    Raises
    ------
    ValueError
        If a number is out of its limits.
    """

    tile_size: float | None = None
    max_range: float = math.inf
    no_return: str = "free"
    block_beams: int = 50_000_000
    batch_beams: int = 250_000
    checkpoint_beams: int = 20_000_000

    def __post_init__(self) -> None:
        if self.no_return not in ("free", "ignore"):
            raise WrongValue.of("no_return", f"{self.no_return!r}", "'free' or 'ignore'")
        if not self.max_range > 0:
            raise WrongValue.of("max_range", f"{self.max_range:g} m", "> 0")
        for name in ("block_beams", "batch_beams", "checkpoint_beams"):
            if getattr(self, name) < 1:
                raise WrongValue.of(name, getattr(self, name), ">= 1")


@dataclass(frozen=True)
class Job:
    """What all tasks of a run have to know.

    `moves` (tuple of (log, file)): Motions of scans.
    """

    url: str  # The tiled map, as every worker can reach it.
    run: str  # Folder in it for what this run needs.
    revision: int  # That the manifest will have.
    kind: MapKind
    grid: TileGrid
    how: FleetSettings
    moves: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class ScanRef:
    """A scan in a run's files, and its number among all scans of the run, in their order."""

    log: str
    number: int
    where: Where
    order: int


@dataclass(frozen=True)
class BlockTask:
    """All scans of a run into a block of tiles."""

    number: int  # Of the block.
    block: Block
    weight: float  # How many beams' worth of work it is.
    logs: tuple[str, ...]  # By the numbers that its scans give them.
    tiles: tuple[Tile, ...]  # Where there may be cells in the end.


@dataclass(frozen=True)
class BlockRecord:
    """What a `BlockTask` did.

    `entries`: What the manifest says of its tiles.
    `counters`: Updates, splits and merges.
    `scans`, `beams`: That cross it.
    `weight`: Beams' worth of work, as it was planned.
    `resumed`: Scans that a state had already, of a worker that was killed.
    `seconds`: From the last begin to the end [s].
    `insert_seconds`, `state_seconds`, `store_seconds`: Of these, spent on insertion, on states of the block,
        and on its tiles [s].
    `cpu_seconds`: Processor time [s].
    `peak_memory`: Of the process, as the system counts it [bytes]; 0 where it does not.
    `bytes_read`, `written_bytes`: Beams that were looked at, and states and tiles.
    """

    block: Block
    entries: list[tuple[Tile, dict[str, Any]]]
    counters: list[int]
    scans: int
    beams: int
    weight: float
    resumed: int
    seconds: float
    insert_seconds: float
    state_seconds: float
    store_seconds: float
    cpu_seconds: float
    peak_memory: int
    bytes_read: int
    written_bytes: int


@dataclass(frozen=True)
class Prepared:
    """What reading a log took: wall time and processor time [s], and the peak of memory [bytes]."""

    seconds: float
    cpu_seconds: float
    peak_memory: int


def scans_name(run: str, number: int) -> str:
    """File that says which scans a block takes."""
    return f"{run}/work/{number:06d}-scans.npy"


def _record_name(run: str, number: int) -> str:
    """File that says that a block is done."""
    return f"{run}/work/{number:06d}.json"


def _state_name(run: str, number: int, done: int) -> str:
    """File of a block's state after some of its scans."""
    return f"{run}/work/{number:06d}-{done:09d}.ndt"


def entries_of(record: BlockRecord) -> dict[Tile, TileEntry]:
    """What the manifest says of tiles."""
    found = {}
    for tile, held in record.entries:
        bounds = held["bounds"]
        found[tile] = TileEntry(**{**held, "bounds": None if bounds is None else (bounds[0], bounds[1])})
    return found


def peak_memory() -> int:
    """Of this process so far [bytes]; 0 where the system does not say."""
    if resource is None:
        return 0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return int(peak) if sys.platform == "darwin" else int(peak) << 10


def indexed(
    job: Job, scan: Scan, when: float, where: Where, beams: tuple[Floats, Floats] | None = None
) -> IndexedScan:
    """What a plan has to know of a scan; `beams`: as `beams_of` has them."""
    starts, ends = beams_of(scan, job.kind.options, job.how.max_range) if beams is None else beams
    box = reach_of(starts, ends)
    reach = None if box is None else (box[0].tolist(), box[1].tolist())
    return IndexedScan(when, where, reach, dict(sorted(job.grid.shares_by(starts, ends).items())))


def _is_taken(job: Job, scan: Scan, beams: tuple[Floats, Floats]) -> bool:
    """Whether maps of the kind take a scan; they are asked only if it looks at all unusual."""
    box = reach_of(*beams)
    if box is not None and scan.range_sigma is None and len(beams[1]) == len(scan):
        near, far = _NEAR * job.grid.unit, _FAR * job.grid.unit
        if (box[1] - box[0] < near).all() and (np.abs(box) < far).all():
            return True
    try:
        Growth(job.kind.new()).include(scan, job.how.max_range)
    except ValueError:
        return False
    return True


def prepare(job: Job, log: str, source: Source) -> Prepared:
    """Read a log, store its scans, and say of each where it belongs."""
    begin, cpu_begin = time.perf_counter(), time.thread_time()
    storage = storage_of(job.url)
    if storage.has(index_name(job.run, log)):
        return Prepared(0.0, 0.0, 0)
    found: list[IndexedScan] = []
    refused = ignored = 0
    batches = BatchWriter(storage, job.run, log, job.how.batch_beams)
    for place, scan in placed(log, opened(source)):
        if job.how.no_return == "ignore":
            before = len(scan)
            scan = scan.returned_only()
            ignored += before - len(scan)
        if scan.dim != job.kind.dim:
            raise ValueError(
                f"{log}: scan {place.number} is {scan.dim}-D, and the map {job.kind.dim}-D: must be the same"
            )
        scan = scan.with_sigma(job.kind.options)
        crossed = beams_of(scan, job.kind.options, job.how.max_range)
        if not _is_taken(job, scan, crossed):
            refused += 1
            continue
        found.append(indexed(job, scan, place.time, batches.add(scan), crossed))
    batches.store()
    index = ScanIndex(log, found, batches.stored_bytes, refused, ignored)
    storage.write(index_name(job.run, log), index.as_bytes())
    return Prepared(time.perf_counter() - begin, time.thread_time() - cpu_begin, peak_memory())


def integrate(job: Job, task: BlockTask) -> BlockRecord:
    """Take scans into a block, whose state is stored now and then; then its tiles, and a record of it."""
    begin, cpu_begin = time.perf_counter(), time.thread_time()
    storage = storage_of(job.url)
    resumed = _resumed(storage, job, task)
    if isinstance(resumed, BlockRecord):
        return resumed
    m, done = resumed
    held = "" if done == 0 else _state_name(job.run, task.number, done)
    first, state_seconds = done, time.perf_counter() - begin
    stored = StoredScans(storage, job.run, dict(job.moves))
    window = task.block.window(job.grid)
    inserted = 0.0
    written = waiting = 0
    scans = storage.array(scans_name(job.run, task.number)).tolist()
    for log, scan_number, *where, order in scans[first:]:
        scan = stored.get(task.logs[log], scan_number, Where(*where))
        report = scan.insert_into(m, max_range=job.how.max_range, threads=1, window=window, number=order)
        inserted += report.seconds
        done += 1
        waiting += len(scan)
        if waiting >= job.how.checkpoint_beams and done < len(scans):
            state_begin = time.perf_counter()
            before, held = held, _state_name(job.run, task.number, done)
            content = m.to_bytes()
            storage.write(held, content)
            if before:
                storage.remove(before)
            written += len(content)
            waiting = 0
            state_seconds += time.perf_counter() - state_begin
    beams = sum(row[5] for row in scans)
    store_begin = time.perf_counter()
    entries = []
    for tile in task.tiles:
        cells = job.kind.new()  # With a root that depends on the cells alone.
        cells.adopt(m, job.grid.box(tile))
        if job.kind.is_worth_storing(cells):
            entry = store_tile(storage, cells, tile, job.revision)
            entries.append((tile, asdict(entry)))
            written += entry.bytes
    stats = m.stats()
    end = time.perf_counter()
    record = BlockRecord(
        task.block,
        entries,
        [stats.updates, stats.splits, stats.merges],
        len(scans),
        beams,
        task.weight,
        first,
        end - begin,
        inserted,
        state_seconds,
        end - store_begin,
        time.thread_time() - cpu_begin,
        peak_memory(),
        stored.bytes_read,
        written,
    )
    content = json.dumps({**asdict(record), "block": task.block.as_json()}).encode()
    storage.write(_record_name(job.run, task.number), content)
    if held:
        storage.remove(held)
    return record


def _resumed(storage: Storage, job: Job, task: BlockTask) -> BlockRecord | tuple[OccupancyMap, int]:
    """What an earlier worker left of a block: all of it, or its last state, and how many scans that has."""
    begin = f"{job.run}/work/{task.number:06d}-"
    while True:
        names = storage.names(f"{job.run}/work")
        if _record_name(job.run, task.number) in names:
            held = json.loads(storage.read(_record_name(job.run, task.number)))
            held["entries"] = [(tuple(tile), entry) for tile, entry in held["entries"]]
            return BlockRecord(**{**held, "block": Block.from_json(held["block"])})
        states = [name for name in names if name.startswith(begin) and name.endswith(".ndt")]
        if not states:
            return job.kind.new(), 0
        last = max(states)
        try:
            return _core.from_bytes(storage.read(last)), int(last[len(begin) : -len(".ndt")])
        except FileNotFoundError:
            continue  # Another worker, which was thought to be lost, is further than that.
