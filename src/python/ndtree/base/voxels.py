# SPDX-License-Identifier: BSD-3-Clause
"""Points without a sensor: the smallest cells that hold one become occupied, and nothing becomes free.

Strategy: points are rounded to cells, which are put into blocks. Each block becomes a map by way of a dense
array, and these maps are added up in pairs, at last to the target: O(n log n) of n points, with room for one
block.
"""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ndtree._errors import WrongValue, key
from ndtree._native import _core
from ndtree._native.results import InsertReport

if TYPE_CHECKING:
    from ndtree._native._core import OccupancyMap

#: Cells along an edge of a block, by dimension.
_BLOCK = {2: 1024, 3: 128}
_OCCUPIED, _UNKNOWN = 1, -1
_REFINEMENTS = ("evidence", "paper", "fixed")


def voxelise(points: NDArray[np.floating[Any]], target: OccupancyMap) -> InsertReport:
    """Make the smallest cells of a map occupied that hold a point; the order of the points does not matter.

    `points` (ndarray of float, (n, dim)): In the map frame [m]. Points that are not finite are counted as
        invalid.
    `target`: Of 2 children per axis.
    Raises ValueError if the map has another branching, or a point is too far away for its cells.
    """
    begin = time.perf_counter()
    if target.branching != 2 or target.refinement not in _REFINEMENTS:
        raise WrongValue(
            f"{key('branching')} = {target.branching}, {key('refinement')} = {target.refinement!r}: points "
            f"without a sensor need a map with branching 2 and one of {', '.join(_REFINEMENTS)}"
        )
    size = float(target.options["min_cell_size"])
    finite = np.isfinite(points).all(axis=1)
    at = points[finite].astype(np.float64)
    cells = np.floor(at / size)
    cells -= cells * size > at  # The borders decide, as in the map: 17 cells of 0.1 m end beyond 1.7 m.
    cells += (cells + 1) * size <= at
    far = np.abs(cells).max(initial=0.0)
    if far >= 2**30:
        raise ValueError(
            f"a point is {far * size:.4g} m from 0, expected less than 2**30 cells of {size:g} m"
        )
    blocks, inside = np.divmod(cells.astype(np.int64), _BLOCK[target.dim])
    blocks, inside = np.split(distinct(np.concatenate([blocks, inside], axis=1)), 2, axis=1)
    keys = blocks * _BLOCK[target.dim] + inside
    is_first = np.concatenate([[len(keys) > 0], (blocks[1:] != blocks[:-1]).any(axis=1)])
    starts = np.flatnonzero(is_first)
    made: list[tuple[int, OccupancyMap]] = []  # Maps of equal numbers of blocks are added up in pairs.
    for first, last in zip(starts, [*starts[1:], len(keys)]):
        made.append((1, _occupied(keys[first:last], size, target)))
        while len(made) > 1 and made[-1][0] >= made[-2][0]:
            (count, one), (more, other) = made.pop(), made.pop()
            other.merge(one)
            made.append((count + more, other))
    for _, one in reversed(made):
        if target.refinement != "fixed" and one.options["max_cell_size"] != target.options["max_cell_size"]:
            raise WrongValue(
                f"{key('max_cell_size')} = {target.options['max_cell_size']:g} m: points without a sensor "
                f"need {one.options['max_cell_size']:g} m"
            )
        target.merge(one)
    count = int(np.count_nonzero(finite))
    return InsertReport(
        beams=len(points),
        returned=count,
        not_returned=0,
        beyond_max_range=0,
        invalid=len(points) - count,
        updates=len(keys),
        splits=0,
        merges=0,
        seconds=time.perf_counter() - begin,
    )


def distinct(rows: NDArray[np.int64], **also: Any) -> Any:
    """What `numpy.unique` says of rows with these keywords.

    Where they fit into one number each, which is the rule, these are sorted instead.
    """
    if not len(rows):
        return np.unique(rows, axis=0, **also)
    lower = np.array([one.min() for one in rows.T])  # Much faster one by one, as rows are short.
    shape = [int(one.max()) - int(least) + 1 for one, least in zip(rows.T, lower)]
    if math.prod(shape) >= 1 << 62:
        return np.unique(rows, axis=0, **also)
    found = np.unique(np.ravel_multi_index(tuple((rows - lower).T), shape), **also)
    numbers, *others = found if also else (found,)
    different = np.stack(np.unravel_index(numbers, shape), axis=1) + lower
    return (different, *others) if also else different


def _occupied(keys: NDArray[np.int64], size: float, like: OccupancyMap) -> OccupancyMap:
    """A map with some cells of a block occupied, and the rest unknown."""
    lower = keys.min(axis=0)
    states = np.full(keys.max(axis=0) - lower + 1, _UNKNOWN, dtype=np.int8)
    states[tuple((keys - lower).T)] = _OCCUPIED
    made = _core.from_grid(states, lower * size, size, refinement=like.refinement)  # type: ignore[call-overload]
    return made  # type: ignore[no-any-return]
