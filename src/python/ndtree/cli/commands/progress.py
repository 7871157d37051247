# SPDX-License-Identifier: BSD-3-Clause
"""Bars that show on a terminal how far a command is."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from ndtree._native._core import OccupancyMap
from ndtree.base.progress import Progress, no_progress
from ndtree.base.words import number_of
from ndtree.logs import Log

#: A mapping's figures are drawn anew after so long [s].
REFRESH = 0.2


def _terminal() -> Any:
    """Where bars are shown; None where standard error is no terminal, for which nothing is loaded."""
    if not sys.stderr.isatty():
        return None
    from rich.console import Console

    console = Console(stderr=True)
    return console if console.is_terminal else None


@contextmanager
def progress() -> Iterator[Progress]:
    """A function that shows what is going on, on a terminal only."""
    console = _terminal()
    if console is None:
        yield no_progress
        return
    from rich import progress as bars
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with bars.Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("")
        current = ""

        def advance(what: str, done: int, total: int) -> None:
            nonlocal current
            if what != current:
                current = what
                bar.reset(task)
            bar.update(task, description=what, completed=done, total=total or None)

        yield advance


@contextmanager
def mapping_progress(log: Log, target: OccupancyMap) -> Iterator[Callable[[int, int], None]]:
    """A function of the scans and beams so far that shows how far a map is, on a terminal only.

    The time left is shown for logs that can tell how much of them is read.
    """
    console = _terminal()
    if console is None:
        yield lambda scans, beams: None
        return
    from rich import progress as bars
    from rich.progress import BarColumn, TextColumn, TimeRemainingColumn

    columns = (BarColumn(), TextColumn("{task.description}"), TimeRemainingColumn())
    with bars.Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("", total=None)
        begin = last = time.monotonic()

        def advance(scans: int, beams: int) -> None:
            nonlocal last
            now = time.monotonic()
            if now - last < REFRESH:
                return
            last = now
            share = log.share_read
            bar.update(
                task,
                description=mapping_line(scans, beams, now - begin, target),
                completed=share or 0.0,
                total=None if share is None else 1.0,
            )

        yield advance


def mapping_line(scans: int, beams: int, seconds: float, target: OccupancyMap) -> str:
    """Scans, beams a second, leaves and memory of a map that grows."""
    stats = target.stats()
    return (
        f"{number_of(scans, 'scan')}, {beams / max(seconds, 1e-9):,.0f} beams/s, {stats.leaves:,} leaves, "
        f"{stats.memory_bytes / 2**20:.1f} MiB"
    )
