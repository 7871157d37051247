# SPDX-License-Identifier: BSD-3-Clause
"""Worlds of wall segments in the plane, what a laser sees of them, and whether two maps are the same."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

Floats = np.ndarray


def box(x: float, y: float, width: float, height: float) -> Floats:
    """Its walls, (4, 2, 2)."""
    corners = np.array([[x, y], [x + width, y], [x + width, y + height], [x, y + height]], dtype=float)
    return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)


def ranges_to(walls: Floats, pose: Floats, bearings: Floats) -> Floats:
    """How far beams from a pose go until they meet one of the walls (n, 2, 2); else infinitely far."""
    x, y = np.cos(bearings + pose[2])[:, None], np.sin(bearings + pose[2])[:, None]
    (way_x, way_y), (to_x, to_y) = (walls[:, 1] - walls[:, 0]).T, (walls[:, 0] - pose[:2]).T
    with np.errstate(divide="ignore", invalid="ignore"):
        across = x * way_y - y * way_x
        ranges, along = (to_x * way_y - to_y * way_x) / across, (to_x * y - to_y * x) / across
    return np.where((ranges > 1e-9) & (along >= 0) & (along <= 1), ranges, np.inf).min(axis=1)


def rays(bearings: Floats) -> Floats:
    """Unit vectors (n, 2)."""
    return np.stack([np.cos(bearings), np.sin(bearings)], axis=1)


def seen(walls: Floats, pose: Floats, beams: int = 240) -> Floats:
    """End points, in the sensor's frame, of beams all around that meet a wall."""
    bearings = np.linspace(-math.pi, math.pi, beams, endpoint=False)
    ranges = ranges_to(walls, pose, bearings)
    returned = np.isfinite(ranges)
    return ranges[returned, None] * rays(bearings[returned])


def assert_same_cells(one: Any, other: Any) -> None:
    """All that cells hold is equal; how a map's root grew and what it counts of its making is left out."""
    a, b = (m.leaves(states=["free", "occupied"]) for m in (one, other))
    order = [np.lexsort(leaves.lower.T) for leaves in (a, b)]
    for name in ("lower", "size", "log_odds", "hits", "misses"):
        np.testing.assert_array_equal(getattr(a, name)[order[0]], getattr(b, name)[order[1]])
