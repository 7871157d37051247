# SPDX-License-Identifier: BSD-3-Clause
"""What shows a map while it grows, to Foxglove and to rerun."""

import sys
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from typing import TYPE_CHECKING, Any, Optional

from ndtree._native._core import OccupancyMap
from ndtree.base.scan import Scan
from ndtree.cli.commands.logs import made
from ndtree.live import Way

if TYPE_CHECKING:
    from ndtree.live import FoxgloveSink, RerunSink

#: A sink is left alone for this many times as long as it took.
RESTS = 5.0


def foxglove_sink(port: int, frame: Callable[[], str], way: Way, stack: ExitStack) -> "FoxgloveSink":
    """A server for Foxglove, that ends with the command."""
    from ndtree.live import FoxgloveSink

    sink = made(lambda: FoxgloveSink(port, frame=frame, way=way))
    stack.callback(sink.close)
    print(f"{sink.url} shows the map to Foxglove as it grows", file=sys.stderr, flush=True)
    return sink


def rerun_sink(target: str, way: Way, stack: ExitStack) -> "RerunSink":
    """What writes for rerun, until the command ends."""
    from ndtree.live import RerunSink

    sink = made(lambda: RerunSink(target, way=way))
    stack.callback(sink.close)
    return sink


def wait_at(url: str) -> None:
    """Until the user interrupts."""
    with suppress(KeyboardInterrupt):
        print(f"{url} until Ctrl-C", file=sys.stderr, flush=True)
        threading.Event().wait()


class Showing:
    """An observer of a map that shows it to sinks, each no more often than its period.

    `url`: Where a server shows it; "" where none does.
    """

    def __init__(self, sinks: Sequence[Any], way: Way) -> None:
        self.url: str = next((one.url for one in sinks if hasattr(one, "url")), "")
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


def showing(foxglove: Optional[int], rerun: Optional[str], stack: ExitStack) -> Optional[Showing]:
    """Who shows the map to Foxglove, rerun or both, until a stack is closed; None without either."""
    way, sinks = Way(), list[Any]()
    if foxglove is not None:
        sinks.append(foxglove_sink(foxglove, lambda: "map", way, stack))
    if rerun is not None:
        sinks.append(rerun_sink(rerun, way, stack))
    return Showing(sinks, way) if sinks else None
