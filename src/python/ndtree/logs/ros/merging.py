# SPDX-License-Identifier: BSD-3-Clause
"""Messages of several sensors as one stream."""

from __future__ import annotations

import heapq
from collections.abc import Iterator

import numpy as np

from ndtree.logs.ros.clock import Clock
from ndtree.logs.ros.messages.head import head_of
from ndtree.logs.ros.storage import Raw

#: Messages of several sensors are put into the order of their stamps if they come no later than this [s].
LATEST = 1.0


def in_order(messages: Iterator[Raw], clock: Clock) -> Iterator[Raw]:
    """Messages of several sensors in the order of their stamps, as far as they come soon enough."""
    waiting: list[tuple[float, int, Raw]] = []
    latest = -np.inf
    for number, raw in enumerate(messages):
        head = head_of(raw)
        received = 1e-9 * raw.received
        stamp, frame = head if head is not None else (received, "")
        stamp = clock.time((raw.connection.topic, frame), received, stamp)
        latest = max(latest, stamp)
        heapq.heappush(waiting, (stamp, number, raw))
        while waiting[0][0] < latest - LATEST:
            yield heapq.heappop(waiting)[2]
    while waiting:
        yield heapq.heappop(waiting)[2]
