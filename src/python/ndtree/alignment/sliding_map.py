# SPDX-License-Identifier: BSD-3-Clause
"""The last key scans of a track: a map to match with, and what they saw through."""

from __future__ import annotations

import numpy as np

from ndtree._native._core import Matcher
from ndtree.alignment.planar import Floats, between, placed
from ndtree.alignment.sensor_scans import Outline, SensorScan, Track

MAP_WAY = 10.0  # How long the way of the key scans is, at most [m],
_MAP_SCANS = 60  # and how many there are.
#: The last scans, some of which may be placed again: odometry may stall for two fewer. The outlines of as
#: many key scans are kept, and of the key scans before, with which they are compared.
KEPT = 16
_COMPARED = 4  # Key scans whose outlines are compared.


class SlidingMap:
    """The last key scans of a track.

    Parameters
    ----------
    track : Track
        Whose key scans they are; key scans that it has already are not in the map.
    cell_size : float
        Of the map [m].
    """

    def __init__(self, track: Track, cell_size: float) -> None:
        self._track = track
        self._cell_size = cell_size
        self._matcher: Matcher | None = None
        self._points = [np.zeros((0, 2)) for _ in track.keys]  # End points of key scans where they were.
        self._outlines: dict[int, Outline] = {}  # Of the last key scans, by their numbers.

    @property
    def matcher(self) -> Matcher:
        """Of all of it."""
        if self._matcher is None:
            self._matcher = self.matcher_of(len(self._track.keys))
        return self._matcher

    def matcher_of(self, count: int, *more: Floats) -> Matcher:
        """Of the map as it was when there were a number of key scans, and of more points."""
        points = [*self._points[self._first(count) : count], *more]
        return Matcher(np.concatenate(points), cell_size=self._cell_size)

    def through(self, scan: SensorScan, pose: Floats, before: int | None = None) -> float:
        """Fraction of a scan's points at a pose that lie where key scans before some number saw through."""
        track, keys = self._track, range(len(self._track.keys) if before is None else before)[-_COMPARED:]
        judged = [
            self._outlines[key].judge(placed(between(track.poses[track.keys[key]], pose), scan.points))
            for key in keys
            if key in self._outlines
        ]
        same, through = (sum(counts) for counts in zip((0, 0), *judged))
        return through / max(same + through, 1)

    def keep(self, scan: SensorScan, pose: Floats, way: float) -> None:
        """Take the track's last scan as a key scan, after a way [m]."""
        track = self._track
        track.through.append(self.through(scan, pose) if self._outlines else 0.0)
        track.keys.append(len(track.poses) - 1)
        track.scans.append(scan)
        track.way.append(way)
        self._points.append(placed(pose, scan.points))
        self._outlines[len(track.keys) - 1] = Outline(scan)
        self._outlines.pop(len(track.keys) - 1 - _COMPARED - KEPT, None)
        if len(self._points) > _MAP_SCANS:  # Only the last are looked at.
            self._points[-_MAP_SCANS - 1] = np.zeros((0, 2))
        self._matcher = None

    def move(self, number: int, scan: SensorScan, pose: Floats) -> None:
        """Place a key scan elsewhere."""
        self._points[number] = placed(pose, scan.points)
        self._track.through[number] = self.through(scan, pose, number)
        self._matcher = None

    def _first(self, count: int) -> int:
        """The first of a number of key scans that is in the map."""
        way, first = self._track.way, max(0, count - _MAP_SCANS)
        while first < count - 1 and way[count - 1] - way[first] > MAP_WAY:
            first += 1
        return first
