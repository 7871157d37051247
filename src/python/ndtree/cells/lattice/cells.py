# SPDX-License-Identifier: BSD-3-Clause
"""Leaves on the lattice of the smallest."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

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

        Raises
        ------
        ValueError
            If nothing was inserted.
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
        arrays = {f.name: getattr(self, f.name)[chosen] for f in fields(self) if f.name not in SCALARS}
        return replace(self, **arrays)

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


SCALARS = ("unit", "branching")
