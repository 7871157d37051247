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
from ndtree.logs.core.joined import Again

#: A bar is drawn anew after so long [s].
REFRESH = 0.2
#: Where standard error is no terminal, a line says so often how far a command is, if it takes that long [s].
LINE_EVERY = 10.0


#: Of a step, shows a text, which is told whether a bar is beside it, and how much is done, of how much; 0 is
#: unknown.
_Show = Callable[[str, Callable[[bool], str], float, float], None]


@contextmanager
def _shown(*columns: str) -> Iterator[_Show]:
    """A bar of these columns on a terminal; else a line on standard error now and then."""
    last = time.monotonic()
    console: Any = None
    if sys.stderr.isatty():  # Else nothing is loaded for it.
        from rich.console import Console

        console = Console(stderr=True)
    if console is None or not console.is_terminal:

        def say(step: str, text: Callable[[bool], str], done: float, total: float) -> None:
            nonlocal last
            if time.monotonic() - last >= LINE_EVERY:
                last = time.monotonic()
                print(text(False), file=sys.stderr, flush=True)

        yield say
        return
    from rich import progress as bars

    made = [
        bars.TextColumn("{task.description}") if one == "Text" else getattr(bars, f"{one}Column")()
        for one in columns
    ]
    with bars.Progress(*made, console=console, transient=True) as bar:
        task, before = bar.add_task("", total=None), 0.0
        shown: str | None = None

        def advance(step: str, text: Callable[[bool], str], done: float, total: float) -> None:
            nonlocal last, shown, before
            if step != shown or done < before:
                bar.reset(task)
            elif done != total and time.monotonic() - last < REFRESH:
                return
            last, shown, before = time.monotonic(), step, done
            bar.update(task, description=text(True), completed=done, total=total or None)

        yield advance


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
    with _shown("Text", "Bar", "MofNComplete", "TimeRemaining") as show:

        def advance(what: str, done: int, total: int) -> None:
            count = f"{what}: {done:,} of {total:,}" if total else f"{what}: {done:,}"
            show(what, lambda has_bar: what if has_bar else count, done, total)

        yield advance


@contextmanager
def mapping_progress(log: Log | Again, target: OccupancyMap) -> Iterator[Callable[[int, int], None]]:
    """A function of the scans and beams so far that shows how far a map is.

    The time left is shown for logs that can tell how much of them is read.
    """
    begin = time.monotonic()
    with _shown("Bar", "Text", "TimeRemaining") as show:

        def advance(scans: int, beams: int) -> None:
            share = log.share_read

            def text(has_bar: bool) -> str:
                line = mapping_line(scans, beams, time.monotonic() - begin, target)
                return line if has_bar or share is None else f"{100 * share:.0f} %: {line}"

            show("", text, share or 0.0, 0.0 if share is None else 1.0)

        yield advance


def mapping_line(scans: int, beams: int, seconds: float, target: OccupancyMap) -> str:
    """Scans, beams a second, leaves and memory of a map that grows."""
    stats = target.stats()
    return (
        f"{number_of(scans, 'scan')}, {beams / max(seconds, 1e-9):,.0f} beams/s, {stats.leaves:,} leaves, "
        f"{stats.memory_bytes / 2**20:.1f} MiB"
    )
