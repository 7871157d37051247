# SPDX-License-Identifier: BSD-3-Clause
"""How far scans saw: what lies where others saw through contradicts them."""

from __future__ import annotations

import numpy as np

from ndtree.alignment.planar import Floats
from ndtree.alignment.sensor_scans import SensorScan

_MARGIN = 0.15  # Of ranges that are the same [m].


class Outline:
    """How far a scan saw, by bearing."""

    def __init__(self, scan: SensorScan) -> None:
        bearings = np.arctan2(scan.free[:, 1], scan.free[:, 0])
        order = np.argsort(bearings, kind="stable")
        self._bearings = bearings[order]
        self._ranges = np.hypot(scan.free[:, 0], scan.free[:, 1])[order]
        gaps = np.diff(self._bearings)
        self._widest = 2.5 * float(np.median(gaps)) if len(gaps) else 0.0

    def judge(self, points: Floats) -> tuple[int, int]:
        """How many points of this scan's frame lie where it saw a surface, and where it saw through."""
        if len(self._bearings) < 4:
            return 0, 0
        ranges = np.hypot(points[:, 0], points[:, 1])
        bearings = np.arctan2(points[:, 1], points[:, 0])
        after = np.searchsorted(self._bearings, bearings)
        inside = (after > 1) & (after < len(self._bearings) - 1)
        after, ranges = after[inside], ranges[inside]
        inside = self._bearings[after] - self._bearings[after - 1] <= self._widest
        after, ranges = after[inside], ranges[inside]
        around = np.stack([self._ranges[after + i] for i in (-2, -1, 0, 1)])
        low, high = around.min(axis=0) - _MARGIN, around.max(axis=0) + _MARGIN
        return int(np.count_nonzero((ranges > low) & (ranges < high))), int(np.count_nonzero(ranges <= low))
