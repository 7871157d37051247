# SPDX-License-Identifier: BSD-3-Clause
"""A grid in the plane that follows a 3-D map, of what stands on ground that is not flat."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ndtree._errors import WrongValue
from ndtree._native._core import OccupancyMap
from ndtree.live.grid import GridFollower, GridPart, Ints, state_in_column
from ndtree.maps.ground import REACH, SLOPE, UNKNOWN, seen_above_ground


class GroundFollower(GridFollower):
    """As `GridFollower`, of a 3-D map, with heights above the ground, which need not be flat.

    `cell_size`: As for `GridFollower`.
    `height` (low, high): Above the ground [m].
    `slope`: The steepest ground [m/m].
    Raises ValueError if a number is out of its limits.
    """

    _counts_cells = False

    def __init__(self, cell_size: float | None, height: tuple[float, float], slope: float = SLOPE) -> None:
        super().__init__(cell_size, height)
        if not 0 <= slope < math.inf:
            raise WrongValue.of("slope", f"{slope:g}", ">= 0 and finite")
        # Whatever changes, may change the ground.
        self._band, self._height, self._slope = height, None, slope

    def _is_image(self, m: OccupancyMap) -> bool:
        return False

    def follow(self, m: OccupancyMap) -> GridPart | None:
        self._reach = math.ceil(REACH / (self._wanted or m.options["min_cell_size"]))
        return super().follow(m)

    def _drawn(self, m: OccupancyMap, lower: Ints, upper: Ints) -> NDArray[np.int8]:
        bounds = m.bounds()
        if bounds is None:
            return np.full((upper - lower)[::-1], UNKNOWN, dtype=np.int8)
        lower, upper, reach = lower - self._reach, upper + self._reach, self._reach
        box = np.column_stack([np.stack([lower, upper]) * self.cell_size, [bounds[0][2], bounds[1][2]]])
        leaves = m.leaves(box, states=["free", "occupied"])
        known = self._boxes(
            leaves.lower, leaves.size, state_in_column(leaves), np.ones(len(leaves), dtype=bool)
        )
        size, bottom = upper - lower, leaves.lower[:, 2]
        values = seen_above_ground(
            np.clip(known.first - lower, 0, size),
            np.clip(known.last - lower, 0, size),
            (bottom, bottom + leaves.size),
            known.state,
            (int(size[1]), int(size[0])),
            self.cell_size,
            self._band,
            self._slope,
        )
        return values[reach : len(values) - reach, reach : values.shape[1] - reach]
