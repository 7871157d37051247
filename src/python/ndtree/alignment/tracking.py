# SPDX-License-Identifier: BSD-3-Clause
"""Scans matched one after the other with those before: odometry from a laser.

Strategy: a scan is matched with a sliding map of the last key scans, at its pose by odometry, in a
window as large as odometry may be wrong. A scan that fits worse than those before it is looked for in a wide
window, too, because wheels slip. It is found there only if many more of its points fit. A scan that is far
enough from the last key scan becomes one, with a relation to it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from ndtree._native._core import Matcher
from ndtree.alignment.planar import Floats, between, composed, placed, pose_of, turned
from ndtree.alignment.sensor_scans import SensorScan


@dataclass(frozen=True)
class Motion:
    """How far odometry may be wrong, as standard deviations."""

    still: float = 0.02  # Of a place, whatever the way [m];
    still_angle: float = 0.01  # of the yaw [rad];
    rate: float = 0.1  # of a way, of a turn;
    turn: float = 0.02  # of the yaw for a way [rad/m].

    def sigmas(self, step: Floats, has_heading: bool) -> Floats:
        """Of x, y and yaw, for one motion."""
        way = math.hypot(step[0], step[1])
        place = self.still + self.rate * way
        turned = abs(step[2]) if has_heading else _SOME_TURN
        return np.array([place, place, self.still_angle + self.turn * way + self.rate * turned])


#: Of logs without odometry: the scan before moved so, this one does nearly.
NO_ODOMETRY = Motion(still=0.08, still_angle=0.05, rate=0.5, turn=0.1)

_SOME_TURN = 0.2  # Where a log does not say how far the sensor turned [rad].
_SIGMAS = 3.0  # Of odometry, that the window has to each side.
_LARGEST = np.array([1.0, 1.0, 0.5])  # Window of one step [m, m, rad].
_WIDE = np.array([1.0, 1.0, 0.6])
_POOR = 0.75  # Of the score of scans before: below it, the wide window is looked at, too,
_GAIN = 0.2  # and believed if this fraction of the points fits more.
_LOST = 0.3  # Fewer points on surfaces are no match.
_REMEMBERED = 30  # Scans whose scores are compared.
_FEWEST = 10  # Points of a scan that says something.
_MAP_SCANS = 60  # Key scans of the sliding map,
_MAP_WAY = 10.0  # and how long their way is, at most [m].


@dataclass
class Track:
    """Where scans were, each as it was matched with those before."""

    poses: list[Floats] = field(default_factory=list)  # Of all scans.
    keys: list[int] = field(default_factory=list)  # Scans that are key scans.
    scans: list[SensorScan] = field(default_factory=list)  # Of the key scans.
    way: list[float] = field(default_factory=list)  # Up to each key scan [m].
    relations: list[Floats] = field(default_factory=list)  # Of each key scan to the next.
    covariances: list[Floats] = field(default_factory=list)  # Of these.
    lost: int = 0  # Scans that did not match.
    found: int = 0  # Scans that were found in the wide window.


class Tracker:
    """Places scans one by one.

    Parameters
    ----------
    cell_size : float
        Of the matched map [m].
    motion : Motion
        How wrong odometry may be.
    has_odometry : bool
        Whether poses of scans say how the sensor moved.
    """

    def __init__(self, cell_size: float, motion: Motion, has_odometry: bool = True) -> None:
        self.track = Track()
        self._cell_size = cell_size
        self._motion = motion
        self._has_odometry = has_odometry
        self._matcher: Matcher | None = None
        self._map: list[Floats] = []  # End points of key scans where they were.
        self._scores: list[float] = []
        self._last: Floats | None = None  # Pose of the last scan in the log.
        self._step = np.zeros(3)  # What the last scan moved.
        self._key_distance, self._key_angle = 4 * cell_size, 0.15

    def add(self, scan: SensorScan) -> None:
        """Place the next scan."""
        track = self.track
        if self._last is None:
            self._last = scan.pose
            track.poses.append(scan.pose)
            self._keep(scan, scan.pose, 0.0)
            return
        step = between(self._last, scan.pose) if self._has_odometry else self._step
        self._last = scan.pose
        guess = composed(track.poses[-1], step)
        sigmas = self._motion.sigmas(step, scan.has_heading)
        pose, covariance, score = self._matched(scan, guess, sigmas)
        self._step = between(track.poses[-1], pose)
        track.poses.append(pose)
        key = track.poses[track.keys[-1]]
        relation = between(key, pose)
        way = math.hypot(relation[0], relation[1])
        if way >= self._key_distance or abs(relation[2]) >= self._key_angle:
            self._scores.append(score)
            track.relations.append(relation)
            track.covariances.append(turned(covariance, key[2]))
            self._keep(scan, pose, track.way[-1] + way)

    def _matched(self, scan: SensorScan, guess: Floats, sigmas: Floats) -> tuple[Floats, Floats, float]:
        """Pose, covariance and score of a scan."""
        by_odometry = np.diag(sigmas**2)
        if len(scan.points) < _FEWEST:
            return guess, by_odometry, 0.0
        matcher = self._sliding_map()
        information = np.diag(sigmas**-2)
        window = np.minimum(_SIGMAS * sigmas, _LARGEST)
        match = matcher.match(scan.points, guess, window=window, information=information, second=False)
        before = self._scores[-_REMEMBERED:]
        if len(before) > 5 and match.score < _POOR * float(np.median(before)):
            wide = matcher.match(scan.points, guess, window=_WIDE, information=information, second=False)
            if wide.score > match.score + _GAIN:
                match = wide
                self.track.found += 1
        if match.inliers < _LOST:
            self.track.lost += 1
            return guess, by_odometry, match.score
        return pose_of(match.pose), match.covariance, match.score

    def _sliding_map(self) -> Matcher:
        if self._matcher is None:
            way = self.track.way
            first = max(0, len(way) - _MAP_SCANS)
            while first < len(way) - 1 and way[-1] - way[first] > _MAP_WAY:
                first += 1
            self._matcher = Matcher(np.concatenate(self._map[first:]), cell_size=self._cell_size)
        return self._matcher

    def _keep(self, scan: SensorScan, pose: Floats, way: float) -> None:
        track = self.track
        track.keys.append(len(track.poses) - 1)
        track.scans.append(scan)
        track.way.append(way)
        self._map.append(placed(pose, scan.points))
        if len(self._map) > _MAP_SCANS:  # Only the last are looked at.
            self._map[-_MAP_SCANS - 1] = np.zeros((0, 2))
        self._matcher = None
