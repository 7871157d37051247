# SPDX-License-Identifier: BSD-3-Clause
"""A grid in the plane that follows a map: what has changed since the last look is drawn anew, and no more."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

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


#: Of a state 0 or 1, and of -1, which is the last.
_VALUES = np.array([FREE, OCCUPIED, UNKNOWN], dtype=np.int8)


class _Boxes(NamedTuple):
    """Boxes of pixels: the first of each, those behind the last, and the state of each."""

    first: Ints
    last: Ints
    state: NDArray[np.int8]


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
        unit = m.options["min_cell_size"]
        self.cell_size = self._wanted or unit
        try:
            changed = None if self._seen is None or self.values is None else self._changed(m, self._seen)
        except ValueError:  # Another kind of map.
            changed, self._seen = None, None
        is_known = self._seen is not None and self.values is not None
        self._seen = m
        if is_known and changed is None:
            return None
        if changed is None or not self._contains(changed) or self._is_wasteful(m):
            return self._drawn_anew(m)
        lower, upper = changed.first.min(axis=0), changed.last.max(axis=0)
        assert self.values is not None
        column, row = (lower - self._lower).tolist()
        before = self.values[row : row + upper[1] - lower[1], column : column + upper[0] - lower[0]]
        if m.dim == 2 and self.cell_size == unit:  # Each pixel is one cell, and the changes tell all.
            part = before.copy()
            _fill(part, changed.first - lower, changed.last - lower, _VALUES[changed.state])
        else:
            part = self._drawn(m, lower, upper)
        differs = before != part
        if not differs.any():
            return None
        rows, columns = np.flatnonzero(differs.any(axis=1)), np.flatnonzero(differs.any(axis=0))
        before[:] = part
        part = part[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        return GridPart(column + int(columns[0]), row + int(rows[0]), part, False)

    def _pixels(self, lower: Floats, upper: Floats) -> tuple[Ints, Ints]:
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

    def _changed(self, m: OccupancyMap, before: OccupancyMap) -> _Boxes | None:
        changes = m.changes(since=before)
        use = self._in_band(changes.lower, changes.size, m.options["min_cell_size"])
        return self._boxes(changes.lower, changes.size, changes.after, use) if use.any() else None

    def _known(self, m: OccupancyMap, box: Floats | None = None) -> _Boxes:
        """Of leaves that are known."""
        leaves = m.leaves(box, states=["free", "occupied"])
        use = self._in_band(leaves.lower, leaves.size, m.options["min_cell_size"])
        return self._boxes(leaves.lower, leaves.size, leaves.state, use)

    def _boxes(self, lower: Floats, size: Floats, state: NDArray[np.int8], use: NDArray[np.bool_]) -> _Boxes:
        lower = lower[use, :2]
        return _Boxes(*self._pixels(lower, lower + size[use, None]), state[use])

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
        return _painted(self._known(m, box), lower, upper)

    def _drawn_anew(self, m: OccupancyMap) -> GridPart | None:
        known = self._known(m)
        if not len(known.state):
            return None
        lower = known.first.min(axis=0) // GROWS * GROWS
        upper = -(-known.last.max(axis=0) // GROWS) * GROWS
        self._lower = lower
        self.values = _painted(known, lower, upper)
        return GridPart(0, 0, self.values, True)

    def _contains(self, boxes: _Boxes) -> bool:
        assert self.values is not None
        upper = self._lower + self.values.shape[::-1]
        return bool((boxes.first >= self._lower).all() and (boxes.last <= upper).all())

    def _is_wasteful(self, m: OccupancyMap) -> bool:
        bounds = m.bounds()
        assert self.values is not None
        if bounds is None:
            return False
        extent = np.ceil((bounds[1] - bounds[0])[:2] / self.cell_size) + 2 * GROWS
        return bool(self.values.size > SHRINKS * extent.prod())


def _painted(boxes: _Boxes, lower: Ints, upper: Ints) -> NDArray[np.int8]:
    """The pixels from lower to before upper, with boxes drawn in them; occupied ones cover free ones."""
    size = upper - lower
    values = np.full(size[::-1], UNKNOWN, dtype=np.int8)
    first, last = np.clip(boxes.first - lower, 0, size), np.clip(boxes.last - lower, 0, size)
    for state in (0, 1):
        use = (boxes.state == state) & (first < last).all(axis=1)
        _fill(values, first[use], last[use], _VALUES[boxes.state[use]])
    return values


def _fill(values: NDArray[np.int8], first: Ints, last: Ints, what: NDArray[np.int8]) -> None:
    """Write values into boxes of pixels: all boxes of one shape at once."""
    if not len(first):
        return
    flat, width = values.reshape(-1), values.shape[1]
    extent = last - first
    most = int(extent.max()) + 1
    shape = extent[:, 1] * most + extent[:, 0]
    for one in np.flatnonzero(np.bincount(shape)).tolist():
        rows, columns = divmod(one, most)
        use = shape == one
        at = first[use, 1] * width + first[use, 0]
        inside = (np.arange(rows)[:, None] * width + np.arange(columns)).ravel()
        flat[(at[:, None] + inside).ravel()] = np.repeat(what[use], len(inside))
