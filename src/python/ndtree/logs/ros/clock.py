# SPDX-License-Identifier: BSD-3-Clause
"""Bags whose clock begins at 0, or again, as where a simulator was reset or a recording played in a loop."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Hashable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from ndtree.logs.poses.following import FALL, LASTS
from ndtree.logs.ros.messages.foxglove import head_of
from ndtree.logs.ros.storage import Raw, in_order

#: Streams that begin anew within this time of each other do so together [s].
TOGETHER = 2.0
#: What is put between what came before, and what is measured again [s].
BETWEEN = 60.0
#: A stamp of 0 is a time where others of its stream begin before this [s]; else no time was given.
BEGINS = 60.0

#: When messages were received, and their stamps, in the order of receiving [s].
Stream = Sequence[tuple[float, float]]


class Clock:
    """Makes one time of stamps that begin again: those after are moved behind those before.

    A stamp of 0 says nothing, and the message counts as measured when it was received; unless its clock
    begins at 0, as a simulator's does.

    `streams`: Of each topic, or each transform on a topic: what one writer stamps should rise.
    Attributes:
    `falls`: Stamps at which it began again [s].
    `unstamped`: Streams most of whose stamps are 0, and no time.
    """

    def __init__(self, streams: Mapping[Hashable, Stream]) -> None:
        self._zero_is_time: dict[Hashable, bool] = {}
        for name, stream in streams.items():  # Whether some are 0 because a clock begins there.
            others = [stamp for _, stamp in stream if stamp]
            self._zero_is_time[name] = 0 < len(others) < len(stream) and 0 < min(others) < BEGINS
        self._zero_of_others = any(self._zero_is_time.values())
        self.unstamped: set[Any] = {
            name
            for name, stream in streams.items()
            if not self._zero_is_time[name] and 2 * sum(not stamp for _, stamp in stream) > len(stream)
        }
        for name, stream in streams.items():  # One message alone cannot tell.
            if len(stream) < 2:
                del self._zero_is_time[name]
        streams = {
            name: [(received, self.stamp(name, received, stamp)) for received, stamp in stream]
            for name, stream in streams.items()
        }
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
        stamp = self.stamp(name, received, stamp)
        return stamp + self._shifts[self._number(name, received)] if self._usual else stamp

    def stamp(self, name: Hashable, received: float, stamp: float) -> float:
        """What the stamp of a message says, by its own clock: when it was received if it says nothing [s]."""
        return stamp if stamp or self._zero_is_time.get(name, self._zero_of_others) else received

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


#: Messages of several sensors are put into the order of their stamps if they come no later than this [s].
LATEST = 1.0


def by_stamp(messages: Iterator[Raw], clock: Clock) -> Iterator[Raw]:
    """Messages of several sensors in the order of their stamps, as far as they come soon enough."""

    def rows() -> Iterator[tuple[float, float, Raw | None]]:
        latest = -np.inf
        for raw in messages:
            head, received = head_of(raw), 1e-9 * raw.received
            stamp, frame = head if head is not None else (received, "")
            stamp = clock.time((raw.connection.topic, frame), received, stamp)
            latest = max(latest, stamp)
            yield stamp, latest - LATEST, raw

    return in_order(rows())
