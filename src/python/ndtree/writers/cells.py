# SPDX-License-Identifier: BSD-3-Clause
"""Which of a map's cells are written, as arrays on the lattice of the smallest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np
from numpy.typing import NDArray

from ndtree._core import OccupancyMap
from ndtree.lattice import Cells, frontier

#: What can be chosen; frontier cells are unknown space beside free cells.
STATES = ("occupied", "free", "frontier")


def selected(m: OccupancyMap, states: Sequence[str]) -> Cells:
    """The cells of these states, observed ones in the order of ``m.leaves()``, and then the frontier.

    Raises
    ------
    ValueError
        If a name is none of `STATES`, there is none, or the map has no such cells.
    """
    if isinstance(states, str) or not states or any(state not in STATES for state in states):
        raise ValueError(f"states = {states!r}: must be some of {', '.join(STATES)}")
    every = Cells.of(m)
    chosen = np.zeros(len(every), dtype=np.bool_)
    if "occupied" in states:
        chosen |= every.occupied
    if "free" in states:
        chosen |= every.free
    cells = every.where(chosen)
    if "frontier" in states:
        cells = _joined(cells, frontier(every))
    if not len(cells):
        raise ValueError(f"states = {', '.join(states)}: the map has no such cells")
    return cells


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

    Raises
    ------
    ValueError
        If that would move them by more than a hundredth of the smallest cell.
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
