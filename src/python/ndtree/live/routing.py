# SPDX-License-Identifier: BSD-3-Clause
"""Ways through a live map, for a service."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndtree._native._core import OccupancyMap, Planner, Sphere
from ndtree._native.results import Path

Array = NDArray[np.float64]
#: Places are tried around a goal in which the robot collides, so far from each other, of the tolerance.
_STEP = 0.1
#: They are asked in parts, the nearest first: these many, up to these, and the others.
_FIRST = (16, 256)
#: A goal is moved to where the robot fits for certain, whatever is rounded [m].
_MARGIN = 1e-4


class Router:
    """Plans ways of a ball through a map as it grows; what it found out about free space is kept.

    `unknown` ({"blocked", "free"}): What unknown space is.
    """

    def __init__(self, unknown: str = "blocked") -> None:
        self._unknown = unknown
        self._radius = -1.0
        self._planner: Planner | None = None

    def way(self, m: OccupancyMap, start: Array, goal: Array, radius: float, tolerance: float = 0.0) -> Path:
        """A way to a goal, or to the place nearest to it where the robot fits and gets to.

        `start`, `goal` (dim,), `radius`: Of the robot [m].
        `tolerance`: How far from the goal the way may end [m], if the robot collides there.
        Raises ValueError if the robot collides at the start, or at the goal and all around it.
        """
        planner, larger = self._follow(m, radius), Sphere(radius + _MARGIN)
        as_obstacle: Any = {"blocked": "occupied", "free": "free"}[self._unknown]
        places = np.concatenate([goal[None], _around(goal, tolerance)])
        places = places[~m.collides(larger, places, unknown=as_obstacle)]
        if not len(places) or np.array_equal(places[0], goal):
            return planner.plan(start, goal)  # Says what is in the way.
        for some in np.split(places, _FIRST):
            reached = np.isfinite(planner.ways(start, some))
            if reached.any():
                return planner.plan(start, some[reached.argmax()])
        return planner.plan(start, places[0])  # Says why none is reached.

    def _follow(self, m: OccupancyMap, radius: float) -> Planner:
        if self._planner is not None and radius == self._radius:
            try:
                self._planner.update(m)
                return self._planner
            except ValueError:  # Another map was loaded.
                pass
        self._planner, self._radius = Planner(m, Sphere(radius), unknown=self._unknown), radius
        return self._planner


def _around(goal: Array, tolerance: float) -> Array:
    """Places of a lattice within a distance, the nearest first."""
    if tolerance <= 0.0:
        return np.zeros((0, len(goal)))
    steps = np.arange(-round(1.0 / _STEP), round(1.0 / _STEP) + 1) * _STEP * tolerance
    offsets = np.stack(np.meshgrid(*[steps] * len(goal), indexing="ij"), axis=-1).reshape(-1, len(goal))
    away = np.linalg.norm(offsets, axis=1)
    order = np.argsort(away, kind="stable")
    return goal + offsets[order][(away[order] > 0.0) & (away[order] <= tolerance)]
