# SPDX-License-Identifier: BSD-3-Clause
"""Where a sensor has been, and where a robot's base is."""

from __future__ import annotations

import threading
from collections import deque

import numpy as np
from numpy.typing import NDArray

from ndtree.base.scan import Scan
from ndtree.live.intake import Intake

#: From one point of a way to the next [m], and how many are kept.
STEP, MOST = 0.1, 10_000


def last_origin(scan: Scan) -> NDArray[np.float64] | None:
    """Where a scan's sensor was at last [m]; None if that is not known."""
    origins = np.atleast_2d(scan.origin)
    known = len(origins) and np.isfinite(origins[-1]).all()
    return origins[-1].astype(np.float64) if known else None


class Way:
    """Points that a sensor has passed, the oldest first; of more than 10,000 the oldest are forgotten."""

    def __init__(self) -> None:
        self._points: deque[NDArray[np.float64]] = deque(maxlen=MOST)
        self._lock = threading.Lock()

    def begin(self) -> None:
        """Forget all points."""
        with self._lock:
            self._points.clear()

    def add(self, scan: Scan) -> None:
        """Take note of a scan's sensor, if it is 0.1 m from the last point."""
        origin = last_origin(scan)
        if origin is None:
            return
        point = np.zeros(3)
        point[: scan.dim] = origin
        with self._lock:
            if not self._points or np.linalg.norm(point - self._points[-1]) >= STEP:
                self._points.append(point)

    def points(self) -> NDArray[np.float64]:
        """All of them, (n, 3) [m]; those of a 2-D map lie at z = 0."""
        with self._lock:
            return np.array(self._points).reshape(-1, 3)


class Robot:
    """Follows a robot's base in the map; the sensor, where nothing tells how that moves on the robot.

    It gets scans as a `Way` does, from the thread that maps.

    `intake`: Knows the poses of the last scan.
    Attributes:
    `position` (3,) or None: Of the base at the last scan [m]; None before the first.
    """

    def __init__(self, intake: Intake) -> None:
        self._intake = intake
        self.position: NDArray[np.float64] | None = None

    def begin(self) -> None:
        """Forget where it was."""
        self.position = None

    def add(self, scan: Scan) -> None:
        """Take note of where it was when a scan was measured."""
        motion = self._intake.motion()
        if motion is not None:
            self.position = (motion.sensor @ motion.mount.inverse()).position
            return
        origin = last_origin(scan)
        if origin is not None:
            self.position = np.r_[origin, np.zeros(3 - scan.dim)]
