# SPDX-License-Identifier: BSD-3-Clause
"""A run over an engine: a bounded number of tasks at a time, and what is done already is not done again."""

from __future__ import annotations

import heapq
from typing import Any

from ndtree.base.progress import Progress
from ndtree.distributed.engines import Engine
from ndtree.distributed.plan import Chain
from ndtree.distributed.stages import BlockRecord, BlockTask, Job, integrate, record_from, record_name
from ndtree.tiles.storage import Storage

#: Tasks that wait at the engine for each that runs: more would hold memory, fewer would let workers idle.
_AHEAD = 2


def run_all(engine: Engine, what: str, tasks: list[tuple[Any, ...]], progress: Progress | None) -> list[Any]:
    """Run tasks that do not depend on each other; each is a function and its arguments."""
    results: list[Any] = [None] * len(tasks)
    running: dict[Any, int] = {}
    waiting = iter(range(len(tasks)))
    done = 0
    while done < len(tasks):
        while len(running) < _AHEAD * max(1, engine.workers):
            number = next(waiting, None)
            if number is None:
                break
            running[engine.submit(*tasks[number])] = number
        for handle in engine.done_of(running):
            results[running.pop(handle)] = engine.result(handle)
            done += 1
            if progress is not None:
                progress(what, done, len(tasks))
    return results


def run_chains(
    engine: Engine, job: Job, storage: Storage, chains: list[Chain], progress: Progress | None
) -> list[BlockRecord]:
    """Take all scans into all blocks: of each block one task at a time, the longest chains first.

    A task that has left its record, in an earlier run that was killed, is not run again.
    """
    there = storage.names(f"{job.run}/work")
    records: list[BlockRecord] = []
    ready: list[tuple[int, int, int]] = []  # Beams that are left, and number, of a chain, and its next task.
    states: list[str | None] = [None] * len(chains)
    total = sum(len(chain.ranges) for chain in chains)
    for number, chain in enumerate(chains):
        at = 0
        while at < len(chain.ranges) and record_name(job.run, chain.block, at) in there:
            record = record_from(storage.read(record_name(job.run, chain.block, at)))
            records.append(record)
            states[number] = record.state
            at += 1
        if at < len(chain.ranges):
            ready.append((-sum(one.beams for one in chain.ranges[at:]), number, at))
    heapq.heapify(ready)
    running: dict[Any, tuple[int, int, int]] = {}
    while ready or running:
        while ready and len(running) < _AHEAD * max(1, engine.workers):
            left, number, at = heapq.heappop(ready)
            chain, one = chains[number], chains[number].ranges[at]
            task = BlockTask(
                chain.block,
                one.part,
                states[number],
                one.scans,
                one.beams,
                chain.tiles if at == len(chain.ranges) - 1 else (),
            )
            running[engine.submit(integrate, job, task)] = (left, number, at)
        for handle in engine.done_of(running):
            left, number, at = running.pop(handle)
            record = engine.result(handle)
            records.append(record)
            before, states[number] = states[number], record.state
            if before is not None:
                storage.remove(before)
            if at + 1 < len(chains[number].ranges):
                heapq.heappush(ready, (left + chains[number].ranges[at].beams, number, at + 1))
            if progress is not None:
                progress("mapping", len(records), total)
    return sorted(records, key=lambda record: (record.block, record.part))
