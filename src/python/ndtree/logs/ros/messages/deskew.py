# SPDX-License-Identifier: BSD-3-Clause
"""Beams of a sensor that moved while it measured, each with the pose of its own time."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndtree.logs.poses.pose import BLOCK
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

    Raises ValueError: a `NoPose`, if the pose is not known at one of the times.
    """
    if beams.times is None or not len(beams.times):
        pose = tree.pose_at(fixed_frame, frame, stamp)
        return pose.apply(beams.points), pose.position
    first, last = float(beams.times.min()), float(beams.times.max())
    steps = max(int(np.ceil((last - first) / STEP)), 1)
    rotations, positions = tree.poses_at(fixed_frame, frame, stamp + np.linspace(first, last, steps + 1))
    at = (beams.times - first) * (steps / max(last - first, 1e-12))
    before = np.minimum(at.astype(np.int64), steps - 1)
    share = at - before
    ends = _between(rotations, positions, before, share, beams.points)
    way = np.linalg.norm(positions - positions[len(positions) // 2], axis=1).max()
    if way <= ONE_ORIGIN / 2:
        return ends, positions[len(positions) // 2]
    share = share[:, None]
    return ends, (1 - share) * positions[before] + share * positions[before + 1]


def _between(
    rotations: Floats,
    positions: Floats,
    before: NDArray[np.int64],
    share: Floats,
    points: NDArray[np.floating[Any]],
) -> Floats:
    """Points (n, 3) moved by the pose before each and by the one after, and interpolated.

    The sums are those of `Pose.apply`, block by block and axis by axis.

    `rotations`: (k, 3, 3).
    `positions`: (k, 3).
    `before` (n,): Of each point, which pose is before its time; there is one after.
    `share` (n,): Of the time between both, 0 to 1.
    `points`: (n, 3).
    """
    turns, moves = np.ascontiguousarray(np.moveaxis(rotations, 0, -1)), np.ascontiguousarray(positions.T)
    ends = np.empty(points.shape)
    with np.errstate(invalid="ignore", over="ignore"):
        for first in range(0, len(points), BLOCK):
            block = slice(first, first + BLOCK)
            own = np.ascontiguousarray(points[block].T, dtype=np.float64)
            part, i = share[block], before[block]
            for axis in range(3):
                now, later = (
                    turns[axis, 0].take(at) * own[0]
                    + turns[axis, 1].take(at) * own[1]
                    + turns[axis, 2].take(at) * own[2]
                    + moves[axis].take(at)
                    for at in (i, i + 1)
                )
                ends[block, axis] = (1 - part) * now + part * later
    return ends
