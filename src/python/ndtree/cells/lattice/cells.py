# SPDX-License-Identifier: BSD-3-Clause
"""Leaves on the lattice of the smallest."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndtree._native._core import Leaves, OccupancyMap

Booleans = NDArray[np.bool_]
Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True)
class Cells:
    """Leaves on the lattice of the smallest: corners and edges in whole units of `unit` metres."""

    unit: float
    branching: int
    lower: Integers  # (n, dim)
    size: Integers  # (n,)
    probability: Floats  # (n,)
    observed: Booleans  # (n,)
    state: NDArray[np.int8]  # (n,)
    hits: Integers  # (n,)
    misses: Integers  # (n,)

    @classmethod
    def of(cls, m: OccupancyMap) -> Cells:
        """All leaves of a map, in units of the smallest.

        Raises ValueError if nothing was inserted.
        """
        leaves: Leaves = m.leaves()
        if not leaves.size.size or not np.any(leaves.observed):
            raise ValueError("the map is empty: nothing was inserted that could be drawn")
        return cls.of_leaves(leaves, float(leaves.size.min()), m.branching)

    @classmethod
    def of_leaves(cls, leaves: Leaves, unit: float, branching: int) -> Cells:
        """Leaves in whole units [m] of their map."""
        size = np.asarray(leaves.size, dtype=np.float64)
        return cls(
            unit,
            branching,
            np.rint(np.asarray(leaves.lower) / unit).astype(np.int64),
            np.rint(size / unit).astype(np.int64),
            np.asarray(leaves.probability, dtype=np.float64),
            np.asarray(leaves.observed, dtype=np.bool_),
            np.asarray(leaves.state, dtype=np.int8),
            np.asarray(leaves.hits, dtype=np.int64),
            np.asarray(leaves.misses, dtype=np.int64),
        )

    def __len__(self) -> int:
        return len(self.size)

    @property
    def dim(self) -> int:
        return self.lower.shape[1]

    @property
    def upper(self) -> Integers:
        return self.lower + self.size[:, None]

    @property
    def occupied(self) -> Booleans:
        return self.state == 1

    @property
    def free(self) -> Booleans:
        return self.state == 0

    @property
    def known(self) -> Booleans:
        return self.state >= 0

    def where(self, chosen: Booleans | Integers | slice) -> Cells:
        """Some of the cells, by a mask, their numbers or a slice."""
        numbers = np.arange(len(self))[chosen] if isinstance(chosen, slice) else np.asarray(chosen)
        if numbers.dtype == np.bool_:
            if len(numbers) != len(self):
                raise IndexError(f"mask of {len(numbers)}, expected one of {len(self)} cells")
            numbers = np.flatnonzero(numbers)  # Once, not for each array.
        names = [f.name for f in fields(self) if f.name not in SCALARS]
        return replace(self, **{name: getattr(self, name).take(numbers, axis=0) for name in names})

    def along(self, axes: Sequence[int]) -> Cells:
        """The same cells with some of their axes only."""
        return replace(self, lower=self.lower[:, list(axes)])

    def inside(self, region: Sequence[float]) -> Cells:
        """Cells that touch a region (min, max of each axis) [m]."""
        keep = np.ones(len(self), dtype=np.bool_)
        for a in range(self.dim):
            keep &= self.upper[:, a] * self.unit > region[2 * a]
            keep &= self.lower[:, a] * self.unit < region[2 * a + 1]
        return self.where(keep)

    def through(self, axis: int, value: float) -> Cells:
        """Cells that the plane where one coordinate has a value [m] goes through."""
        at = math.floor(value / self.unit)
        return self.where((self.lower[:, axis] <= at) & (at < self.upper[:, axis]))


def occupied_cells(m: OccupancyMap) -> Cells:
    """The occupied leaves of a map alone, which takes less memory than `Cells.of`.

    Raises ValueError if nothing was inserted.
    """
    some = _chosen(m, states=("occupied",))
    if some is not None:
        return some
    every = Cells.of(m)
    return every.where(every.occupied)


def observed_sizes(m: OccupancyMap) -> tuple[float, float]:
    """Edges of the smallest and the largest observed cell [m], looked for in slab after slab."""
    lower, upper = observed_bounds(m)
    edges = np.linspace(lower[0], upper[0], 9)
    low, high = math.inf, 0.0
    for begin, end in zip(edges, edges[1:]):
        slab = np.array([[begin, *lower[1:]], [end, *upper[1:]]])
        leaves = m.leaves() if m.refinement == "octomap" else m.leaves(slab, states=("free", "occupied"))
        sizes = leaves.size[leaves.observed]
        low, high = min(low, sizes.min(initial=low)), max(high, sizes.max(initial=high))
        if m.refinement == "octomap":  # Gives all or none.
            break
    return low, high


def cells_through(m: OccupancyMap, axis: int, value: float) -> Cells:
    """The leaves of a map that the plane where one coordinate has a value [m] goes through."""
    box = np.array(observed_bounds(m))
    box[:, axis] = value
    some = _chosen(m, box)
    return (Cells.of(m) if some is None else some).through(axis, value)


def observed_bounds(m: OccupancyMap) -> tuple[Floats, Floats]:
    """Lower and upper corner [m] of what was observed. @raises ValueError if nothing was inserted."""
    if m.refinement != "octomap":
        bounds = m.bounds()
        if bounds is not None:
            return bounds
    every = Cells.of(m)  # Which says what is wrong, if nothing was.
    seen = every.where(every.observed)
    return seen.lower.min(axis=0) * every.unit, seen.upper.max(axis=0) * every.unit


def _chosen(
    m: OccupancyMap, box: Floats | None = None, states: tuple[str, ...] | None = None
) -> Cells | None:
    """Some leaves of a map of ours, in units of its smallest cells; None for OctoMap's."""
    if m.refinement == "octomap" or m.bounds() is None:
        return None
    chosen: Any = {} if states is None else {"states": states}
    return Cells.of_leaves(m.leaves(box, **chosen), m.min_cell_size, m.branching)


SCALARS = ("unit", "branching")
