# SPDX-License-Identifier: BSD-3-Clause
"""Where a sensor has been."""

from __future__ import annotations

import threading
from collections import deque

import numpy as np
from numpy.typing import NDArray

from ndtree.base.scan import Scan

#: From one point of a way to the next [m], and how many are kept.
STEP, MOST = 0.1, 10_000


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
        origins = np.atleast_2d(scan.origin)
        if not len(origins) or not np.isfinite(origins[-1]).all():
            return
        point = np.zeros(3)
        point[: scan.dim] = origins[-1]
        with self._lock:
            if not self._points or np.linalg.norm(point - self._points[-1]) >= STEP:
                self._points.append(point)

    def points(self) -> NDArray[np.float64]:
        """All of them, (n, 3) [m]; those of a 2-D map lie at z = 0."""
        with self._lock:
            return np.array(self._points).reshape(-1, 3)
