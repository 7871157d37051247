# SPDX-License-Identifier: BSD-3-Clause
"""Recordings as sources of a live mapper, at their own pace or another."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from ndtree.live.mapper import LiveMapper
from ndtree.logs.core.log import Log
from ndtree.logs.ros.files.bag import Bag
from ndtree.logs.ros.storage import OnDamage

#: A longer time between two items is no pause, but a clock that has jumped [s].
LONGEST_PAUSE = 10.0
#: What is played of a log without times [s between scans].
NO_TIMES = 0.1


def messages_of(bag: Bag, on_damage: OnDamage | None = None) -> Iterator[tuple[Any, float]]:
    """Messages of a bag, and when each was recorded [s]; raises, or notes, where it is damaged."""
    for raw in bag.messages([one.name for one in bag.topics], on_damage):
        yield raw, 1e-9 * raw.received


def scans_of(log: Log) -> Iterator[tuple[Any, float]]:
    """The scans of a log, and when each was measured [s]."""
    for number, scan in enumerate(log):
        yield scan, scan.stamp or NO_TIMES * number


def play(
    items: Iterable[tuple[Any, float]],
    mapper: LiveMapper,
    *,
    rate: float = 1.0,
    now: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> None:
    """Give a mapper what was recorded, when it is time.

    Parameters
    ----------
    items : iterable of (item, float)
        Each with the time at which it was received [s].
    mapper : LiveMapper
    rate : float
        Seconds of the recording in one second; 0: as fast as they are mapped, and nothing is dropped.
    now, sleep : callable
        The clock that is used [s].

    Raises
    ------
    ValueError
        If `rate` is negative or not finite; and what ended the mapper.
    """
    if not 0 <= rate < math.inf:
        raise ValueError(f"rate = {rate:g}: must be >= 0 and finite; 0 is as fast as it goes")
    begin, at, last = now(), 0.0, None
    for item, received in items:
        if rate > 0 and last is not None:
            step = received - last
            at += step / rate if 0 < step <= LONGEST_PAUSE else 0.0
            ahead = begin + at - now()
            if ahead > 0:
                sleep(ahead)
        last = received
        mapper.put(item, received, wait=rate == 0)
