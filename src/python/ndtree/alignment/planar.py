# SPDX-License-Identifier: BSD-3-Clause
"""Poses in the plane as rows of x, y [m] and yaw [rad], and points that they place."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def wrapped(angles: Floats) -> Floats:
    """Angles in [-pi, pi)."""
    result: Floats = (angles + math.pi) % (2 * math.pi) - math.pi
    return result


def composed(poses: Floats, relative: Floats) -> Floats:
    """Poses that are seen as `relative` from `poses`; (..., 3) both."""
    c, s = np.cos(poses[..., 2]), np.sin(poses[..., 2])
    x = poses[..., 0] + c * relative[..., 0] - s * relative[..., 1]
    y = poses[..., 1] + s * relative[..., 0] + c * relative[..., 1]
    return np.stack((x, y, wrapped(poses[..., 2] + relative[..., 2])), axis=-1)


def between(poses: Floats, others: Floats) -> Floats:
    """What `others` are as seen from `poses`; (..., 3) both."""
    c, s = np.cos(poses[..., 2]), np.sin(poses[..., 2])
    x, y = others[..., 0] - poses[..., 0], others[..., 1] - poses[..., 1]
    return np.stack((c * x + s * y, c * y - s * x, wrapped(others[..., 2] - poses[..., 2])), axis=-1)


def placed(pose: Floats, points: Floats) -> Floats:
    """Points of a pose's frame, (n, 2), in the map."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    result: Floats = points @ np.array([[c, s], [-s, c]]) + pose[:2]
    return result


def seen_from(pose: Floats, points: Floats) -> Floats:
    """Points of the map, (n, 2), in a pose's frame."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    result: Floats = (points - pose[:2]) @ np.array([[c, -s], [s, c]])
    return result


def turned(covariance: Floats, angle: float) -> Floats:
    """A covariance of x, y and yaw in a frame that is turned by `angle`."""
    c, s = math.cos(angle), math.sin(angle)
    turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    result: Floats = turn @ covariance @ turn.T
    return result


def yaw_of(matrix: Floats) -> float:
    """Where the x axis of a pose or a rotation points, seen from above [rad]."""
    return math.atan2(matrix[1, 0], matrix[0, 0])


def pose_of(matrix: Floats) -> Floats:
    """The row of a (3, 3) matrix."""
    return np.array([matrix[0, 2], matrix[1, 2], yaw_of(matrix)])


def thinned(points: Floats, size: float) -> Floats:
    """The first point of each cell of an edge, in their order."""
    cells = np.floor(points / size).astype(np.int64)
    _, first = np.unique(cells, axis=0, return_index=True)
    return points[np.sort(first)]


def in_space(poses: Floats) -> tuple[Floats, Floats]:
    """Places (n, 3) [m] and quaternions (n, 4), as x, y, z, w, of poses (n, 3) in the plane."""
    half, zero = poses[:, 2] / 2, np.zeros(len(poses))
    places = np.column_stack((poses[:, :2], zero))
    return places, np.column_stack((zero, zero, np.sin(half), np.cos(half)))
