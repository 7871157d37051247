# SPDX-License-Identifier: BSD-3-Clause
"""Measurements that wait to be mapped: a bounded number, of which the oldest is dropped."""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from ndtree.logs.ros.clock import LATEST


@dataclass(frozen=True)
class Entry:
    """A measurement, and when it came."""

    item: Any  # What the mapper's intake understands.
    received: float  # By the clock of its source [s].
    arrived: float  # By `time.perf_counter` [s].


class ScanQueue:
    """Measurements in the order of arrival, or of several sensors in the order of their stamps.

    Threads that share it hold a lock of theirs.

    `capacity`: Of more that wait, the oldest is dropped.
    """

    def __init__(self, capacity: int) -> None:
        self.capacity = capacity
        self.dropped = 0
        self._number = 0
        self._heap: list[tuple[float, int, Entry]] = []
        self._key: Callable[[Any], tuple[str, float]] | None = None
        self._latest: dict[str, float] = {}
        self._first = math.inf

    def __len__(self) -> int:
        return len(self._heap)

    @property
    def is_full(self) -> bool:
        """Whether one more drops another."""
        return len(self._heap) >= self.capacity

    def put(self, entry: Entry) -> None:
        """Add one at the end."""
        self._push(self._number, entry)
        self._number += 1

    def _push(self, number: int, entry: Entry) -> None:
        stamp = 0.0
        if self._key is not None:
            topic, stamp = self._key(entry.item)
            self._latest[topic] = max(self._latest.get(topic, -math.inf), stamp)
            self._first = min(self._first, stamp)
        heapq.heappush(self._heap, (stamp, number, entry))

    def begin_again(self, entries: Iterable[Entry]) -> None:
        """Let these wait, as they arrived, and what waits already behind them."""
        waiting = sorted([*entries, *self.entries()], key=lambda entry: entry.arrived)
        self._heap, self._key, self._number = [], None, 0
        for entry in waiting:
            self.put(entry)

    def drop(self) -> None:
        """Drop the oldest, and count it."""
        heapq.heappop(self._heap)
        self.dropped += 1

    def oldest(self) -> Entry | None:
        """The one that is next; None where there is none."""
        return self._heap[0][2] if self._heap else None

    def entries(self) -> list[Entry]:
        """All that wait, in their order."""
        return [entry for _, _, entry in sorted(self._heap, key=lambda one: one[:2])]

    def order_by(self, key: Callable[[Any], tuple[str, float]], sensors: Iterable[str]) -> None:
        """Put what waits in the order of stamps, from now on; `key` tells an item's sensor and stamp [s]."""
        waiting, self._heap, self._key = self._heap, [], key
        self._latest = dict.fromkeys(sensors, -math.inf)
        self._first = math.inf
        for _, number, entry in waiting:
            self._push(number, entry)

    def take(self, *, everything: bool = False) -> Entry | None:
        """Take the next one out; None where none is left, or another one may still belong before it.

        That is so until every sensor has measured later, but for those that were silent for a second. With
        `everything` nothing more comes.
        """
        if not self._heap:
            return None
        if self._key is not None and not everything:
            stamp = self._heap[0][0]
            newest = max(self._latest.values())
            oldest = newest - LATEST if newest - self._first >= LATEST else -math.inf
            alive = min(latest for latest in self._latest.values() if latest >= oldest)
            if stamp > alive and stamp >= newest - LATEST:
                return None
        return heapq.heappop(self._heap)[2]
