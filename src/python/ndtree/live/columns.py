# SPDX-License-Identifier: BSD-3-Clause
"""Columns of a 3-D map above the pixels of a plane: what is free and occupied in them.

Occupied cells larger than the smallest, over which a far wall scatters, are drawn near free pixels alone, as
`OccupancyMap.map_server_image` draws them.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ndtree._native._core import OccupancyMap
from ndtree._native.results import Leaves
from ndtree.cells.raster import pixels_in
from ndtree.live.canvas import Ints, Pixels
from ndtree.maps.ground import FREE, LARGE, OCCUPIED, REACH, UNKNOWN, seen_above_ground

Floats = NDArray[np.float64]

#: Coordinates that differ from a multiple of a cell by less than this part of it are meant to be one.
_WHOLE = 1e-6


def _whole(numbers: Floats, otherwise: np.ufunc) -> Ints:
    near = np.rint(numbers)
    return np.where(np.abs(numbers - near) < _WHOLE, near, otherwise(numbers)).astype(np.int64)


class Boxes(NamedTuple):
    """Boxes of pixels with cells above them.

    `first`, `last` (n, 2): First pixel of each, and those behind the last.
    `before`, `after` (n,) int8: State of its cells: -1 unknown, 0 free, 1 occupied, 2 in a large cell.
    `cells` (n,): Smallest cells above a pixel, between the heights that count.
    """

    first: Ints
    last: Ints
    before: Pixels
    after: Pixels
    cells: Ints

    @staticmethod
    def of(
        corners: tuple[Floats, Floats],
        states: tuple[Pixels, Pixels],
        pixel: float,
        unit: float,
        height: tuple[float, float] | None,
    ) -> Boxes:
        """Of cubes, as far as they are between two heights.

        `corners`: Lower ones (n, 3), and edges (n,) [m].
        `states`: Before and after.
        `pixel`, `unit`: Edge of a pixel, and of the smallest cells [m].
        `height` (low, high): Half open [m]; None: all.
        """
        lower, size = corners
        cells = np.rint(size / unit).astype(np.int64)
        if height is not None:
            low, high = np.array(height) / unit
            bottom = np.rint(lower[:, 2] / unit).astype(np.int64)
            top = np.minimum(bottom + cells, _whole(high, np.ceil))
            cells = np.maximum(top - np.maximum(bottom, _whole(low, np.floor)), 0)
        use = cells > 0
        plane, size = lower[use, :2], size[use, None]
        first, last = _whole(plane / pixel, np.floor), _whole((plane + size) / pixel, np.ceil)
        return Boxes(first, last, states[0][use], states[1][use], cells[use])

    @staticmethod
    def known(m: OccupancyMap, pixel: float, height: tuple[float, float] | None) -> Boxes:
        """Of what is known in a map, where nothing was before."""
        leaves = m.leaves(states=["free", "occupied"])
        unit = m.options["min_cell_size"]
        after = state_in_column(leaves, unit)
        states = np.full_like(after, -1), after
        return Boxes.of((leaves.lower, leaves.size), states, pixel, unit, height)

    def __bool__(self) -> bool:
        return len(self.cells) > 0


def state_in_column(leaves: Leaves, unit: float) -> Pixels:
    """(n,) the state of leaves of a 3-D map as parts of a column, 2 if occupied and larger than a unit."""
    state = np.where(leaves.thin, 1, leaves.state)
    return (state + ((state == 1) & (leaves.size > 1.5 * unit))).astype(np.int8)


def _front(depth: float | None, pixel: float) -> int:
    """How far behind free pixels large occupied cells are drawn [pixels]; 0: all of each."""
    return 0 if depth is None or math.isinf(depth) else max(1, math.floor(depth / pixel * (1 + 1e-9)))


def _drawn(values: Pixels, reach: int) -> Pixels:
    """Values without any that is `LARGE`; within reach of the border, what lies beyond is missing."""
    large = values == LARGE
    near = values == FREE if reach else large
    for axis, size in enumerate(values.shape):
        if reach and size:
            before = np.insert(near.cumsum(axis), 0, 0, axis)  # How many are free before each.
            at = np.arange(size)
            last, first = np.minimum(at + reach + 1, size), np.maximum(at - reach, 0)
            near = before.take(last, axis) > before.take(first, axis)
    return np.where(large, np.where(near, OCCUPIED, UNKNOWN), values).astype(np.int8)


class Counts:
    """A pixel is occupied where some cell above is, else free where one is.

    Free, occupied and large occupied cells above each pixel are counted: what changes moves from one count to
    another.

    `depth`: Of large occupied cells that is drawn behind free pixels [m]; None or infinite: all of each.
    """

    depth: float | None = None

    def __init__(self) -> None:
        self._counts = np.zeros((3, 0, 0), dtype=np.int32)

    def reach(self, pixel: float) -> int:
        """How far what has changed may change others [pixels]."""
        return _front(self.depth, pixel)

    def begin(self, rows: int, columns: int) -> None:
        """Begin with a grid that is all unknown."""
        self._counts = np.zeros((3, rows, columns), dtype=np.int32)

    def grow(self, around: tuple[tuple[int, int], tuple[int, int]]) -> None:
        """Get rows and columns around."""
        self._counts = np.pad(self._counts, ((0, 0), *around))

    def painted(
        self, m: OccupancyMap, boxes: Boxes, first: Ints, at: tuple[slice, slice], pixel: float
    ) -> Pixels:
        """The pixels of a part of the grid, where boxes have changed.

        `m`: As it is now.
        `first`: The first pixel, from 0 of the map.
        `at`: The part's rows and columns in the grid.
        `pixel`: Its edge [m].
        """
        counts = self._counts[:, at[0], at[1]]
        size = counts.shape[1:]
        for state in (0, 1, 2):
            change = ((boxes.after == state).astype(np.int64) - (boxes.before == state)) * boxes.cells
            use = change != 0
            where, which = pixels_in(boxes.first[use] - first, boxes.last[use] - first, size[1])
            sums = np.bincount(where, weights=change[use][which], minlength=size[0] * size[1])
            counts[state] += sums.reshape(size).astype(np.int32)
        reach = _front(self.depth, pixel)
        low, left = (max(one.start - reach, 0) for one in at)
        free, occupied, large = self._counts[:, low : at[0].stop + reach, left : at[1].stop + reach] > 0
        values = np.select([occupied, large, free], [OCCUPIED, LARGE, FREE], UNKNOWN).astype(np.int8)
        row, column = at[0].start - low, at[1].start - left
        return _drawn(values, reach)[row : row + size[0], column : column + size[1]]


class AboveGround:
    """A pixel is of what stands on ground that is not flat; it is found anew within reach of a change.

    `height` (low, high): Above the ground [m].
    `slope`: The steepest ground [m/m].
    `depth`: As of `Counts`.
    """

    depth: float | None = None

    def __init__(self, height: tuple[float, float], slope: float) -> None:
        self._height, self._slope = height, slope

    def reach(self, pixel: float) -> int:
        """As of `Counts`."""
        return math.ceil(REACH / pixel) + _front(self.depth, pixel)

    def begin(self, rows: int, columns: int) -> None:
        """Nothing is kept."""

    def grow(self, around: tuple[tuple[int, int], tuple[int, int]]) -> None:
        """Nothing is kept."""

    def painted(
        self, m: OccupancyMap, boxes: Boxes, first: Ints, at: tuple[slice, slice], pixel: float
    ) -> Pixels:
        """As of `Counts`."""
        bounds, reach = m.bounds(), self.reach(pixel)
        size = np.array([one.stop - one.start for one in at[::-1]]) + 2 * reach
        if bounds is None:
            return np.full((size - 2 * reach)[::-1], UNKNOWN, dtype=np.int8)
        lower = first - reach
        box = np.column_stack([np.stack([lower, lower + size]) * pixel, [bounds[0][2], bounds[1][2]]])
        leaves = m.leaves(box, states=["free", "occupied"])
        unit = m.options["min_cell_size"]
        state = state_in_column(leaves, unit)
        known = Boxes.of((leaves.lower, leaves.size), (state, state), pixel, unit, None)
        values = seen_above_ground(
            (np.clip(known.first - lower, 0, size), np.clip(known.last - lower, 0, size)),
            (leaves.lower[:, 2], leaves.lower[:, 2] + leaves.size),
            state,
            (int(size[1]), int(size[0])),
            pixel,
            (*self._height, self._slope),
        )
        values = _drawn(values, _front(self.depth, pixel))
        return values[reach : len(values) - reach, reach : values.shape[1] - reach]
