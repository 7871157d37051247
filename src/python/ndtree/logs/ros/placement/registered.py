# SPDX-License-Identifier: BSD-3-Clause
"""Clouds whose points somebody has put into a fixed frame already: from where they were measured."""

from __future__ import annotations

import posixpath
from collections.abc import Iterator

import numpy as np

from ndtree.logs.core.failures import NoPose
from ndtree.logs.poses.transforms import TransformTree, plain

#: Frames that do not move with a robot, and those that are one; the best first.
USUAL = ("map", "odom", "world")
BASES = ("base_link", "base_footprint", "base")
#: What moves no further than this [m] in a frame is no robot on its way; LOOKS times are looked at.
LEAST_WAY, LOOKS = 0.1, 200


def observer_of(tree: TransformTree, frame: str, wanted: str | None) -> str | None:
    """The frame whose place the points of a cloud were seen from, if the cloud's frame stands still itself.

    SLAM publishes clouds that it has moved into the frame of its map, in which the robot drives: that frame
    is no sensor's. It is a usual fixed one, or the root of the tree, and a frame below it moves about. Of
    these the one that was asked for counts, else a robot's usual base, else the uppermost.

    `frame`: Of the cloud.
    `wanted`: Asked for.
    Returns: None where the frame may be that of a sensor.
    """
    if posixpath.basename(frame) in BASES:
        return None
    roots = [root for root in tree.roots(frame) if tree.is_fixed(root, frame)]
    if not roots and posixpath.basename(frame) not in USUAL:
        return None
    below = tree.below(frame)
    if posixpath.basename(frame) not in USUAL and any(posixpath.basename(one) in USUAL for one in below):
        return None  # The tree stands on its head.
    below = [one for one in below if _moves_about(tree, frame, one)]
    if not below:
        return None
    if wanted is not None and plain(wanted) in below:
        return plain(wanted)
    return next(bases_in(below), below[0])


def bases_in(frames: list[str]) -> Iterator[str]:
    """Those of some frames that are usual bases of robots, whatever stands before their names."""
    for base in BASES:
        for one in frames:
            if posixpath.basename(one) == base:
                yield one


def _moves_about(tree: TransformTree, frame: str, other: str) -> bool:
    stamps = tree.stamps(frame, other)
    if len(stamps) < 2:
        return False
    positions = []
    for stamp in stamps[:: len(stamps) // LOOKS + 1]:
        try:
            positions.append(tree.pose_at(frame, other, stamp).position)
        except NoPose:
            continue
    return bool(positions) and float(np.linalg.norm(np.ptp(positions, axis=0))) > LEAST_WAY
