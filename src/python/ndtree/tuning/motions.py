# SPDX-License-Identifier: BSD-3-Clause
"""Poses (4, 4), motions from one to another, and what poses err."""

from __future__ import annotations

import numpy as np

from ndtree.alignment.patches import turn_of, turned_by
from ndtree.alignment.planar import Floats

#: What poses err, each by itself: place [m] and turn [rad].
_POSES = np.array([0.02, 0.02, 0.03, 0.0123, 0.0123, 0.0123])


def rigid(rotation: Floats) -> Floats:
    """The motion that only turns."""
    result = np.eye(4)
    result[:3, :3] = rotation
    return result


def motions_of(poses: Floats, pairs: Floats) -> Floats:
    """(n, 4, 4) of the second of each pair (n, 2) as seen from the first."""
    result: Floats = np.linalg.inv(poses[pairs[:, 0]]) @ poses[pairs[:, 1]]
    return result


def pose_noise(told: Floats) -> Floats:
    """(n, 6, 6) covariance of motions by what poses err: the first one's turn moves where the second is."""
    arm = np.tile(np.eye(6), (len(told), 1, 1))
    x, y, z = told[:, :3, 3].T
    arm[:, [0, 1, 2, 2, 0, 1], [4, 5, 3, 4, 5, 3]] = np.stack([-z, -x, -y, x, y, z], axis=1)
    noise: Floats = np.diag(_POSES**2) + arm * _POSES**2 @ arm.transpose(0, 2, 1)
    return noise


def moved_by(vector: Floats) -> Floats:
    """A small motion of a place and a turn."""
    result = rigid(turned_by(vector[3:]))
    result[:3, 3] = turned_by(0.5 * vector[3:]) @ vector[:3]
    return result


def vector_of(motion: Floats) -> Floats:
    """(6,) place and turn."""
    return np.append(motion[:3, 3], turn_of(motion[:3, :3]))


def errors_of(seen: Floats, told: Floats) -> Floats:
    """(n, 6) what is seen minus what is told: place, and turn on the left."""
    turns = [turn_of(one @ other.T) for one, other in zip(seen[:, :3, :3], told[:, :3, :3])]
    return np.hstack((seen[:, :3, 3] - told[:, :3, 3], np.array(turns).reshape(-1, 3)))


def has_moved(pose: Floats, other: Floats, motion: tuple[float, float]) -> bool:
    """Whether another pose is farther away, or turned more."""
    off = vector_of(np.linalg.inv(pose) @ other)
    return bool(np.linalg.norm(off[:3]) > motion[0] or np.linalg.norm(off[3:]) > motion[1])
