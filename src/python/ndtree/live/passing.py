# SPDX-License-Identifier: BSD-3-Clause
"""Where something came into free space and has not stood there for long: no obstacle of a grid yet.

Strategy: `OccupancyMap.moved` says of each point, before it is mapped, whether it is where the map is free.
Its column is marked, and those beside it; later also columns beside marked ones that are hit, for the map
cannot tell these apart from them. A column that is hit later than it has to stand for loses its mark. One
that is not hit any more keeps it until it is forgotten, for no scan has seen it stay. What is an obstacle
of the grid already stays one.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ndtree._native._core import OccupancyMap
from ndtree.base.options import default_of
from ndtree.base.scan import Scan
from ndtree.maps.ground import FREE, OCCUPIED

Ints = NDArray[np.int64]

#: For how long something has to stand, unless another time is given [s].
STAYS: float = default_of("grid_stays")
#: Beams of a scan that are looked at, or up to twice as many; others the next time: neighbours say the same.
BEAMS = 1 << 15
#: A mark is forgotten after this many times the time that something has to stand for.
_FORGOTTEN = 5.0
#: Columns beside one, and itself.
_BESIDE = np.array([(x << 32) + y for x in (-1, 0, 1) for y in (-1, 0, 1)])


class Passing:
    """Columns that are marked.

    `stays`: For how long something has to stand [s]; 0: nothing is marked.
    `height`: Points between which heights count, of a 3-D map [m]; else all.
    """

    def __init__(
        self, stays: Callable[[], float], height: Callable[[], tuple[float, float]] | None = None
    ) -> None:
        self._stays, self._height = stays, height
        self._size = 0.0
        self._marks: tuple[Ints, NDArray[np.float64]]
        self.begin()

    def begin(self) -> None:
        """Forget all marks."""
        self._scans = 0
        self._marks = np.zeros(0, np.int64), np.zeros(0)

    def note(self, m: OccupancyMap, scan: Scan) -> None:
        """Take note of a scan, before it is mapped."""
        stays = self._stays()
        if stays <= 0.0 or scan.points_only:
            self.begin()
            return
        self._size = m.options["min_cell_size"]
        self._scans += 1
        step = len(scan) // BEAMS
        if step > 1:  # One of `step` that follow each other, drawn: not the same columns of an image.
            some, first = np.zeros(len(scan), dtype=bool), np.arange(0, len(scan) - step + 1, step)
            some[first + np.random.default_rng(self._scans).integers(step, size=len(first))] = True
            scan = scan.only(some)
        ends = scan.endpoints[scan.hits()]
        if self._height is not None and m.dim == 3:
            low, high = self._height()
            ends = ends[(ends[:, 2] >= low) & (ends[:, 2] < high)]
        columns, since = self._marks
        young = (scan.stamp - since <= _FORGOTTEN * stays) & (since <= scan.stamp)
        columns, since = columns[young], since[young]
        moved = m.moved(ends)
        # Where somebody walked a scan ago, the map is free, but undecided.
        came = self._columns_of(ends[(moved > 0.5) | ((moved >= 0.5) & (m.state(ends) == FREE))])
        # One alone is an edge of what stands: beside others it is part of something.
        came = came[np.isin(came[:, None] + _BESIDE, came).sum(axis=1) > 1]
        hit = np.setdiff1d(self._columns_of(ends), came)
        stood = np.isin(columns, hit) & (scan.stamp - since > stays)
        columns, since = columns[~stood], since[~stood]
        again = np.isin(columns, came) & (scan.stamp - since > stays)
        since[again] = scan.stamp
        new = [np.setdiff1d(_with_those_beside(came), columns)]
        times = [np.full(len(new[0]), scan.stamp)]
        recent = scan.stamp - since <= stays
        beside = np.intersect1d(hit, _with_those_beside(columns[recent]))
        both = np.setdiff1d(beside, np.concatenate([columns, new[0]]))
        if len(both):
            order = np.argsort(columns, kind="stable")
            near = both[:, None] + _BESIDE
            at = np.minimum(np.searchsorted(columns[order], near), max(len(order) - 1, 0))
            is_there = (columns[order][at] == near) & recent[order][at]
            new.append(both)
            times.append(np.where(is_there, since[order][at], -np.inf).max(axis=1))
        self._marks = np.concatenate([columns, *new]), np.concatenate([since, *times])

    def places(self) -> NDArray[np.float64]:
        """Centres of the marked columns, (k, 2) [m]."""
        columns = self._marks[0]
        x = (columns + (1 << 31)) >> 32
        return (np.stack([x, columns - (x << 32)], axis=1) + 0.5) * self._size

    def _columns_of(self, ends: NDArray[np.floating]) -> Ints:
        x, y = np.floor(ends[:, :2].astype(np.float64) / self._size).astype(np.int64).T
        return np.unique((x << 32) + y)


def _with_those_beside(columns: Ints) -> Ints:
    return np.unique((columns[:, None] + _BESIDE).ravel())


def hide(
    values: NDArray[np.int8],
    origin: tuple[float, float],
    size: float,
    places: NDArray[np.float64],
    published: tuple[NDArray[np.int8], tuple[float, float]] | None,
) -> None:
    """Let pixels of a grid be free around places, but for pixels that were published as obstacles.

    `values`, `origin`, `size`: The grid, (rows, columns), which is changed; its lower corner and a pixel [m].
    `places`: (k, 2) [m].
    `published`: The grid before, and its lower corner.
    """
    at = np.floor((places - origin) / size).astype(np.int64)[:, ::-1]
    at = at[((at >= 0) & (at < values.shape)).all(axis=1)]
    at = at[values[tuple(at.T)] == OCCUPIED]
    if published is not None and len(at):
        before, corner = published
        there = at + np.rint((np.array(origin) - corner) / size).astype(np.int64)[::-1]
        inside = ((there >= 0) & (there < before.shape)).all(axis=1)
        there[~inside] = 0
        at = at[~inside | (before[tuple(there.T)] != OCCUPIED)]
    values[tuple(at.T)] = FREE
