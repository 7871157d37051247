# SPDX-License-Identifier: BSD-3-Clause
"""Beams of a sensor that moved while it measured, each with the pose of its own time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ndtree.logs.poses.transforms import TransformTree
from ndtree.logs.ros.messages.beams import Beams

Floats = NDArray[np.float64]

#: Between poses so far apart [s], points are interpolated along lines.
STEP = 0.004
#: A sensor that moves no further than this during a scan [m] has one origin, that of the scan's middle.
ONE_ORIGIN = 0.05


def in_map(
    tree: TransformTree, fixed_frame: str, frame: str, beams: Beams, stamp: float
) -> tuple[Floats, Floats]:
    """End points (n, 3) and origins, (3,) or (n, 3), of beams in the map [m].

    End points always have the pose of their own time. Origins are one for all where the sensor moves less
    than the edge of a small cell, so that maps still know them for one scan.

    Raises
    ------
    ValueError
        A `NoPose`, if the pose is not known at one of the times.
    """
    if beams.times is None or not len(beams.times):
        pose = tree.pose_at(fixed_frame, frame, stamp)
        return pose.apply(beams.points), pose.position
    first, last = float(beams.times.min()), float(beams.times.max())
    steps = max(int(np.ceil((last - first) / STEP)), 1)
    rotations, positions = tree.poses_at(fixed_frame, frame, stamp + np.linspace(first, last, steps + 1))
    at = (beams.times - first) * (steps / max(last - first, 1e-12))
    before = np.minimum(at.astype(np.int64), steps - 1)
    share = (at - before)[:, None]
    points = np.asarray(beams.points, dtype=np.float64)
    with np.errstate(invalid="ignore", over="ignore"):
        ends = [np.einsum("nij,nj->ni", rotations[i], points) + positions[i] for i in (before, before + 1)]
        ends_now = (1 - share) * ends[0] + share * ends[1]
    way = np.linalg.norm(positions - positions[len(positions) // 2], axis=1).max()
    if way <= ONE_ORIGIN / 2:
        return ends_now, positions[len(positions) // 2]
    return ends_now, (1 - share) * positions[before] + share * positions[before + 1]
