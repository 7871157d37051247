# SPDX-License-Identifier: BSD-3-Clause
"""Poses in the plane as rows of x, y [m] and yaw [rad], and points that they place."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_STRAIGHT = 0.04  # Ends of beams may be off a straight wall by this: two standard deviations [m].
_WIDEST = 2.0  # Wider gaps between ends of beams may be doors [m].


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


def pose_of(matrix: Floats) -> Floats:
    """The row of a (3, 3) matrix."""
    return np.array([matrix[0, 2], matrix[1, 2], math.atan2(matrix[1, 0], matrix[0, 0])])


def thinned(points: Floats, size: float) -> Floats:
    """The first point of each cell of an edge, in their order."""
    cells = np.floor(points / size).astype(np.int64)
    _, first = np.unique(cells, axis=0, return_index=True)
    return points[np.sort(first)]


def along_walls(points: Floats, spacing: float) -> Floats:
    """Points in the order of their beams, and in gaps of straight walls between them others, a spacing apart.

    Ends of three beams next to each other on a line are a wall, and what lies between them is as well: else a
    wall that beams meet at a grazing angle is a row of spots, which fits the next scan best where the sensor
    did not move.
    """
    if len(points) < 3:
        return points
    steps = np.diff(points, axis=0)
    lengths = np.hypot(steps[:, 0], steps[:, 1])
    a, b = steps[:-1], steps[1:]
    chord = np.maximum(np.hypot(*(a + b).T), 1e-9)
    off = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / chord  # Of the middle one, from the others' line.
    turns = np.abs(wrapped(np.diff(np.arctan2(points[:, 1], points[:, 0]))))
    is_next = turns < 1.5 * np.median(turns)  # No beam between them went through.
    bends = (off > _STRAIGHT) | ((a * b).sum(axis=1) < 0.0) | ~is_next[:-1] | ~is_next[1:]
    is_wall = np.zeros(len(steps), dtype=bool)
    is_wall[:-1] |= ~bends
    is_wall[1:] |= ~bends
    count = np.where(is_wall & (lengths < _WIDEST), np.ceil(lengths / spacing), 1).astype(np.int64)
    first = np.repeat(np.arange(len(steps)), count)
    part = (np.arange(len(first)) - np.repeat(np.cumsum(count) - count, count)) / count[first]
    return np.concatenate((points[first] + part[:, None] * steps[first], points[-1:]))
