# SPDX-License-Identifier: BSD-3-Clause
"""Poses of a log from what its scans saw."""

from __future__ import annotations

import time

import numpy as np

from ndtree._native._checked import checked
from ndtree.alignment.loops import Graph
from ndtree.alignment.motion import NO_ODOMETRY, Motion
from ndtree.alignment.planar import Floats
from ndtree.alignment.result import Alignment, between_keys
from ndtree.alignment.sensor_scans import Track, pose_in_log, sensor_scans
from ndtree.alignment.tracking import Tracker
from ndtree.base.progress import Progress, no_progress
from ndtree.logs.core.log import Log, SizedLog, require_log

#: Farther end points say little of poses in buildings [m].
MAX_RANGE = 40.0
_BACKWARDS = 0.5  # Lower scales are of odometry that counts backwards, and misled the scans.
STILL = 1e-3  # Poses of a log that stay within this do not say how the sensor moved [m].


@checked
def align(
    log: Log,
    *,
    max_range: float = MAX_RANGE,
    cell_size: float = 0.05,
    odometry: bool | None = None,
    close_loops: bool = True,
    progress: Progress = no_progress,
) -> Alignment:
    """Find the poses of a 2-D log's scans: each matched with those before, and places seen again.

    Where scans say that odometry's ways are too long, too short, or backwards, they are matched once more
    with ways that are multiplied by that; it counts if it confirms itself.

    Parameters
    ----------
    log : Log
        In 2-D, its scans in the order in which they were taken.
    max_range : float
        Farther end points are left out [m].
    cell_size : float
        Of the maps that scans are matched with [m].
    odometry : bool, optional
        Whether the log's poses say how the sensor moved. Default: unless they are all the same.
    close_loops : bool
        Whether to look for places seen again; else poses drift slowly.
    progress : callable
        Called as ``progress(what, done, total)``.

    Returns
    -------
    Alignment

    Raises
    ------
    ValueError
        The log is not 2-D, has no scans, or an argument is out of bounds.
    """
    require_log(log)
    if log.dim != 2:
        raise ValueError(
            f"{log.name}: is {log.dim}-D, expected a 2-D log; of 3-D: ndtree.alignment.align_in_space"
        )
    for name, value in (("max_range", max_range), ("cell_size", cell_size)):
        if not value > 0:
            raise ValueError(f"{name} = {value:g} m: must be > 0")
    begin = time.perf_counter()
    log = log.ruled(poses_are_found=True)
    has_odometry = moves(log) if odometry is None else odometry
    motion = Motion() if has_odometry else NO_ODOMETRY
    track, stamps, by_log = _tracked(log, Tracker(cell_size, motion, has_odometry), max_range, progress)
    scale = told_scale(track.ratios, motion)
    if scale != 1.0:
        again, _, _ = _tracked(log, Tracker(cell_size, motion, has_odometry, scale), max_range, progress)
        if is_confirmed(again.ratios, scale, motion):
            track = again
    if not stamps:
        raise log.without_scans()
    graph = Graph(track)
    if close_loops:
        graph.close(progress)
    return Alignment(
        source=log,
        poses=between_keys(np.array(track.poses), track.keys, graph.poses),
        odometry=np.array(by_log),
        stamps=np.array(stamps),
        key_scans=np.array(track.keys),
        loops=graph.loops,
        tested=graph.tested,
        contradicted=graph.contradicted,
        lost=track.lost,
        has_odometry=has_odometry,
        against=track.against,
        unfixed=np.array(track.unfixed),
        through=np.array(track.through),
        odometry_scale=scale_of(track.ratios),
        seconds=time.perf_counter() - begin,
        _scans=track.scans,
    )


def _tracked(
    log: Log, tracker: Tracker, max_range: float, progress: Progress
) -> tuple[Track, list[float], list[Floats]]:
    """All scans of a log placed, their stamps, and their poses in the log."""
    stamps: list[float] = []
    by_log: list[Floats] = []
    total = len(log) if isinstance(log, SizedLog) else 0
    for scan in sensor_scans(log, max_range):
        tracker.add(scan)
        stamps.append(scan.stamp)
        by_log.append(scan.pose)
        progress("matching scans", len(stamps), total)
    return tracker.track, stamps, by_log


def scale_of(ratios: list[float]) -> float:
    """What odometry's ways are to be multiplied by, as a track's ratios say."""
    return float(np.median(ratios)) if ratios else 1.0


def told_scale(ratios: list[float], motion: Motion) -> float:
    """The same, to match scans once more with it; 1 where that is not worth it."""
    scale = scale_of(ratios)
    if abs(scale - 1.0) <= motion.rate:
        return 1.0
    return scale if scale > _BACKWARDS else -1.0


def is_confirmed(ratios: list[float], scale: float, motion: Motion) -> bool:
    """Whether scans that were matched with a scale say the same."""
    return abs(scale_of(ratios) - scale) < 2.0 * motion.rate


def moves(log: Log) -> bool:
    """Whether a log's poses are not all the same: reads up to the first that is another."""
    poses = (pose_in_log(scan) for scan in log)
    first = next(poses, None)
    return first is not None and any(np.abs(pose - first).max() > STILL for pose in poses)
