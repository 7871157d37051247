# SPDX-License-Identifier: BSD-3-Clause
"""What is shown of a map on robots, as arrays: occupied cells as points or boxes, and frontiers as poses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ndtree._native._core import FrontierSearch, OccupancyMap

#: A point: where the cell's centre is, how large it is [m], and how probable that it is occupied.
POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("size", "<f4"), ("probability", "<f4")])


def occupied_points(m: OccupancyMap) -> NDArray[np.void]:
    """Occupied cells as records of `POINT`; those of a 2-D map lie at z = 0."""
    leaves = m.leaves(states=["occupied"])
    points = np.zeros(len(leaves), dtype=POINT)
    for name, values in zip("xyz", leaves.center.T):
        points[name] = values
    points["size"], points["probability"] = leaves.size, leaves.probability
    return points


def by_size(points: NDArray[np.void]) -> list[tuple[float, NDArray[np.float64]]]:
    """Edges of cells [m], the smallest first, and the centres (n, 3) of those of each [m]."""
    sizes, which = np.unique(points["size"], return_inverse=True)
    centers = np.stack([points[name].astype(np.float64) for name in "xyz"], axis=1)
    return [(float(size), centers[which == number]) for number, size in enumerate(sizes)]


class FrontierPose(NamedTuple):
    """Where a robot would look into the unknown: a point (3,) [m], and a quaternion x, y, z, w."""

    position: tuple[float, float, float]
    quaternion: tuple[float, float, float, float]


class Frontiers:
    """Frontiers that follow a map, as poses whose x axis looks into the unknown; the largest first."""

    def __init__(self, min_cells: float) -> None:
        self._min_cells = min_cells
        self._search: FrontierSearch | None = None

    def follow(self, m: OccupancyMap) -> list[FrontierPose]:
        """Those of a map."""
        try:
            if self._search is None:
                self._search = FrontierSearch(m)
            else:
                self._search.update(m)
        except ValueError:  # Another kind of map.
            self._search = FrontierSearch(m)
        return [
            FrontierPose(_in_space(one.goal), _looking(_in_space(one.direction)))
            for one in self._search.frontiers(min_cells=self._min_cells)
        ]


def _in_space(point: NDArray[np.float64]) -> tuple[float, float, float]:
    x, y, z = [*point.tolist(), 0.0][:3]
    return x, y, z


def direction_of(quaternion: Sequence[float]) -> tuple[float, float, float]:
    """Where the x axis looks that a quaternion x, y, z, w turns."""
    x, y, z, w = quaternion
    return 1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)


def _looking(way: tuple[float, float, float]) -> tuple[float, float, float, float]:
    """The rotation by yaw and pitch that turns x into a direction; none for a direction of length 0."""
    x, y, z = way
    yaw, pitch = math.atan2(y, x), -math.atan2(z, math.hypot(x, y))
    a, b, c, d = math.cos(yaw / 2), math.sin(yaw / 2), math.cos(pitch / 2), math.sin(pitch / 2)
    return -b * d, a * d, b * c, a * c
