# SPDX-License-Identifier: BSD-3-Clause
"""A run over an engine: as many tasks at a time as there are workers."""

from __future__ import annotations

import time
from typing import Any

from ndtree.base.progress import Progress
from ndtree.distributed.engines import Engine


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
