# SPDX-License-Identifier: BSD-3-Clause
"""Poses of a 3-D log by kiss-icp, from what a spinning or solid-state lidar saw, and from places seen again.

Each scan is matched by kiss-icp with those before it, in the frame of its sensor as far as the log tells:
points from the sensor, along the log's axes. So where the log has no poses, the frame is the sensor's, and
where it has poor ones, rotations that are found are how these are wrong. Slow drift is taken out by
`SpatialGraph`.
"""

from __future__ import annotations

import os
import time
from collections import deque
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from ndtree._errors import WrongValue
from ndtree._lazy import needs
from ndtree.alignment.planar import Floats
from ndtree.alignment.result import MOST_CONTRADICTED
from ndtree.alignment.sensor_scans import AlignedLog, spread_evenly
from ndtree.alignment.spatial_loops import POINTS, SpatialGraph, SpatialLoop, require_libraries
from ndtree.alignment.writing import compared, draw_before_and_after, verdict, write_trajectory
from ndtree.base.progress import Progress, no_progress
from ndtree.base.scan import Scan
from ndtree.base.words import number_of
from ndtree.logs.core.log import Log, SizedLog, require_log
from ndtree.logs.poses.pose import quaternions_of

#: Farther end points are left out [m].
MAX_RANGE_IN_SPACE = 100.0
_LEAST_RANGE = 0.5  # Nearer end points are the robot's own [m].
_FEWEST = 50  # Points of a scan that says something.
_CELL = 0.2  # Of the grid on which surfaces are counted [m].
_NEARER = (0.7, 0.5)  # Of the largest range, and of voxels, where the poses are doubtful with all of it.
_DRAWN = 2  # Of the points that are kept, each n-th is drawn and counted.
_REMEMBERED = 30  # Scans before one, that it should see some of.
_LOST = 0.3  # Less of a scan in space that was occupied before is no match.
_MOST_LOST = (3, 0.01)  # Scans that may have none, a few or this fraction.
_JUMP = 5.0  # Median differences of two motions in a row; two that differ by more are a jump.
_MOST_JUMPS = (1, 0.005)  # Jumps that there may be, one or this fraction.


@dataclass(frozen=True, repr=False)
class SpatialAlignment:
    """Poses of a 3-D log's scans by kiss-icp and loops.

    `poses` (n, 4, 4) float64: Of each scan's sensor; turned as against the log's axes, so the first is not
        turned.
    `origins` (n, 3) float64: Where the log has the sensors [m].
    `stamps` (n,) float64: Of the scans [s].
    """

    source: Log  # The log.
    poses: Floats
    origins: Floats
    stamps: Floats
    lost: int  # Scans that saw too little of what the scans before them saw.
    max_range: float  # Farther end points were left out [m].
    _voxel: float
    _points: list[Floats]
    loops: list[SpatialLoop] = field(default_factory=list)  # Places that were seen again.
    tested: int = 0  # Pairs of places that look alike.
    contradicted: int = 0  # Loops that others contradict.
    seconds: float = 0.0  # What it took.

    @property
    def log(self) -> SpatiallyAlignedLog:
        """SpatiallyAlignedLog: the log with these poses, as any other."""
        return SpatiallyAlignedLog(self.source, self.poses)

    @cached_property
    def moved(self) -> Floats:
        """(n,) float64: how far each scan is from where the log has it [m]."""
        return np.asarray(np.linalg.norm(self.poses[:, :3, 3] - self.origins, axis=1))

    @cached_property
    def cells(self) -> tuple[int, int]:
        """Cells of 0.2 m with end points, by the log's poses and by these: double walls take more."""
        return _cells_of(self._seen(False)), _cells_of(self._seen(True))

    @cached_property
    def jumps(self) -> int:
        """Motions from scan to scan that are all at once unlike the one before: a wrong match, mostly."""
        if len(self.poses) < 3:
            return 0
        moves = np.linalg.inv(self.poses[:-1]) @ self.poses[1:]
        change = np.linalg.inv(moves[:-1]) @ moves[1:]
        size = np.linalg.norm(change[:, :3, 3], axis=1)
        return int(np.count_nonzero(size > max(_JUMP * float(np.median(size)), self._voxel)))

    @property
    def doubts(self) -> list[str]:
        """Why not to trust the poses; empty if no reason to doubt them."""
        doubts = []
        if self.lost > max(_MOST_LOST[0], _MOST_LOST[1] * len(self.poses)):
            doubts.append(f"{number_of(self.lost, 'scan')} matched nothing")
        if self.jumps > max(_MOST_JUMPS[0], _MOST_JUMPS[1] * len(self.poses)):
            doubts.append(f"the sensor jumps: {number_of(self.jumps, 'time')}")
        if self.contradicted > MOST_CONTRADICTED * max(1, len(self.loops)):
            loops = number_of(len(self.loops), "loop")
            doubts.append(f"{self.contradicted} of {loops} contradict the others")
        before, after = self.cells
        if self._has_poses and after > 1.02 * before:
            doubts.append(f"surfaces take more cells than before ({after} instead of {before})")
        return doubts

    @property
    def _has_poses(self) -> bool:
        """Whether the log says that the sensor moved."""
        return bool(np.abs(self.origins - self.origins[0]).max() > 1e-3)

    def __str__(self) -> str:
        before, after = self.cells
        way = float(np.linalg.norm(np.diff(self.poses[:, :3, 3], axis=0), axis=1).sum())
        closed = f"{number_of(len(self.loops), 'loop')} closed" if self.loops else "no loops found"
        return (
            f"poses moved by {np.median(self.moved):.2f} m in the median, {self.moved.max():.2f} m at most; "
            f"a path of {way:.1f} m; {closed}; "
            f"end points fill {compared(after, before)} cells; {verdict(self.doubts)}"
        )

    __repr__ = __str__

    def figures(self) -> dict[str, Any]:
        """For a script."""
        before, after = self.cells
        return {
            "scans": len(self.poses),
            "moved": {"median": float(np.median(self.moved)), "most": float(self.moved.max())},
            "lost": self.lost,
            "jumps": self.jumps,
            "max_range": self.max_range,
            "loops": len(self.loops),
            "tested": self.tested,
            "contradicted": self.contradicted,
            "has_odometry": self._has_poses,
            "cells": {"before": before, "after": after},
            "doubts": self.doubts,
            "seconds": self.seconds,
        }

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the trajectory as TUM's: a time, a place and a quaternion a line.

        `path`: It appears whole or not at all.
        """
        write_trajectory(path, self.stamps, self.poses[:, :3, 3], quaternions_of(self.poses[:, :3, :3]))

    def draw(self, path: str | os.PathLike[str]) -> None:
        """Draw from above what scans saw, with the log's poses and with these.

        `path`: Its ending says the kind of picture.
        """
        before, after = (self._seen(False), self.origins), (self._seen(True), self.poses[:, :3, 3])
        draw_before_and_after(path, before, after)

    def _seen(self, is_found: bool) -> Floats:
        """Some points of the scans where the log or these poses put them."""
        if is_found:
            placed = [p[::_DRAWN] @ pose[:3, :3].T + pose[:3, 3] for pose, p in zip(self.poses, self._points)]
        else:
            placed = [p[::_DRAWN] + origin for origin, p in zip(self.origins, self._points)]
        return np.concatenate(placed) if placed else np.zeros((0, 3))


class SpatiallyAlignedLog(AlignedLog):
    """A 3-D log with other poses, one for each of its scans."""

    def _moved(self, scan: Scan, pose: Floats) -> Scan:
        turn, place, before = pose[:3, :3], pose[:3, 3], _origin_of(scan)

        def there(points: Any) -> Floats:
            result: Floats = (points.astype(np.float64) - before) @ turn.T + place
            return result

        return replace(scan, endpoints=there(scan.endpoints), origin=there(scan.origin), pose_covariance=None)


def align_by_kiss_icp(
    log: Log,
    *,
    max_range: float = MAX_RANGE_IN_SPACE,
    close_loops: bool = True,
    progress: Progress = no_progress,
) -> SpatialAlignment:
    """Find the poses of a 3-D lidar's log: each scan matched with those before by kiss-icp, and loops closed.

    The result is the same each time: one thread works.

    `log`: In 3-D, its scans in the order in which they were taken.
    `max_range`: Farther end points are left out [m]; kiss-icp's voxels are a hundredth of it. Where the
        poses that come out are doubtful, 0.7 and 0.5 times this are tried as well.
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
    begin = time.perf_counter()
    _kiss_icp(max_range)
    if close_loops:
        require_libraries()
    log = log.ruled(poses_are_found=True)
    found = _by_odometry(log, max_range, progress)
    for share in _NEARER:
        if found.doubts:
            other = _by_odometry(log, share * max_range, progress)
            found = min(found, other, key=lambda one: (bool(one.doubts), one.lost + one.jumps))
    graph = SpatialGraph(found.poses, found._points)
    if close_loops:
        graph.close(progress)
    return replace(
        found,
        poses=graph.poses,
        loops=graph.loops,
        tested=graph.tested,
        contradicted=graph.contradicted,
        seconds=time.perf_counter() - begin,
    )


def _by_odometry(log: Log, max_range: float, progress: Progress) -> SpatialAlignment:
    """Poses by kiss-icp alone."""
    odometry = _kiss_icp(max_range)
    first: Floats | None = None
    poses, origins, stamps, kept = [], [], [], []
    known: deque[Any] = deque(maxlen=_REMEMBERED)
    voxel, lost = odometry.config.mapping.voxel_size, 0
    total = len(log) if isinstance(log, SizedLog) else 0
    for scan in log:
        scan.require_sensor("poses")
        origin = _origin_of(scan)
        first = origin if first is None else first
        points = _points_of(scan, origin, max_range)
        if len(points) >= _FEWEST:
            odometry.register_frame(points, np.zeros(0))
            pose = np.array(odometry.last_pose)
            at = _keys_of(points @ pose[:3, :3].T + pose[:3, 3], voxel)
            lost += bool(known) and float(np.isin(at, np.concatenate(known)).mean()) < _LOST
            known.append(at)
        else:
            pose = np.array(odometry.last_pose)
            lost += 1
        pose[:3, 3] += first
        poses.append(pose)
        origins.append(origin)
        stamps.append(scan.stamp)
        kept.append(spread_evenly(points, POINTS).astype(np.float32))
        progress("matching scans", len(poses), total)
    if not poses:
        raise log.without_scans()
    return SpatialAlignment(
        source=log,
        poses=np.array(poses),
        origins=np.array(origins),
        stamps=np.array(stamps),
        lost=lost,
        max_range=max_range,
        _voxel=voxel,
        _points=kept,
    )


def _kiss_icp(max_range: float) -> Any:
    with needs("finding poses in space needs kiss-icp", "kiss-icp"):
        from kiss_icp.config import KISSConfig
        from kiss_icp.kiss_icp import KissICP
    config = KISSConfig()
    config.data.max_range, config.data.min_range, config.data.deskew = max_range, _LEAST_RANGE, False
    config.mapping.voxel_size = max_range / 100
    config.registration.max_num_threads = 1
    return KissICP(config)


def _origin_of(scan: Scan) -> Floats:
    origin = scan.origin if scan.origin.ndim == 1 else scan.origin.mean(axis=0)
    return origin.astype(np.float64)


def _points_of(scan: Scan, origin: Floats, max_range: float) -> Floats:
    """End points of beams that returned, as seen from the sensor along the log's axes."""
    points = scan.returned_only().endpoints.astype(np.float64) - origin
    far = np.linalg.norm(points, axis=1)
    result: Floats = np.ascontiguousarray(points[(far > _LEAST_RANGE) & (far <= max_range)])
    return result


def _keys_of(points: Floats, size: float) -> Any:
    """Numbers of the cells that hold points, each once."""
    cells = np.floor(points / size).astype(np.int64) & 0x1FFFFF
    return np.unique((cells[:, 0] << 42) | (cells[:, 1] << 21) | cells[:, 2])


def _cells_of(points: Floats) -> int:
    return len(_keys_of(points, _CELL))
