# SPDX-License-Identifier: BSD-3-Clause
"""What has come to a live mapper and is not mapped yet: measurements and poses, put by others' threads.

Invariant: measurements leave it in the order in which a recording of them would be read.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from typing import Any

from ndtree.live.figures import LiveFigures
from ndtree.live.intake import Intake
from ndtree.live.queue import Entry, ScanQueue
from ndtree.live.settings import LiveSettings
from ndtree.logs.poses.following import FALL

#: Threads look up so often although nothing happens [s].
_LOOKS = 0.05


class Feed:
    """Others put; the mapper's thread takes."""

    def __init__(self, intake: Intake, how: LiveSettings, figures: LiveFigures) -> None:
        self._intake, self._how, self._figures = intake, how, figures
        self._changed = threading.Condition()
        self._queue = ScanQueue(how.queue)
        self._poses: deque[tuple[Any, float]] = deque()
        self._latest, self._ahead = -math.inf, 0.0
        self._is_closing = self._is_starved = self._ordered = False
        self._error: BaseException | None = None
        #: Taken, and not mapped yet.
        self._held: Entry | None = None
        #: Measurements that are mapped again if it is decided anew how.
        self._kept: list[Entry] = []
        #: Of what had come before mapping began, what is not mapped yet: the queue may be longer by this.
        self._backlog = 0

    def put(self, item: Any, received: float, *, wait: bool) -> None:
        """As `LiveMapper.put`."""
        with self._changed:
            self.check()
            if self._is_closing:
                raise RuntimeError("the mapper is closed, expected no more items")
            is_pose = self._intake.is_pose(item)
            while wait and not is_pose and self._queue.is_full and not self._is_starved:
                self._changed.wait(_LOOKS)
                self.check()
            received = self._time(received)
            if self._ahead:
                item = self._intake.moved(item, received)
            if is_pose:
                self._figures.poses += 1
                self._poses.append((item, received))
            else:
                self._figures.received += 1
                self._intake.begin(received)
                if self._queue.is_full and not wait and self._may_drop():
                    self._queue.drop()
                self._queue.put(Entry(item, received, time.perf_counter()))
            self._is_starved = False
            self._changed.notify_all()

    def _time(self, received: float) -> float:
        """When something came, by a clock that goes on where that of the source is set back [s]."""
        if received + self._ahead < self._latest - FALL:
            self._ahead = self._latest - received
        self._latest = max(self._latest, received + self._ahead)
        return received + self._ahead

    def _may_drop(self) -> bool:
        """Whether the queue is full of more than what was looked at before mapping began."""
        oldest = self._queue.oldest()
        if self._intake.config is None:
            waits = self._intake.look + self._how.patience
            return oldest is not None and self._latest - oldest.received > waits
        return len(self._queue) >= self._queue.capacity + self._backlog

    def advance(self, now: float) -> None:
        """As `LiveMapper.advance`."""
        with self._changed:
            self._time(now)
            self._is_starved = False
            self._changed.notify_all()

    def close(self, *, drop: bool = False) -> None:
        """Nothing more comes; `drop` forgets what waits."""
        with self._changed:
            self._queue = ScanQueue(1) if drop else self._queue
            self._is_closing = True
            self._changed.notify_all()

    def check(self) -> None:
        """Raise what ended the mapper."""
        if self._error is not None:
            raise self._error

    # All of what follows is called by the mapper's thread.

    def end(self, error: BaseException | None = None) -> None:
        """Nothing more is taken."""
        self._error = error
        with self._changed:
            self._changed.notify_all()

    def pause(self) -> tuple[float, bool]:
        """Wait for something to do; the time of the source [s], and whether nothing more comes."""
        with self._changed:
            is_idle = not self._poses and (self._is_starved or not (self._held or len(self._queue)))
            if is_idle and not self._is_closing:
                self._changed.wait(_LOOKS)
            return self.now, self._is_closing

    @property
    def now(self) -> float:
        """The time of the source [s]: of what was received last, or was told."""
        return self._latest

    def take_pose(self, until: float) -> Any:
        """The next pose, if it was received until a time [s]; else None."""
        return self._poses.popleft()[0] if self._poses and self._poses[0][1] <= until else None

    def entries(self) -> list[Entry]:
        """Measurements that wait, behind those that were kept."""
        with self._changed:
            return [*self._kept, *self._queue.entries()]

    def poses(self) -> list[Entry]:
        """Poses that wait."""
        with self._changed:
            return [Entry(item, received, 0.0) for item, received in self._poses]

    def give_back(self, poses: list[tuple[Any, float]]) -> None:
        """Let poses that were taken wait before the others."""
        with self._changed:
            self._poses.extendleft(reversed(poses))

    def begin(self) -> None:
        """It is decided how to map: what waits may wait longer."""
        with self._changed:
            self._backlog = len(self._queue)

    def begin_again(self) -> float:
        """Let what was kept wait again, before what waits; what arrives later is new [s]."""
        with self._changed:
            self._queue.begin_again(self._kept)
            self._kept, self._held, self._ordered = [], None, False
            self._backlog = len(self._queue)
            self._figures.begin_again()
            return time.perf_counter()

    def decide(self) -> None:
        """Keep nothing any longer."""
        self._kept = []

    def head(self, *, closing: bool) -> Entry | None:
        """The measurement that is next, until `done`; None while none is, or an earlier one may come."""
        with self._changed:
            if len(self._intake.sensors) > 1 and not self._ordered:
                self._queue.order_by(self._intake.key, self._intake.sensors)
                self._ordered = True
            if self._held is None:
                self._held = self._queue.take(everything=closing)
                if self._held is not None and self._intake.may_revise:
                    self._kept.append(self._held)
            self._is_starved = self._held is None and len(self._queue) > 0
            self._figures.waiting = len(self._queue) + (self._held is not None)
            self._figures.dropped = self._queue.dropped
            self._changed.notify_all()
        return self._held

    def done(self) -> None:
        """The head of the queue is mapped, or left out."""
        self._held = None
        self._backlog = max(self._backlog - 1, 0)

    @property
    def is_empty(self) -> bool:
        """Whether nothing waits."""
        return not len(self._queue) and not self._poses

    def starve(self, *, but_for_poses: bool = False) -> None:
        """Let who puts know that what waits cannot be mapped before more comes."""
        with self._changed:
            self._is_starved = not (but_for_poses and self._poses)
            self._changed.notify_all()
