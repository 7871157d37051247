# SPDX-License-Identifier: BSD-3-Clause
"""Which task takes which scans into which block of tiles, and in which order: the same for every engine."""

from __future__ import annotations

import json
import time
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from ndtree.base.progress import Progress
from ndtree.distributed.blocks import Block, divided
from ndtree.distributed.engines import Engine
from ndtree.distributed.scans import IndexedScan, ScanIndex
from ndtree.distributed.stages import BlockTask, Job, ScanRef, scans_name
from ndtree.tiles.grid import Tile
from ndtree.tiles.storage import Storage

MOST_TILES = 4096  # Of a block: about a gigabyte of cells.


#: What takes a block, and the scans that cross it, in their order.
Planned = tuple[BlockTask, list[ScanRef]]


def in_order(indexes: Iterable[ScanIndex]) -> Iterator[tuple[ScanRef, IndexedScan]]:
    """All scans of the run: by time, those of one time by the name of their log."""
    every = [
        ((scan.time, index.log, number), scan) for index in indexes for number, scan in enumerate(index.scans)
    ]
    every.sort(key=lambda one: one[0])
    for order, ((_, log, number), scan) in enumerate(every):
        yield ScanRef(log, number, scan.where, order), scan


def planned(
    scans: Sequence[tuple[ScanRef, IndexedScan]], within: Sequence[Block], workers: int, block_beams: int
) -> list[Planned]:
    """Blocks with their scans, those with most to do first.

    `scans`: In their order.
    `within`: What to map; each is divided as its weight needs it.
    `block_beams`: A block has no more beams' worth of work than this, if it is more than one tile.
    """
    where: dict[Tile, int] = {}  # In which of `within`, or -1.
    weights: list[dict[Tile, float]] = [{} for _ in within]
    for _, scan in scans:
        per_count = scan.where.beams / max(1, sum(scan.tiles.values()))
        for tile, count in scan.tiles.items():
            if tile not in where:
                where[tile] = next((i for i, block in enumerate(within) if tile in block), -1)
            if where[tile] >= 0:
                of_block = weights[where[tile]]
                of_block[tile] = of_block.get(tile, 0.0) + count * per_count
    sums = [sum(of_block.values()) for of_block in weights]
    largest = float(block_beams)
    if workers > 1:
        # More blocks would cost more than they save: in each that it crosses, a scan is surveyed.
        largest = min(largest, max(1.0, sum(sums) / workers))
    blocks = [
        small
        for block, of_block, total in zip(within, weights, sums)
        for large in divided(block, of_block, round(total / largest + 0.4))
        for small in _held_at_once(large, {tile: w for tile, w in of_block.items() if tile in large})
    ]
    home = {
        tile: next(i for i, block in enumerate(blocks) if tile in block)
        for tile, i in where.items()
        if i >= 0
    }
    refs: list[list[ScanRef]] = [[] for _ in blocks]
    for ref, scan in scans:
        for i in {home[tile] for tile in scan.tiles if tile in home}:
            refs[i].append(ref)
    tiles: list[list[Tile]] = [[] for _ in blocks]
    load = [0.0] * len(blocks)
    for tile, i in home.items():
        tiles[i].append(tile)
        load[i] += weights[where[tile]][tile]
    logs = tuple(sorted({ref.log for ref, _ in scans}))
    most_first = sorted(range(len(blocks)), key=lambda i: (-load[i], blocks[i].lower))
    return [
        (BlockTask(number, blocks[i], load[i], logs, tuple(sorted(tiles[i]))), refs[i])
        for number, i in enumerate(most_first)
    ]


def _held_at_once(block: Block, weights: dict[Tile, float]) -> list[Block]:
    """A block as smaller ones that have few enough tiles for a worker's memory."""
    if len(weights) <= MOST_TILES:
        return [block]
    return [
        small
        for half in divided(block, weights, 2)
        for small in _held_at_once(half, {tile: w for tile, w in weights.items() if tile in half})
    ]


def store_plan(storage: Storage, job: Job, blocks: list[Planned]) -> None:
    """Write what tasks read; the plan itself comes last."""
    logs = blocks[0][0].logs if blocks else ()
    number = {log: i for i, log in enumerate(logs)}
    for task, refs in blocks:
        rows = [(number[ref.log], ref.number, *ref.where, ref.order) for ref in refs]
        storage.write_array(scans_name(job.run, task.number), np.array(rows, np.int64).reshape(-1, 7))
    held = [{"block": one.block.as_json(), "weight": one.weight, "tiles": one.tiles} for one, _ in blocks]
    content = {"logs": logs, "blocks": held}
    storage.write(_plan_name(job.run), json.dumps(content, separators=(",", ":")).encode())


def stored_tasks(storage: Storage, job: Job) -> list[BlockTask] | None:
    """The tasks of a plan, those with most to do first; None if there is no plan."""
    if not storage.has(_plan_name(job.run)):
        return None
    held = json.loads(storage.read(_plan_name(job.run)))
    logs = tuple(held["logs"])
    return [
        BlockTask(i, Block.from_json(one["block"]), one["weight"], logs, tuple(map(tuple, one["tiles"])))
        for i, one in enumerate(held["blocks"])
    ]


def _plan_name(run: str) -> str:
    return f"{run}/work/plan.json"


def run_all(
    engine: Engine, what: str, tasks: list[tuple[Any, ...]], progress: Progress | None
) -> tuple[list[Any], float]:
    """Run tasks that do not depend on each other; each is a function and its arguments.

    Returns results list: Of each task; seconds float: Sum over all tasks, from when the engine got them to
    when it gave their results [s]. The engine never has more of them than workers, so that what is not the
    tasks' own time is its own.
    """
    results: list[Any] = [None] * len(tasks)
    running: dict[Any, tuple[int, float]] = {}
    waiting = iter(range(len(tasks)))
    done, seconds = 0, 0.0
    while done < len(tasks):
        while len(running) < max(1, engine.workers):
            number = next(waiting, None)
            if number is None:
                break
            begun = time.perf_counter()
            running[engine.submit(*tasks[number])] = (number, begun)
        for handle in engine.done_of(running):
            number, begun = running.pop(handle)
            results[number] = engine.result(handle)
            seconds += time.perf_counter() - begun
            done += 1
            if progress is not None:
                progress(what, done, len(tasks))
    return results, seconds
