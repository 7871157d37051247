# SPDX-License-Identifier: BSD-3-Clause
"""What shows a map while it grows: a page, Foxglove, rerun, and ndtree view of another computer."""

import sys
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from typing import Any, Optional

from ndtree._native._core import OccupancyMap
from ndtree.base.scan import Scan
from ndtree.cli.commands.flags import Call
from ndtree.cli.commands.logs import made
from ndtree.live import Way

#: A sink is left alone for this many times as long as it took.
RESTS = 5.0


def sinks_of(call: Call, frame: Callable[[], str], way: Way, stack: ExitStack) -> list[Any]:
    """What gives the map to Foxglove and writes it for rerun, as a call wants it, until a stack is closed."""
    sinks: list[Any] = []
    if call.foxglove is not None:
        from ndtree.live import FoxgloveSink

        sinks.append(made(lambda: FoxgloveSink(call.foxglove, frame=frame, way=way)))
        print(f"{sinks[0].url} shows the map to Foxglove as it grows", file=sys.stderr, flush=True)
    if call.rerun is not None:
        from ndtree.live import RerunSink

        sinks.append(made(lambda: RerunSink(call.rerun, way=way)))
    for sink in sinks:
        stack.callback(sink.close)
    return sinks


def url_of(sinks: Sequence[Any]) -> str:
    """Where a server shows the map; "" where none does."""
    return next((one.url for one in sinks if hasattr(one, "url")), "")


def wait_at(url: str) -> None:
    """Until the user interrupts."""
    with suppress(KeyboardInterrupt):
        print(f"{url} until Ctrl-C", file=sys.stderr, flush=True)
        threading.Event().wait()


class Showing:
    """An observer of a map that shows it to sinks, each no more often than its period."""

    def __init__(self, sinks: Sequence[Any], way: Way) -> None:
        self.url = url_of(sinks)
        self._due = [(sink, 0.0) for sink in sinks]
        self._way = way
        self._stamp = 0.0

    def update(self, m: OccupancyMap, scan: Scan) -> None:
        """Show the map after a scan to those whose time has come."""
        self._way.add(scan)
        self._stamp = scan.stamp
        for number, (sink, due) in enumerate(self._due):
            begin = time.monotonic()
            if begin >= due:
                sink.update(m.snapshot(), self._stamp)
                took = time.monotonic() - begin
                self._due[number] = sink, begin + max(sink.period, RESTS * took)

    def end(self, m: OccupancyMap) -> None:
        """Show the map as it became to all."""
        for sink, _ in self._due:
            sink.update(m.snapshot(), self._stamp)


def showing(call: Call, stack: ExitStack) -> Optional[Showing]:
    """Who shows the map to Foxglove, rerun or both, until a stack is closed; None without either."""
    way = Way()
    sinks = sinks_of(call, lambda: "map", way, stack)
    return Showing(sinks, way) if sinks else None
