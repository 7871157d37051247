# SPDX-License-Identifier: BSD-3-Clause
"""A grid in the plane that follows a map: what has changed since the last look is drawn anew, and no more.

Strategy: a map in the plane is drawn as a whole by `OccupancyMap.map_server_image`, as is one in space whose
pixels are not as large as its smallest cells. Of others each pixel counts the free and the occupied cells
above it; the map tells which regions have another state than at the last look, and these move their cells
from one count to the other, so that no column is looked through again.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ndtree._errors import WrongValue
from ndtree._native._core import OccupancyMap
from ndtree._native.results import Changes, Leaves
from ndtree.cells.raster import pixels_in
from ndtree.maps.ground import FREE, OCCUPIED, UNKNOWN
from ndtree.maps.writers.map_server import noise_depth

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: The grid grows to multiples of this many pixels, so that it seldom does.
GROWS = 64
#: A grid that is so much larger than what is known becomes smaller, as behind a window that moves.
SHRINKS = 4.0
#: Coordinates that differ from a multiple of a cell by less than this part of it are meant to be one.
_WHOLE = 1e-6
#: No map reaches so far [m].
_EVERYWHERE = 1e12
#: By the grey of an image of map_server.
_VALUES = np.full(256, UNKNOWN, dtype=np.int8)
_VALUES[[254, 0]] = FREE, OCCUPIED


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


def difference(
    before: NDArray[np.int8], after: NDArray[np.int8], column: int = 0, row: int = 0
) -> GridPart | None:
    """The smallest part in which two grids of one size differ; None if they do not.

    `before`, `after`: (rows, columns) int8.
    `column`, `row`: Where they begin in a larger grid.
    """
    differs = before != after
    if not differs.any():
        return None
    (top, bottom), (left, right) = (
        np.flatnonzero(differs.any(axis=axis))[[0, -1]].tolist() for axis in (1, 0)
    )
    return GridPart(column + left, row + top, after[top : bottom + 1, left : right + 1].copy(), False)


class GridFollower:
    """A pixel is occupied if some occupied cell overlaps it, else free if some free one does, else unknown.

    Of a 3-D map, free cells that hold something thin (`Leaves.thin`) count as occupied. So
    `OccupancyMap.map_server_image` has it; the grid may be larger, and is unknown there.

    Parameters
    ----------
    cell_size : float, optional
        Of a pixel [m]; left out, that of the map's smallest cells.
    height : (low, high), optional
        Of a 3-D map: only cells that overlap low <= z < high [m]; left out, all.
    wall_depth : float, optional
        As of `OccupancyMap.save_map_server`, of a 2-D map [m]; left out, `noise_depth`.

    Attributes
    ----------
    values : (rows, columns) int8 or None
        The whole grid; None before something is known.
    """

    #: How far what has changed may change others [pixels], and whether cells are counted.
    _reach, _counts_cells = 0, True

    def __init__(
        self,
        cell_size: float | None = None,
        height: tuple[float, float] | None = None,
        wall_depth: float | None = None,
    ) -> None:
        if cell_size is not None and not 0 < cell_size < math.inf:
            raise WrongValue.of("cell_size", f"{cell_size:g} m", "> 0 and finite")
        if height is not None and not height[0] < height[1]:
            raise WrongValue.of("height", f"{height[0]:g} to {height[1]:g} m", "from low to high")
        if wall_depth is not None and not wall_depth > 0:
            raise WrongValue.of("wall_depth", f"{wall_depth:g} m", "> 0")
        self._wanted, self._height, self._wall_depth = cell_size, height, wall_depth
        self.values: NDArray[np.int8] | None = None
        self._lower = np.zeros(2, dtype=np.int64)  # In pixels from 0.
        #: Of 3-D maps: free and occupied cells above each pixel, (2, rows, columns), in smallest cells.
        self._counts: NDArray[np.int32] | None = None
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
        is_same = self.cell_size == (self._wanted or unit)
        self.cell_size = self._wanted or unit
        if self._is_image(m):
            self._counts = self._seen = None
            return self._become(*self._image(m), is_same)
        changes = self._changes(m)
        self._seen = m
        if changes is None or self.values is None or (self._counts_cells and self._counts is None):
            return self._drawn_anew(m)
        cells = self._cells_in_band(changes.lower, changes.size, unit)
        if not cells.any():
            return None
        changed = self._boxes(changes.lower, changes.size, changes.after, cells > 0)
        if (changed.state == -1).any() and self._is_wasteful():
            return self._drawn_anew(m)
        is_whole = not self._contains(changed)
        if is_whole and self._counts is None:
            return self._drawn_anew(m)
        if is_whole:
            self._grow(changed)
        lower = np.maximum(changed.first.min(axis=0) - self._reach, self._lower)
        upper = np.minimum(
            changed.last.max(axis=0) + self._reach, self._lower + np.array(self.values.shape)[::-1]
        )
        column, row = (lower - self._lower).tolist()
        rows, columns = slice(row, row + upper[1] - lower[1]), slice(column, column + upper[0] - lower[0])
        before = self.values[rows, columns]
        if self._counts is not None:
            counts = self._counts[:, rows, columns]
            states = changes.before[cells > 0], changed.state
            _count(counts, changed, lower, states, cells[cells > 0])
            part = _seen_from_above(counts)
        else:
            part = self._drawn(m, lower, upper)
        found = GridPart(0, 0, self.values, True) if is_whole else difference(before, part, column, row)
        before[:] = part
        return found

    def _is_image(self, m: OccupancyMap) -> bool:
        """Whether a map is drawn as a whole."""
        return m.dim == 2 or self.cell_size != m.options["min_cell_size"]

    def _image(self, m: OccupancyMap) -> tuple[NDArray[np.int8], Ints]:
        """The smallest grid of all that is known, and its first pixel."""
        depth = (noise_depth(m) if self._wall_depth is None else self._wall_depth) if m.dim == 2 else None
        height = None if m.dim == 2 else self._height
        try:
            image, corner, _ = m.map_server_image(cell_size=self._wanted, height=height, wall_depth=depth)
        except ValueError as error:
            if "nothing" not in str(error):  # Of what is known there; else it is too large.
                raise
            return np.zeros((0, 0), np.int8), self._lower
        return _VALUES[image[::-1]], np.rint(np.array(corner) / self.cell_size).astype(np.int64)

    def _become(self, image: NDArray[np.int8], first: Ints, is_same: bool) -> GridPart | None:
        """Become an image that begins at a pixel, with room around it; what of that is new.

        `is_same`: Pixels are as large as before.
        """
        before, extent = self.values, np.array(image.shape)[::-1]
        if before is not None and is_same and (not image.size or self._has_room(first, first + extent)):
            self.values = np.full_like(before, UNKNOWN)
        elif image.size or before is not None:
            self._lower = first // GROWS * GROWS
            upper = -(-(first + extent) // GROWS) * GROWS
            self.values, before = np.full((upper - self._lower)[::-1], UNKNOWN, dtype=np.int8), None
        else:
            return None
        column, row = first - self._lower
        self.values[row : row + extent[1], column : column + extent[0]] = image
        return GridPart(0, 0, self.values, True) if before is None else difference(before, self.values)

    def _has_room(self, first: Ints, last: Ints) -> bool:
        """Whether pixels [first, last) are in the grid, and much of it is needed."""
        assert self.values is not None
        is_inside = (first >= self._lower).all() and (last <= self._lower + self.values.shape[::-1]).all()
        return bool(is_inside) and self.values.size <= SHRINKS * float(np.prod(last - first + 2 * GROWS))

    def _changes(self, m: OccupancyMap) -> Changes | None:
        """What is another than at the last look; None if that was at no map, or at one of another kind."""
        box = None
        if self._height is not None:  # And a cell more, for rounding.
            low, high = self._height[0] - self.cell_size, self._height[1] + self.cell_size
            box = np.array([[-_EVERYWHERE, -_EVERYWHERE, low], [_EVERYWHERE, _EVERYWHERE, high]])
        try:
            if self._seen is None:
                return None
            return m.changes(since=self._seen, of="columns", box=box)
        except ValueError:
            return None

    def _grow(self, boxes: _Boxes) -> None:
        """Become so large that boxes are in the grid."""
        assert self.values is not None and self._counts is not None
        lower, upper = self._lower, self._lower + self.values.shape[::-1]
        least = np.minimum(lower, boxes.first.min(axis=0) // GROWS * GROWS)
        most = np.maximum(upper, -(-boxes.last.max(axis=0) // GROWS) * GROWS)
        (left, low), (right, high) = (lower - least).tolist(), (most - upper).tolist()
        around = (low, high), (left, right)
        self.values = np.pad(self.values, around, constant_values=UNKNOWN)
        self._counts = np.pad(self._counts, ((0, 0), *around))
        self._lower = least

    def _pixels(self, lower: Floats, upper: Floats) -> tuple[Ints, Ints]:
        """The first pixels that boxes overlap, and those behind the last."""
        first, last = lower / self.cell_size, upper / self.cell_size
        near = np.rint(first), np.rint(last)
        first = np.where(np.abs(first - near[0]) < _WHOLE, near[0], np.floor(first))
        last = np.where(np.abs(last - near[1]) < _WHOLE, near[1], np.ceil(last))
        return first.astype(np.int64), last.astype(np.int64)

    def _cells_in_band(self, lower: Floats, size: Floats, unit: float) -> Ints:
        """How many smallest cells high boxes are, between the heights that count."""
        height = np.rint(size / unit).astype(np.int64)
        if self._height is None:
            return height
        low, high = (value / unit for value in self._height)
        first = round(low) if abs(low - round(low)) < _WHOLE else math.floor(low)
        last = round(high) if abs(high - round(high)) < _WHOLE else math.ceil(high)
        z = np.rint(lower[:, 2] / unit).astype(np.int64)
        return np.maximum(np.minimum(z + height, last) - np.maximum(z, first), 0)

    def _known(self, m: OccupancyMap) -> tuple[_Boxes, Ints]:
        """Of leaves that are known, and how many smallest cells high they are."""
        leaves = m.leaves(states=["free", "occupied"])
        unit = m.options["min_cell_size"]
        cells = self._cells_in_band(leaves.lower, leaves.size, unit)
        return self._boxes(leaves.lower, leaves.size, state_in_column(leaves), cells > 0), cells[cells > 0]

    def _boxes(self, lower: Floats, size: Floats, state: NDArray[np.int8], use: NDArray[np.bool_]) -> _Boxes:
        lower = lower[use, :2]
        return _Boxes(*self._pixels(lower, lower + size[use, None]), state[use])

    def _drawn(self, m: OccupancyMap, lower: Ints, upper: Ints) -> NDArray[np.int8]:
        """The pixels from lower to before upper, of a follower that does not count cells."""
        raise NotImplementedError

    def _drawn_anew(self, m: OccupancyMap) -> GridPart | None:
        known, cells = self._known(m)
        self._counts = None
        if not len(known.state):
            if self.values is None:
                return None
            self.values = np.full_like(self.values, UNKNOWN)
            return GridPart(0, 0, self.values, True)
        lower = known.first.min(axis=0) // GROWS * GROWS
        upper = -(-known.last.max(axis=0) // GROWS) * GROWS
        self._lower = lower
        if self._counts_cells:
            self._counts = np.zeros((2, *(upper - lower)[::-1]), dtype=np.int32)
            _count(self._counts, known, lower, (np.full_like(known.state, -1), known.state), cells)
            self.values = _seen_from_above(self._counts)
        else:
            self.values = self._drawn(m, lower, upper)
        return GridPart(0, 0, self.values, True)

    def _contains(self, boxes: _Boxes) -> bool:
        assert self.values is not None
        upper = self._lower + self.values.shape[::-1]
        return bool((boxes.first >= self._lower).all() and (boxes.last <= upper).all())

    def _is_wasteful(self) -> bool:
        """Whether the grid was much larger than what was known at the last look."""
        assert self.values is not None
        known = self.values != UNKNOWN
        rows, columns = (np.flatnonzero(known.any(axis=axis)) for axis in (1, 0))
        if not len(rows):
            return False
        extent = (rows[-1] - rows[0] + 2 * GROWS) * (columns[-1] - columns[0] + 2 * GROWS)
        return bool(self.values.size > SHRINKS * extent)


def state_in_column(leaves: Leaves) -> NDArray[np.int8]:
    """(n,) the state of leaves of a 3-D map as parts of a column."""
    return np.where(leaves.thin, 1, leaves.state).astype(np.int8)


def _count(
    counts: NDArray[np.int32],
    boxes: _Boxes,
    lower: Ints,
    states: tuple[NDArray[np.int8], NDArray[np.int8]],
    cells: Ints,
) -> None:
    """Move cells of boxes from the count of a state to that of another one.

    `counts` (2, rows, columns): Of free and of occupied cells; its first pixel is `lower`.
    `lower`: (2,).
    `states` (before, after): Of each box.
    `cells` (n,): How many cells are above a pixel of each box.
    """
    before, after = states
    size = counts.shape[1:]
    for state in (0, 1):
        change = ((after == state).astype(np.int64) - (before == state)) * cells
        use = change != 0
        at, which = pixels_in(boxes.first[use] - lower, boxes.last[use] - lower, size[1])
        sums = np.bincount(at, weights=change[use][which], minlength=size[0] * size[1])
        counts[state] += sums.reshape(size).astype(np.int32)


def _seen_from_above(counts: NDArray[np.int32]) -> NDArray[np.int8]:
    """Occupied where some cell above is, else free where one is, else unknown."""
    values = np.full(counts.shape[1:], UNKNOWN, dtype=np.int8)
    values[counts[0] > 0] = FREE
    values[counts[1] > 0] = OCCUPIED
    return values
