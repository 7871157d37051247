# SPDX-License-Identifier: BSD-3-Clause
"""Poses of a 3-D log from what its scans saw: each matched with those before, and places seen again."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from ndtree._errors import WrongValue
from ndtree.alignment.aligning import STILL, is_confirmed, scale_of, told_scale
from ndtree.alignment.motion import NO_ODOMETRY, Motion
from ndtree.alignment.planar import Floats
from ndtree.alignment.result import FoundPoses
from ndtree.alignment.sensor_scans import AlignedLog, spread_evenly
from ndtree.alignment.spatial_loops import SpatialGraph, SpatialLoop, require_libraries
from ndtree.alignment.spatial_tracking import CloudScan, SpatialTrack, SpatialTracker
from ndtree.alignment.writing import draw_before_and_after, write_trajectory
from ndtree.base.progress import Progress, no_progress
from ndtree.base.scan import Scan
from ndtree.base.words import number_of
from ndtree.logs.core.log import Log, SizedLog, require_log
from ndtree.logs.poses.pose import quaternions_of

#: Farther end points are left out [m].
MAX_RANGE_IN_SPACE = 100.0
_LEAST_RANGE = 0.5  # Nearer end points are the robot's own [m].
_POINTS = 6000  # Of a scan, evenly spread, that are matched.
_CELL = 0.2  # Of the grid on which surfaces are counted [m].
_DRAWN = 3  # Of the points that are matched, each n-th is drawn and counted.


@dataclass(frozen=True, repr=False)
class SpatialAlignment(FoundPoses):
    """Poses of a 3-D log's scans.

    `poses` (n, 4, 4) float64: Of each scan's sensor, as it is turned in the map where the log says that; else
        turned as against the log's axes. The first is the log's.
    `odometry` (n, 4, 4) float64: The same as the log has them.
    `stamps` (n,) float64: Of the scans [s].
    `broken`: Scans from which on nothing but odometry connects what is seen with what was seen before.
    All else is as of `Alignment`.
    """

    max_range: float  # Farther end points were left out [m].
    broken: list[int]
    _points: list[Any] = field(default_factory=list)

    @property
    def log(self) -> SpatiallyAlignedLog:
        """SpatiallyAlignedLog: the log with these poses, as any other."""
        assert self.source is not None
        return SpatiallyAlignedLog(self.source, self.poses)

    @property
    def _telling_loops(self) -> list[SpatialLoop]:
        return [loop for loop in self.loops if loop.is_told]

    @property
    def places(self) -> Floats:
        return self.poses[:, :3, 3]

    @property
    def _told_places(self) -> Floats:
        return self.odometry[:, :3, 3]

    @cached_property
    def cells(self) -> tuple[int, int]:
        """Cells of 0.2 m with end points, by the log's poses and by these: double walls take more."""
        before, after = (_cells_of(self._seen(poses)) for poses in (self.odometry, self.poses))
        return before, after

    def _broken(self) -> list[str]:
        alone = [scan for scan in self.broken if not self._is_in_loop[scan]]
        if not alone:
            return []
        by = "odometry alone connects" if self.has_odometry else "nothing connects"
        return [
            f"{number_of(len(alone), 'time')} {by} what is seen with what was seen before, "
            f"the first at {self.stamps[alone[0]]:.1f} s"
        ]

    def figures(self) -> dict[str, Any]:
        """For a script."""
        return {**super().figures(), "max_range": self.max_range, "broken": self.broken}

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the trajectory as TUM's: a time, a place and a quaternion a line.

        `path`: It appears whole or not at all.
        """
        write_trajectory(path, self.stamps, self.places, quaternions_of(self.poses[:, :3, :3]))

    def draw(self, path: str | os.PathLike[str]) -> None:
        """Draw from above what scans saw, with the log's poses and with these.

        `path`: Its ending says the kind of picture.
        """
        before, after = ((self._seen(poses), poses[:, :3, 3]) for poses in (self.odometry, self.poses))
        draw_before_and_after(path, before, after)

    def _seen(self, poses: Floats) -> Floats:
        """Some points of the scans where poses put them."""
        return np.concatenate(
            [p[::_DRAWN] @ pose[:3, :3].T + pose[:3, 3] for pose, p in zip(poses, self._points)]
        )


class SpatiallyAlignedLog(AlignedLog):
    """A 3-D log with other poses, one for each of its scans."""

    def _moved(self, scan: Scan, pose: Floats) -> Scan:
        before = _pose_of(scan)
        turn = pose[:3, :3] @ before[:3, :3].T

        def there(points: Any) -> Floats:
            result: Floats = (points.astype(np.float64) - before[:3, 3]) @ turn.T + pose[:3, 3]
            return result

        return replace(
            scan,
            endpoints=there(scan.endpoints),
            origin=there(scan.origin),
            rotation=None if scan.rotation is None else pose[:3, :3],
            pose_covariance=None,
        )


def align_in_space(
    log: Log,
    *,
    max_range: float = MAX_RANGE_IN_SPACE,
    odometry: bool | None = None,
    close_loops: bool = True,
    progress: Progress = no_progress,
) -> SpatialAlignment:
    """Find the poses of a 3-D log's scans: each matched with those before, and places seen again.

    The result is the same each time: one thread works.

    `log`: In 3-D, its scans in the order in which they were taken.
    `max_range`: Farther end points are left out [m].
    `odometry`: Whether the log's poses say how the sensor moved. Default: unless they are all the same.
    `close_loops`: Whether to look for places seen again; else poses drift slowly.
    `progress`: Called as ``progress(what, done, total)``.
    Raises ImportError: a library is not installed; it says what to install; ValueError: the log is not 3-D,
    has no scans, or an argument is out of bounds.
    """
    require_log(log)
    if log.dim != 3:
        raise ValueError(f"{log.name}: is {log.dim}-D, expected a 3-D log")
    if not 0 < max_range < np.inf:
        raise WrongValue.of("max_range", f"{max_range:g} m", "> 0 and finite")
    require_libraries()
    begin = time.perf_counter()
    log = log.ruled(poses_are_found=True)
    scans: list[CloudScan] = []
    stamps: list[float] = []
    total = len(log) if isinstance(log, SizedLog) else 0
    for scan, stamp in _cloud_scans(log, max_range):
        scans.append(scan)
        stamps.append(stamp)
        progress("reading scans", len(scans), total)
    if not scans:
        raise log.without_scans()
    told = np.array([scan.pose for scan in scans])
    has_odometry = bool(np.ptp(told, axis=0).max() > STILL) if odometry is None else odometry
    track = _tracked(scans, has_odometry, progress)
    graph = SpatialGraph(np.array(track.poses), [scan.points for scan in scans], track.untold)
    if close_loops:
        graph.close(progress)
    return SpatialAlignment(
        source=log,
        poses=graph.poses,
        odometry=told,
        stamps=np.array(stamps),
        key_scans=graph.keys,
        loops=graph.loops,
        tested=graph.tested,
        contradicted=graph.contradicted,
        lost=track.lost,
        has_odometry=has_odometry,
        against=track.against,
        unfixed=np.array(track.unfixed),
        odometry_scale=scale_of(track.ratios),
        seconds=time.perf_counter() - begin,
        max_range=max_range,
        broken=track.broken,
        _points=[scan.points for scan in scans],
    )


def _tracked(scans: list[CloudScan], has_odometry: bool, progress: Progress) -> SpatialTrack:
    """All scans placed; once more where they say that odometry's ways have another length."""
    motion = Motion() if has_odometry else NO_ODOMETRY

    def placed(scale: float) -> SpatialTrack:
        tracker = SpatialTracker(motion, has_odometry, scale)
        for i, scan in enumerate(scans, 1):
            tracker.add(scan)
            progress("matching scans", i, len(scans))
        return tracker.track

    track = placed(1.0)
    scale = told_scale(track.ratios, motion)
    if scale != 1.0:
        again = placed(scale)
        if is_confirmed(again.ratios, scale, motion):
            return again
    return track


def _cloud_scans(log: Log, max_range: float) -> Iterator[tuple[CloudScan, float]]:
    """Scans of a log, seen from their sensors, and their stamps [s]."""
    for scan in log:
        scan.require_sensor("poses")
        pose = _pose_of(scan)
        points = scan.returned_only().endpoints.astype(np.float64) - pose[:3, 3]
        ranges = np.linalg.norm(points, axis=1)
        points = points[(ranges > _LEAST_RANGE) & (ranges <= max_range)] @ pose[:3, :3]
        yield CloudScan(spread_evenly(points, _POINTS).astype(np.float32), pose), scan.stamp


def _pose_of(scan: Scan) -> Floats:
    """Of the sensor in the log (4, 4), not turned where it does not say that."""
    pose = np.eye(4)
    pose[:3, 3] = scan.origin if scan.origin.ndim == 1 else scan.origin.mean(axis=0)
    if scan.rotation is not None:
        pose[:3, :3] = scan.rotation
    return pose


def _cells_of(points: Floats) -> int:
    """How many cells hold points, in the mean of two lattices: in one, noise doubles a wall at a border."""
    both = [(np.floor(points / _CELL + by).astype(np.int64) & 0x1FFFFF).T for by in (0.0, 0.5)]
    return sum(len(np.unique((x << 42) | (y << 21) | z)) for x, y, z in both) // 2
