# SPDX-License-Identifier: BSD-3-Clause
"""Bags whose clock begins again, as where a simulator was reset or a recording was played in a loop."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Hashable, Mapping, Sequence

#: Stamps that fall by more than this from message to message begin anew [s]; less is late.
FALL = 2.0
#: And so many messages stay below, or as many as there are.
LASTS = 6
#: Streams that begin anew within this time of each other do so together [s].
TOGETHER = 2.0
#: What is put between what came before, and what is measured again [s].
BETWEEN = 60.0

#: When messages were received, and their stamps, in the order of receiving [s].
Stream = Sequence[tuple[float, float]]


class Clock:
    """Makes one time of stamps that begin again: those after are moved behind those before.

    Parameters
    ----------
    streams : mapping of Hashable to Stream
        Of each topic, or each transform on a topic: what one writer stamps should rise.

    Attributes
    ----------
    falls : list of float
        Stamps at which it began again [s].
    """

    def __init__(self, streams: Mapping[Hashable, Stream]) -> None:
        fallen = {name: _falls(stream) for name, stream in streams.items()}
        when = sorted(at for times in fallen.values() for at in times)
        begins: list[float] = []
        for at in when:
            if not begins or at > begins[-1] + TOGETHER:
                begins.append(at)
        self._usual = begins
        self._own = {
            name: [
                min((t for t in times if begin <= t <= begin + TOGETHER), default=begin) for begin in begins
            ]
            for name, times in fallen.items()
            if times
        }
        self._shifts = [0.0]
        self.falls: list[float] = []
        spans: list[list[float]] = [[] for _ in range(len(begins) + 1)]
        for name, stream in streams.items():
            for received, stamp in stream if begins else ():
                spans[self._number(name, received)].append(stamp)
        last = max(spans[0], default=0.0)
        for stamps in spans[1:]:
            self.falls.append(min(stamps))
            self._shifts.append(last + BETWEEN - min(stamps))
            last = max(stamps) + self._shifts[-1]

    def time(self, name: Hashable, received: float, stamp: float) -> float:
        """When a message of a stream was measured [s]."""
        return stamp + self._shifts[self._number(name, received)] if self._usual else stamp

    def _number(self, name: Hashable, received: float) -> int:
        """How often the clock had begun again when a message was received."""
        return bisect_right(self._own.get(name, self._usual), received)


def _falls(stream: Stream) -> list[float]:
    """When stamps fell, and stayed below what they had been [s]; some that are late are no fall."""
    found = []
    before = None
    for i, (received, stamp) in enumerate(stream):
        if before is not None and stamp < before - FALL:
            after = [later for _, later in stream[i + 1 : i + LASTS]]
            if not after or max(after) >= before - FALL:
                continue
            found.append(received)
        before = stamp
    return found
