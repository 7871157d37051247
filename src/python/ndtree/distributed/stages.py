# SPDX-License-Identifier: BSD-3-Clause
"""What tasks do, wherever they run: each may run twice, or be killed and run again, and nothing changes."""

from __future__ import annotations

import json
import time
from dataclasses import asdict, dataclass, replace
from typing import Any

from ndtree._native import _core
from ndtree.base.scan import Scan
from ndtree.distributed.scans import IndexedScan, ScanIndex, StoredScans, batch_name, index_name, pack
from ndtree.tiles.grid import Tile, TileGrid, beams_of, reach_of
from ndtree.tiles.growth import Growth
from ndtree.tiles.kind import MapKind
from ndtree.tiles.manifest import TileEntry, store_tile
from ndtree.tiles.order import Source, opened, placed
from ndtree.tiles.storage import storage_of


@dataclass(frozen=True)
class Job:
    """What all tasks of a run have to know.

    Attributes
    ----------
    url : str
        The tiled map, as every worker can reach it.
    run : str
        Folder in it for what this run needs.
    revision : int
        That the manifest will have.
    kind : MapKind
    grid : TileGrid
    max_range : float
        As for insert() [m].
    no_return : {"free", "ignore"}
    block : int
        Tiles along the edge of what a task works on: a block.
    batch_beams : int
        Beams in a file of scans.
    moves : tuple of (log, file)
        Motions of scans.
    """

    url: str
    run: str
    revision: int
    kind: MapKind
    grid: TileGrid
    max_range: float
    no_return: str
    block: int
    batch_beams: int
    moves: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class ScanRef:
    """A scan in a run's files, and its number among all scans of the run, in their order."""

    log: str
    number: int
    batch: int
    position: int
    order: int


@dataclass(frozen=True)
class BlockTask:
    """Scans to take into a block of tiles, which are the next ones after those of an earlier task.

    Attributes
    ----------
    block : Tile
        Its place on the grid of blocks.
    part : int
        Which of the block's tasks it is.
    before : str or None
        File of the block's state that it begins with.
    scans : tuple of ScanRef
    beams : int
    tiles : tuple of Tile
        Where there may be cells when the block is done; none as long as it is not.
    """

    block: Tile
    part: int
    before: str | None
    scans: tuple[ScanRef, ...]
    beams: int
    tiles: tuple[Tile, ...]


@dataclass(frozen=True)
class BlockRecord:
    """What a `BlockTask` did.

    Attributes
    ----------
    state : str or None
        File of the block's state after it; None if it was the last.
    entries : list of (tile, dict)
        What the manifest says of the tiles, if it was the last.
    counters : list of int
        Updates, splits and merges that the block has taken so far.
    seconds : float
        That it took [s].
    insert_seconds : float
        Of these, spent on insertion itself [s].
    bytes_read, state_bytes : int
        Of scans, and of the state that it left.
    """

    block: Tile
    part: int
    state: str | None
    entries: list[tuple[Tile, dict[str, Any]]]
    counters: list[int]
    scans: int
    beams: int
    seconds: float
    insert_seconds: float
    bytes_read: int
    state_bytes: int


def record_name(run: str, block: Tile, part: int) -> str:
    """File that says that a task is done."""
    return f"{_task_name(run, block, part)}.json"


def _task_name(run: str, block: Tile, part: int) -> str:
    """What the files of a task are called, without their ending."""
    return f"{run}/work/{'_'.join(map(str, block))}-{part:06d}"


def record_from(content: bytes) -> BlockRecord:
    """Read what `integrate` wrote."""
    held = json.loads(content)
    entries = [(tuple(tile), entry) for tile, entry in held["entries"]]
    return BlockRecord(**{**held, "block": tuple(held["block"]), "entries": entries})


def entries_of(record: BlockRecord) -> dict[Tile, TileEntry]:
    """What the manifest says of tiles."""
    found = {}
    for tile, held in record.entries:
        bounds = held["bounds"]
        found[tile] = TileEntry(**{**held, "bounds": None if bounds is None else (bounds[0], bounds[1])})
    return found


def block_of(job: Job, tile: Tile) -> Tile:
    """The block that a tile is in."""
    return tuple(place // job.block for place in tile)


def indexed(job: Job, scan: Scan, when: float, batch: int, position: int) -> IndexedScan:
    """What a plan has to know of a scan."""
    starts, ends = beams_of(scan, job.kind.options, job.max_range)
    box = reach_of(starts, ends)
    return IndexedScan(
        when,
        batch,
        position,
        len(scan),
        None if box is None else (box[0].tolist(), box[1].tolist()),
        tuple(sorted(job.grid.crossed_by(starts, ends))),
    )


def prepare(job: Job, log: str, source: Source) -> float:
    """Read a log, store its scans, and say of each where it belongs. @returns how long it took [s]."""
    begin = time.perf_counter()
    storage = storage_of(job.url)
    if storage.has(index_name(job.run, log)):
        return 0.0
    found: list[IndexedScan] = []
    batch_bytes: list[int] = []
    waiting: list[Scan] = []
    beams = refused = ignored = 0

    def store() -> None:
        content = pack(waiting)
        storage.write(batch_name(job.run, log, len(batch_bytes)), content)
        batch_bytes.append(len(content))
        waiting.clear()

    for place, scan in placed(log, opened(source)):
        if job.no_return == "ignore":
            before = len(scan)
            scan = scan.returned_only()
            ignored += before - len(scan)
        if scan.dim != job.kind.dim:
            raise ValueError(
                f"{log}: scan {place.number} is {scan.dim}-D, and the map {job.kind.dim}-D: must be the same"
            )
        try:
            Growth(job.kind.new()).include(scan, job.max_range)
        except ValueError:
            refused += 1
            continue
        found.append(indexed(job, scan, place.time, len(batch_bytes), len(waiting)))
        waiting.append(scan)
        beams += len(scan)
        if beams >= job.batch_beams:
            store()
            beams = 0
    if waiting:
        store()
    storage.write(index_name(job.run, log), ScanIndex(log, found, batch_bytes, refused, ignored).as_bytes())
    return time.perf_counter() - begin


def integrate(job: Job, task: BlockTask) -> BlockRecord:
    """Take scans into a block; its state, or its tiles, are stored, and then a record of it."""
    begin = time.perf_counter()
    storage = storage_of(job.url)
    m = job.kind.new() if task.before is None else _core.from_bytes(storage.read(task.before))
    stored = StoredScans(storage, job.run, dict(job.moves))
    window = replace(job.grid, cubes=job.grid.cubes * job.block).box(task.block)
    inserted = 0.0
    for ref in task.scans:
        scan = stored.get(ref.log, ref.number, ref.batch, ref.position)
        own = {} if scan.range_sigma is None else {"range_sigma": scan.range_sigma}
        report = m.insert(
            scan.endpoints,
            scan.origin,
            returned=scan.returned,
            max_range=job.max_range,
            threads=1,
            window=window,
            number=ref.order,
            **own,
        )
        inserted += report.seconds
    state, entries, size = None, [], 0
    for tile in task.tiles:
        cells = job.kind.new()  # With a root that depends on the cells alone.
        cells.adopt(m, job.grid.box(tile))
        if job.kind.is_worth_storing(cells):
            entry = store_tile(storage, cells, tile, job.revision)
            entries.append((tile, asdict(entry)))
            size += entry.bytes
    if not task.tiles:
        content = m.to_bytes()
        state = f"{_task_name(job.run, task.block, task.part)}.ndt"
        storage.write(state, content)
        size = len(content)
    stats = m.stats()
    record = BlockRecord(
        task.block,
        task.part,
        state,
        entries,
        [stats.updates, stats.splits, stats.merges],
        len(task.scans),
        task.beams,
        time.perf_counter() - begin,
        inserted,
        stored.bytes_read,
        size,
    )
    storage.write(record_name(job.run, task.block, task.part), json.dumps(asdict(record)).encode())
    return record
