# SPDX-License-Identifier: BSD-3-Clause
"""A thread that shows sinks snapshots of a live map, so that a slow one holds up no scan."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Sequence

from ndtree.live.figures import LiveFigures
from ndtree.live.settings import Sink
from ndtree.live.target import Target

#: It looks up so often although nothing happens [s].
_LOOKS = 0.05
#: A sink is left alone for this many times as long as it took of the processor.
_RESTS = 5.0


class Publisher:
    """Shows a target to sinks, each no more often than its period.

    Attributes:
    `failures`: By sink, the last thing that went wrong.
    """

    def __init__(self, target: Target, sinks: Sequence[Sink], figures: LiveFigures) -> None:
        self._target, self._figures = target, figures
        self.failures: dict[str, str] = {}
        self._due = [(sink, -math.inf) for sink in sinks]  # And when it may be shown the map again [s].
        self._shown: dict[int, int] = {}
        self._wake = threading.Condition()
        self._arrived: list[float] = []
        self._is_awake = self._is_closing = False
        self._thread = threading.Thread(target=self._run, name="ndtree-live-sinks", daemon=True)
        if sinks:
            self._thread.start()

    def wake(self, *arrived: float) -> None:
        """The map has changed, by scans that arrived at these times [s]."""
        if self._due:
            with self._wake:
                self._arrived += arrived
                self._is_awake = True
                self._wake.notify()

    def close(self) -> None:
        """Show the last map to all."""
        if not self._due:
            return
        with self._wake:
            self._is_closing = True
            self._wake.notify()
        self._thread.join()

    def _run(self) -> None:
        while True:
            with self._wake:
                if not self._is_awake and not self._is_closing:
                    self._wake.wait(self._pause())
                closing, self._is_awake = self._is_closing, False
                arrived, self._arrived = self._arrived, []
            self._show(closing, arrived)
            if closing:
                return

    def _pause(self) -> float:
        """How long nothing is to be shown, if nothing happens [s]."""
        now, revision = time.monotonic(), self._target.revision
        behind = [at for number, (_, at) in enumerate(self._due) if self._shown.get(number) != revision]
        return min(max(min(behind, default=math.inf) - now, 0.0), _LOOKS) or 1e-3

    def _show(self, closing: bool, arrived: list[float]) -> None:
        now = time.monotonic()
        revision = self._target.revision
        due = [
            number
            for number, (sink, next_time) in enumerate(self._due)
            if (closing or now >= next_time) and self._shown.get(number) != revision
        ]
        if not due or not self._target.has_map:
            self._arrived[:0] = arrived
            return
        with self._target.lock:
            m, stamp, revision = self._target.snapshot(), self._target.stamp, self._target.revision
        at_once = False
        for number in due:
            sink, _ = self._due[number]
            begin = time.thread_time()
            try:
                sink.update(m, stamp)
                self.failures.pop(type(sink).__name__, None)
            except Exception as error:  # A sink that fails does not stop the map.
                self.failures[type(sink).__name__] = f"{type(error).__name__}: {error}"
            took = time.thread_time() - begin
            self._due[number] = sink, now + max(sink.period, _RESTS * took)
            self._shown[number] = revision
            at_once |= sink.period == 0
        if not at_once:
            self._arrived[:0] = arrived
        else:
            shown = time.perf_counter()
            self._figures.published_delays.extend(shown - one for one in arrived)
