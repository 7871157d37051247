# SPDX-License-Identifier: BSD-3-Clause
"""Which of a map's cells are written, as arrays on the lattice of the smallest."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np
from numpy.typing import NDArray

from ndtree._errors import WrongValue, key
from ndtree._native._core import OccupancyMap
from ndtree.cells.lattice import Cells, frontier

#: What can be chosen; frontier cells are unknown space beside free cells.
STATES = ("occupied", "free", "frontier")


#: Cells of a grid that are looked at together, where cells of another size are made.
_AT_ONCE = 1 << 24


def selected(m: OccupancyMap, states: Sequence[str], cell_size: float | None = None) -> Cells:
    """The cells of these states, observed ones in the order of ``m.leaves()``, and then the frontier.

    With a cell size other than the map's smallest, cells of that size by the rule of
    ``OccupancyMap.to_grid()``, the last axis first; they have no counts of hits and misses.

    Raises ValueError if a name is none of `STATES`, there is none, or the map has no such cells.
    """
    if isinstance(states, str) or not states or any(state not in STATES for state in states):
        raise WrongValue.of("states", f"{states!r}", f"some of {', '.join(STATES)}")
    every = Cells.of(m)
    if cell_size is not None:
        every = _of_size(m, every, cell_size)
    chosen = np.zeros(len(every), dtype=np.bool_)
    if "occupied" in states:
        chosen |= every.occupied
    if "free" in states:
        chosen |= every.free
    cells = every.where(chosen)
    if "frontier" in states:
        cells = _joined(cells, frontier(every))
    if not len(cells):
        raise WrongValue(f"{key('states')} = {', '.join(states)}: the map has no such cells")
    return cells


def _of_size(m: OccupancyMap, own: Cells, cell_size: float) -> Cells:
    """The known cells of one size.

    Raises ValueError if nothing is known, or the size is not > 0 and finite.
    """
    if not (cell_size > 0 and math.isfinite(cell_size)):
        raise WrongValue.of("cell_size", f"{cell_size} m", "> 0 and finite")
    if abs(cell_size - m.options["min_cell_size"]) <= 1e-9 * cell_size:
        return own
    known = own.where(own.known)
    if not len(known):
        raise ValueError("the map is empty: nothing is known")
    first = np.floor(known.lower.min(axis=0) * (own.unit / cell_size) + 1e-9).astype(np.int64)
    last = np.ceil(known.upper.max(axis=0) * (own.unit / cell_size) - 1e-9).astype(np.int64)
    step = max(1, int(_AT_ONCE // max(1.0, float(np.prod((last - first)[1:], dtype=np.float64)))))
    lowers, values = [], []
    for begin in range(int(first[0]), int(last[0]), step):  # Slab by slab, so that memory stays small.
        corner, end = first.copy(), last.copy()
        corner[0], end[0] = begin, min(begin + step, int(last[0]))
        grid = m.to_grid([corner * cell_size, (end - 0.5) * cell_size], cell_size, values="log_odds")
        at = np.nonzero(grid)
        lowers.append(np.stack(at, axis=1) + corner)
        values.append(grid[at].astype(np.float64))
    lower, log_odds = np.concatenate(lowers), np.concatenate(values)
    n = len(lower)
    none = np.zeros(n, dtype=np.int64)
    return Cells(
        unit=cell_size,
        branching=m.branching,
        lower=lower,
        size=np.ones(n, dtype=np.int64),
        probability=1 / (1 + np.exp(-log_odds)),
        observed=np.ones(n, dtype=np.bool_),
        state=(log_odds > 0).astype(np.int8),
        hits=none,
        misses=none,
    )


def _joined(one: Cells, other: Cells) -> Cells:
    arrays = {
        f.name: np.concatenate([getattr(one, f.name), getattr(other, f.name)])
        for f in fields(one)
        if isinstance(getattr(one, f.name), np.ndarray)
    }
    return replace(one, **arrays)


def centres(cells: Cells) -> NDArray[np.float64]:
    """(n, dim) [m], to the last bit as the library has them."""
    return cells.lower * cells.unit + 0.5 * (cells.size * cells.unit)[:, None]


def in_space(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 3): points of the plane get z = 0."""
    dim = points.shape[1]
    if dim > 3:
        raise ValueError(f"a map with dim = {dim}: must be 2 or 3")
    return np.hstack([points, np.zeros((len(points), 3 - dim))])


def as_float32(points: NDArray[np.float64], unit: float, what: str) -> NDArray[np.float32]:
    """Coordinates for formats that have no more digits.

    Raises ValueError if that would move them by more than a hundredth of the smallest cell.
    """
    narrow = points.astype(np.float32)
    moved = float(np.abs(narrow.astype(np.float64) - points).max(initial=0.0))
    if moved > 0.01 * unit:
        far = float(np.abs(points).max())
        raise ValueError(
            f"coordinates up to {far:.0f} m: {what} has 24 bits for them, which moves cells of {unit:g} m "
            f"by {moved:.2g} m; shift the map to its origin first"
        )
    return narrow
