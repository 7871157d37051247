# SPDX-License-Identifier: BSD-3-Clause
"""Scans in their sensor's frame: what they saw and where they were; and logs whose scans are elsewhere."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ndtree.alignment.planar import Floats, placed, seen_from
from ndtree.base.scan import Scan
from ndtree.logs.core.log import DerivedLog, Log

#: Beams of a scan that are matched, at most: evenly spread, more are no surer.
MOST_BEAMS = 400
_LEAST_RANGE = 0.1  # Nearer end points are the robot's own [m].


@dataclass(frozen=True)
class SensorScan:
    """One scan.

    `points` (n, 2) float64: End points of beams that returned, in the sensor's frame [m].
    `free` (m, 2) float64: End points of all beams: it is free up to there [m].
    `pose` (3,) float64: The log's: x, y and yaw; yaw is 0 where the log does not say it, and the frame is
        turned as the map's.
    """

    points: Floats
    free: Floats
    pose: Floats
    stamp: float  # Of the scan [s].
    has_heading: bool = True  # Whether the log says yaw.


def pose_in_log(scan: Scan) -> Floats:
    """x, y and yaw of a scan as its log has it."""
    origin = scan.origin if scan.origin.ndim == 1 else scan.origin.mean(axis=0)
    heading = 0.0 if scan.heading is None else scan.heading
    return np.array([float(origin[0]), float(origin[1]), heading])


def ends_to_match(scan: Scan, ranges: Floats, max_range: float) -> NDArray[np.bool_]:
    """Whether each end point of a scan is a surface to match: not the robot's own, nor farther."""
    return scan.did_return & np.isfinite(ranges) & (ranges > _LEAST_RANGE) & (ranges <= max_range)


def spread_evenly(points: Floats, most: int) -> Floats:
    """Every second, third, ... of points, at most `most`."""
    return points[:: max(1, math.ceil(len(points) / most))]


def sensor_scans(log: Log, max_range: float) -> Iterator[SensorScan]:
    """All scans of a log in 2-D; farther end points are left out."""
    for scan in log:
        yield sensor_scan(scan, max_range)


def sensor_scan(scan: Scan, max_range: float) -> SensorScan:
    """One scan in 2-D; farther end points are left out."""
    scan.require_sensor("poses")
    pose = pose_in_log(scan)
    local = seen_from(pose, scan.endpoints.astype(np.float64))
    ranges = np.hypot(local[:, 0], local[:, 1])
    free = np.isfinite(ranges) & (ranges > _LEAST_RANGE)
    points = spread_evenly(local[ends_to_match(scan, ranges, max_range)], MOST_BEAMS)
    return SensorScan(points, local[free], pose, scan.stamp, scan.heading is not None)


_MARGIN = 0.15  # Of ranges that are the same [m].


class Outline:
    """How far a scan saw, by bearing: what lies where it saw through contradicts it."""

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


@dataclass(frozen=True)
class Step:
    """A scan whose match contradicts odometry.

    Parameters
    ----------
    scan : int
        Its number.
    is_sure : bool
        Whether it fits as well as others do, and nowhere else near.
    """

    scan: int
    is_sure: bool


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
    against: list[Step] = field(default_factory=list)  # Odometry.
    unfixed: list[float] = field(default_factory=list)  # Way of each scan that only odometry tells [m].
    #: Of each key scan: points where those before saw through.
    through: list[float] = field(default_factory=list)
    ratios: list[float] = field(default_factory=list)  # Of ways that scans say, to those of odometry.
    final: int = 0  # Key scans up to whose last all stays as it is.

    def copy(self) -> Track:
        """One that can be gone on with by itself."""
        return Track(
            **{name: list(one) if isinstance(one, list) else one for name, one in vars(self).items()}
        )


class AlignedLog(DerivedLog):
    """A log with other poses, one for each of its scans; it is read as lazily as the log.

    Raises ValueError when it is read, if the log has another number of scans than there are poses.
    """

    def __init__(self, log: Log, poses: Floats) -> None:
        super().__init__(log)
        self._poses = poses

    def __len__(self) -> int:
        return len(self._poses)

    def _moved(self, scan: Scan, pose: Floats) -> Scan:
        return moved(scan, pose)

    def _scans(self) -> Iterator[Scan]:
        count = 0
        for scan in self._log:
            if count == len(self._poses):
                break
            yield self._moved(scan, self._poses[count])
            count += 1
        else:
            if count == len(self._poses):
                return
        raise ValueError(f"{self.name}: has not the {len(self._poses)} scans that were aligned")


def moved(scan: Scan, pose: Floats) -> Scan:
    """A scan whose sensor is at another pose."""
    before = pose_in_log(scan)

    def there(points: Floats) -> Floats:
        return placed(pose, seen_from(before, np.atleast_2d(points).astype(np.float64)))

    origin = there(scan.origin)
    return replace(
        scan,
        endpoints=there(scan.endpoints),
        origin=origin[0] if scan.origin.ndim == 1 else origin,
        heading=None if scan.heading is None else float(pose[2]),
        pose_covariance=None,  # That of the log's pose.
    )
