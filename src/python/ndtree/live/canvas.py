# SPDX-License-Identifier: BSD-3-Clause
"""Pixels of a plane around what a map has observed, and the part of them that has changed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ndtree.maps.ground import UNKNOWN

Ints = NDArray[np.int64]
Pixels = NDArray[np.int8]

#: The grid grows to multiples of this many pixels, so that it seldom does.
GROWS = 64
#: A grid that is so much larger than what is known becomes smaller, as behind a window that moves.
SHRINKS = 4.0


@dataclass(frozen=True)
class GridPart:
    """A part of the grid, or all of it, that is to be sent.

    `column`, `row`: Where it begins in the grid.
    `values` (rows, columns) int8: -1 unknown, 0 free, 100 occupied; the first row has the least y.
    `is_whole`: The grid has another size or origin than before.
    """

    column: int
    row: int
    values: Pixels
    is_whole: bool


def difference(before: Pixels, after: Pixels, column: int = 0, row: int = 0) -> GridPart | None:
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


class Canvas:
    """A grid of int8 that grows and shrinks; pixels are counted from 0 of the map.

    Attributes:
    `values` (rows, columns) int8: Unknown where nothing was painted.
    `lower` (2,): Its first pixel, x and y.
    """

    def __init__(self, first: Ints, last: Ints) -> None:
        """Of pixels [first, last) with room around them."""
        self.lower = first // GROWS * GROWS
        self.values = np.full((-(-last // GROWS) * GROWS - self.lower)[::-1], UNKNOWN, dtype=np.int8)

    @property
    def upper(self) -> Ints:
        """The pixel behind the last, x and y."""
        return self.lower + self.values.shape[::-1]

    def part(self, first: Ints, last: Ints) -> tuple[slice, slice]:
        """Rows and columns of pixels [first, last)."""
        (left, low), (right, high) = (first - self.lower).tolist(), (last - self.lower).tolist()
        return slice(low, high), slice(left, right)

    def has_room(self, first: Ints, last: Ints) -> bool:
        """Whether pixels [first, last) are in the grid, and much of it is needed."""
        is_inside = (first >= self.lower).all() and (last <= self.upper).all()
        return bool(is_inside) and self.values.size <= SHRINKS * float(np.prod(last - first + 2 * GROWS))

    def grow(self, first: Ints, last: Ints) -> tuple[tuple[int, int], tuple[int, int]] | None:
        """Get room for pixels [first, last): rows and columns that it takes around; None if it has it."""
        wanted = Canvas(np.minimum(first, self.lower), np.maximum(last, self.upper))
        (left, low), (right, high) = (
            (self.lower - wanted.lower).tolist(),
            (wanted.upper - self.upper).tolist(),
        )
        if not (left or low or right or high):
            return None
        around = (low, high), (left, right)
        self.values = np.pad(self.values, around, constant_values=UNKNOWN)
        self.lower = wanted.lower
        return around

    @property
    def is_wasteful(self) -> bool:
        """Whether it is much larger than what is known."""
        known = self.values != UNKNOWN
        rows, columns = (np.flatnonzero(known.any(axis=axis)) for axis in (1, 0))
        if not len(rows):
            return False
        extent = (rows[-1] - rows[0] + 2 * GROWS) * (columns[-1] - columns[0] + 2 * GROWS)
        return bool(self.values.size > SHRINKS * extent)
