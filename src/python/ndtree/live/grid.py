# SPDX-License-Identifier: BSD-3-Clause
"""A grid in the plane that follows a map: what has changed since the last look is drawn anew, and no more."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ndtree._native._core import OccupancyMap

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Values as nav_msgs/OccupancyGrid has them.
UNKNOWN, FREE, OCCUPIED = -1, 0, 100
#: The grid grows to multiples of this many pixels, so that it seldom does.
GROWS = 64
#: A grid that is so much larger than what is known becomes smaller, as behind a window that moves.
SHRINKS = 4.0
#: Coordinates that differ from a multiple of a cell by less than this part of it are meant to be one.
_WHOLE = 1e-6


@dataclass(frozen=True)
class GridPart:
    """A part of the grid, or all of it, that is to be sent.

    Attributes
    ----------
    column, row : int
        Where it begins in the grid.
    values : (rows, columns) int8
        -1 unknown, 0 free, 100 occupied; the first row has the least y.
    is_whole : bool
        The grid has another size or origin than before.
    """

    column: int
    row: int
    values: NDArray[np.int8]
    is_whole: bool


class GridFollower:
    """A pixel is occupied if some occupied cell overlaps it, else free if some free one does, else unknown.

    So `OccupancyMap.map_server_image` has it; the grid may be larger, and is unknown there.

    Parameters
    ----------
    cell_size : float, optional
        Of a pixel [m]; left out, that of the map's smallest cells.
    height : (low, high), optional
        Of a 3-D map: only cells that overlap low <= z < high [m]; left out, all.

    Attributes
    ----------
    values : (rows, columns) int8 or None
        The whole grid; None before something is known.
    """

    def __init__(self, cell_size: float | None = None, height: tuple[float, float] | None = None) -> None:
        if cell_size is not None and not 0 < cell_size < math.inf:
            raise ValueError(f"cell_size = {cell_size:g} m: must be > 0 and finite")
        if height is not None and not height[0] < height[1]:
            raise ValueError(f"height = {height[0]:g} to {height[1]:g} m: must be from low to high")
        self._wanted, self._height = cell_size, height
        self.values: NDArray[np.int8] | None = None
        self._lower = np.zeros(2, dtype=np.int64)  # In pixels from 0.
        self._seen: OccupancyMap | None = None
        self.cell_size = cell_size or 0.0

    @property
    def origin(self) -> tuple[float, float]:
        """Lower corner [m]."""
        return float(self._lower[0] * self.cell_size), float(self._lower[1] * self.cell_size)

    def follow(self, m: OccupancyMap) -> GridPart | None:
        """Become the grid of a map; None if nothing is another than before.

        Parameters
        ----------
        m : OccupancyMap
            A snapshot, which is kept.
        """
        self.cell_size = self._wanted or m.options["min_cell_size"]
        try:
            box = None if self._seen is None or self.values is None else self._changed(m, self._seen)
        except ValueError:  # Another kind of map.
            box, self._seen = None, None
        is_known = self._seen is not None and self.values is not None
        self._seen = m
        if is_known and box is None:
            return None
        if not is_known or not self._contains(box) or self._is_wasteful(m):
            return self._drawn_anew(m)
        assert self.values is not None and box is not None
        lower, upper = box
        part = self._drawn(m, lower, upper)
        column, row = (lower - self._lower).tolist()
        before = self.values[row : row + part.shape[0], column : column + part.shape[1]]
        changed = before != part
        if not changed.any():
            return None
        rows, columns = np.flatnonzero(changed.any(axis=1)), np.flatnonzero(changed.any(axis=0))
        before[:] = part
        part = part[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        return GridPart(column + int(columns[0]), row + int(rows[0]), part, False)

    def _pixels(self, lower: Floats, upper: Floats) -> tuple[Ints, ...]:
        """The first pixels that boxes overlap, and those behind the last."""
        first, last = lower / self.cell_size, upper / self.cell_size
        near = np.rint(first), np.rint(last)
        first = np.where(np.abs(first - near[0]) < _WHOLE, near[0], np.floor(first))
        last = np.where(np.abs(last - near[1]) < _WHOLE, near[1], np.ceil(last))
        return first.astype(np.int64), last.astype(np.int64)

    def _in_band(self, lower: Floats, size: Floats, unit: float) -> NDArray[np.bool_]:
        if self._height is None or lower.shape[1] < 3:
            return np.ones(len(lower), dtype=bool)
        low, high = (value / unit for value in self._height)
        low, high = (round(v) if abs(v - round(v)) < _WHOLE else v for v in (low, high))
        z = np.rint(lower[:, 2] / unit)
        return (z < high) & (z + np.rint(size / unit) > low)

    def _changed(self, m: OccupancyMap, before: OccupancyMap) -> tuple[Ints, Ints] | None:
        changes = m.changes(since=before)
        use = self._in_band(changes.lower, changes.size, m.options["min_cell_size"])
        if not use.any():
            return None
        lower = changes.lower[use, :2]
        first, last = self._pixels(lower, lower + changes.size[use, None])
        return first.min(axis=0), last.max(axis=0)

    def _known(self, m: OccupancyMap, box: Floats | None = None) -> tuple[NDArray, ...]:
        """First pixels, those behind the last, and states of leaves that are known."""
        leaves = m.leaves(box, states=["free", "occupied"])
        use = self._in_band(leaves.lower, leaves.size, m.options["min_cell_size"])
        lower = leaves.lower[use, :2]
        first, last = self._pixels(lower, lower + leaves.size[use, None])
        return first, last, leaves.state[use]

    def _drawn(self, m: OccupancyMap, lower: Ints, upper: Ints) -> NDArray[np.int8]:
        """The pixels from lower to before upper."""
        box = np.stack([lower, upper]) * self.cell_size
        if m.dim == 3:
            bounds = m.bounds()
            z = (0.0, 0.0) if bounds is None else (bounds[0][2], bounds[1][2])
            if self._height is not None:
                z = max(z[0], self._height[0]), min(z[1], self._height[1])
            if z[0] > z[1]:
                return np.full((upper - lower)[::-1], UNKNOWN, dtype=np.int8)
            box = np.column_stack([box, z])
        first, last, state = self._known(m, box)
        return _painted(first - lower, last - lower, state, upper - lower)

    def _drawn_anew(self, m: OccupancyMap) -> GridPart | None:
        first, last, state = self._known(m)
        if not len(state):
            return None
        lower = first.min(axis=0) // GROWS * GROWS
        upper = -(-last.max(axis=0) // GROWS) * GROWS
        self._lower = lower
        self.values = _painted(first - lower, last - lower, state, upper - lower)
        return GridPart(0, 0, self.values, True)

    def _contains(self, box: tuple[Ints, Ints] | None) -> bool:
        assert self.values is not None and box is not None
        upper = self._lower + self.values.shape[::-1]
        return bool((box[0] >= self._lower).all() and (box[1] <= upper).all())

    def _is_wasteful(self, m: OccupancyMap) -> bool:
        bounds = m.bounds()
        assert self.values is not None
        if bounds is None:
            return False
        extent = np.ceil((bounds[1] - bounds[0])[:2] / self.cell_size) + 2 * GROWS
        return bool(self.values.size > SHRINKS * extent.prod())


def _painted(first: Ints, last: Ints, state: NDArray[np.int8], size: Ints) -> NDArray[np.int8]:
    """A grid of some size [pixels] with boxes drawn in it; occupied ones cover free ones."""
    width, height = size.tolist()
    values = np.full((height, width), UNKNOWN, dtype=np.int8)
    first, last = np.clip(first, 0, size), np.clip(last, 0, size)
    for which, value in ((0, FREE), (1, OCCUPIED)):
        use = (state == which) & (first < last).all(axis=1)
        (x0, y0), (x1, y1) = first[use].T, last[use].T
        # The corners of each box, summed along both axes, are how many boxes cover a pixel.
        corners = np.zeros((height + 1) * (width + 1), dtype=np.int32)
        for x, y, sign in ((x0, y0, 1), (x1, y0, -1), (x0, y1, -1), (x1, y1, 1)):
            count = np.bincount(y * (width + 1) + x, minlength=len(corners))
            corners += sign * count.astype(np.int32)
        covered = corners.reshape(height + 1, width + 1).cumsum(axis=0).cumsum(axis=1)
        values[covered[:height, :width] > 0] = value
    return values
