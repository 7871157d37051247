# SPDX-License-Identifier: BSD-3-Clause
"""How far the surfaces of two maps are apart."""

from __future__ import annotations

from typing import Any

import numpy as np

from ndtree.evaluation.map_comparison.blocks import Floats, Integers
from ndtree.maps.open import PlacedMap


def distances_between(
    one: PlacedMap, other: PlacedMap, cell_size: float, max_points: int
) -> dict[str, Any] | None:
    """From occupied cells of one map to the other; None where one of them has none."""
    points = _surface(one, cell_size, max_points)
    if not len(points):
        return None
    distance = other.map.distance_to_occupied(points + one.offset - other.offset)
    if np.isnan(distance).any():
        return None
    return {
        "points": len(points),
        "mean": float(distance.mean()),
        "median": float(np.median(distance)),
        "p95": float(np.percentile(distance, 95)),
        "max": float(distance.max()),
    }


def _surface(one: PlacedMap, cell_size: float, max_points: int) -> Floats:
    """Centres of the parts of occupied leaves, in the map's own frame: each divided into as many as have
    about the cell size, of which those inside it are left out."""
    leaves = one.map.leaves()
    chosen = leaves.state == 1
    lower, size = leaves.lower[chosen], leaves.size[chosen]
    dim = lower.shape[1]
    parts = np.maximum(1, np.rint(size / cell_size).astype(np.int64))
    count = parts**dim - np.maximum(parts - 2, 0) ** dim
    total = int(count.sum())
    share = min(1.0, max_points / total) if total else 1.0
    generator = np.random.default_rng(0)
    result = []
    for n in np.unique(parts):
        here = parts == n
        border = _border(int(n), dim)
        at = (border + 0.5) / n
        points = (lower[here, None, :] + at * size[here, None, None]).reshape(-1, dim)
        if share < 1:
            points = points[generator.random(len(points)) < share]
        result.append(points)
    return np.concatenate(result) if result else np.empty((0, dim))


def _border(n: int, dim: int) -> Integers:
    """Numbers (m, dim) of the cells at the border of a cube of n cells an axis."""
    every = np.stack(np.meshgrid(*[np.arange(n)] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
    return every[((every == 0) | (every == n - 1)).any(axis=1)]
