# SPDX-License-Identifier: BSD-3-Clause
"""How far a command is: a bar on a terminal, else a line now and then."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from ndtree._native._core import OccupancyMap
from ndtree.base.progress import Progress
from ndtree.base.words import number_of
from ndtree.logs import Log
from ndtree.logs.core.again import Again

#: A mapping's figures are drawn anew after so long [s].
REFRESH = 0.2
#: Where standard error is no terminal, a line says so often how far a command is, if it takes that long [s].
LINE_EVERY = 10.0


def _terminal() -> Any:
    """Where bars are shown; None where standard error is no terminal, for which nothing is loaded."""
    if not sys.stderr.isatty():
        return None
    from rich.console import Console

    console = Console(stderr=True)
    return console if console.is_terminal else None


class _Lines:
    """Lines on standard error, one every `LINE_EVERY` seconds."""

    def __init__(self) -> None:
        self._last = time.monotonic()

    def say(self, text: Callable[[], str]) -> None:
        """Prints what `text` makes, where it is time to."""
        now = time.monotonic()
        if now - self._last >= LINE_EVERY:
            self._last = now
            print(text(), file=sys.stderr, flush=True)


@contextmanager
def busy(what: str) -> Iterator[None]:
    """Says what is done, if it takes long: of what cannot tell how far it is."""
    timer = threading.Timer(LINE_EVERY, lambda: print(what, file=sys.stderr, flush=True))
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


@contextmanager
def progress() -> Iterator[Progress]:
    """A function that shows what is going on."""
    console = _terminal()
    if console is None:
        lines = _Lines()
        yield lambda what, done, total: lines.say(
            lambda: f"{what}: {done:,} of {total:,}" if total else f"{what}: {done:,}"
        )
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
def mapping_progress(log: Log | Again, target: OccupancyMap) -> Iterator[Callable[[int, int], None]]:
    """A function of the scans and beams so far that shows how far a map is.

    The time left is shown for logs that can tell how much of them is read.
    """
    console = _terminal()
    begin = last = time.monotonic()
    if console is None:
        lines = _Lines()

        def say(scans: int, beams: int) -> None:
            share = "" if log.share_read is None else f"{100 * log.share_read:.0f} %: "
            lines.say(lambda: share + mapping_line(scans, beams, time.monotonic() - begin, target))

        yield say
        return
    from rich import progress as bars
    from rich.progress import BarColumn, TextColumn, TimeRemainingColumn

    columns = (BarColumn(), TextColumn("{task.description}"), TimeRemainingColumn())
    with bars.Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("", total=None)

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
