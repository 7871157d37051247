# SPDX-License-Identifier: BSD-3-Clause
"""Coarser views of cells."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ndtree.cells.lattice.cells import Booleans, Cells, Floats, Integers
from ndtree.cells.lattice.neighbours import CellIndex


def coarsened(cells: Cells, size: int) -> tuple[Cells, Integers]:
    """The cells with those smaller than `size` units made one where they share a cell of that size.

    Returns the cells and, for each of the old ones, the number of its new one. What is joined has the largest
    probability, and the sum of the hits and misses; it is occupied if any of it is, else unknown if any of it
    is, else free. `size` is a power of the branching.
    """
    edge = np.maximum(cells.size, size)
    lower = cells.lower // edge[:, None] * edge[:, None]
    order = np.lexsort(lower.T)
    begins = np.ones(len(cells), dtype=np.bool_)
    begins[1:] = np.any(lower[order[1:]] != lower[order[:-1]], axis=1)
    first = np.flatnonzero(begins)
    number = np.empty(len(cells), dtype=np.int64)
    number[order] = np.cumsum(begins) - 1
    state = np.maximum.reduceat(cells.state[order], first)
    joined = replace(
        cells,
        lower=lower[order[first]],
        size=edge[order[first]],
        probability=np.maximum.reduceat(cells.probability[order], first),
        observed=np.maximum.reduceat(cells.observed[order], first),
        state=np.where((state == 0) & (np.minimum.reduceat(cells.state[order], first) < 0), -1, state).astype(
            np.int8
        ),
        hits=np.add.reduceat(cells.hits[order], first),
        misses=np.add.reduceat(cells.misses[order], first),
    )
    return joined, number


@dataclass(frozen=True, eq=False)
class Pyramid:
    """Boxes that can be drawn coarser the farther they are away, never more than a budget of them.

    The boxes are the leaves of a tree; what a coarser cell contains is drawn as the one box that bounds it,
    in its mean color. A node's extent and distance bound those of its children, so that cutting the tree at
    one apparent size leaves every leaf under exactly one drawn node.
    """

    lower: NDArray[np.float32]  # (n, 3) [m]
    upper: NDArray[np.float32]  # (n, 3) [m]
    colors: NDArray[np.uint8]  # (n, 3)
    weight: Floats  # (n,): how many leaves a box stands for.
    parent: Integers  # (n,); -1 for none.
    is_leaf: Booleans  # (n,)

    @classmethod
    def of(cls, cells: Cells, lower: Floats, upper: Floats, colors: NDArray[np.uint8]) -> Pyramid:
        """Of boxes `lower`, `upper` (n, 3) [m] of cells, in `colors` (n, 3): they are first."""
        n, fan = len(lower), cells.branching**cells.dim
        low, high, weight = lower.astype(np.float32), upper.astype(np.float32), np.ones(n)
        parts = [(low, high, colors.astype(np.uint8), weight)]
        if not n:
            return cls(*parts[0], np.full(0, -1, dtype=np.int64), np.ones(0, dtype=np.bool_))
        index = CellIndex(cells.lower, cells.size, cells.branching)
        nodes, group = index.order, index.first
        low, high, color, weight = low[nodes], high[nodes], colors[nodes].astype(np.float64), weight[nodes]
        total = n
        above = []  # Children and their parents.
        while len(nodes) > 1:
            group = group // fan
            first = np.flatnonzero(np.diff(group, prepend=group[0] - 1))
            count = np.diff(np.append(first, len(nodes)))
            joins = count > 1
            number = np.where(joins, total + np.cumsum(joins) - 1, nodes[first])
            has_new = np.repeat(joins, count)
            above.append((nodes[has_new], np.repeat(number, count)[has_new]))
            heavy = np.add.reduceat(weight, first)
            color = np.add.reduceat(color * weight[:, None], first) / heavy[:, None]
            low, high = np.minimum.reduceat(low, first), np.maximum.reduceat(high, first)
            nodes, group, weight = number, group[first], heavy
            parts.append((low[joins], high[joins], np.rint(color[joins]).astype(np.uint8), heavy[joins]))
            total += int(np.count_nonzero(joins))
        parent = np.full(total, -1, dtype=np.int64)
        for child, its_parent in above:
            parent[child] = its_parent
        return cls(*(np.concatenate(each) for each in zip(*parts)), parent, np.arange(total) < n)

    @cached_property
    def extent(self) -> Floats:
        """The longest edge of each box (n,) [m]."""
        return np.max(self.upper - self.lower, axis=1, initial=0.0)

    @property
    def leaves(self) -> int:
        """How many boxes are those of cells."""
        return int(np.count_nonzero(self.is_leaf))

    def chosen(self, eye: Floats | None, budget: int, finest: float = 0.0) -> Integers:
        """Numbers of the boxes to be drawn.

        `eye` (3,): Where the viewer stands [m]; left out, all boxes are equally far.
        `budget`: No more boxes than this, if the tree has so coarse a cut.
        `finest`: Boxes whose extent by distance is less are not told apart.
        """
        if self.leaves <= budget:
            return np.flatnonzero(self.is_leaf)
        apparent = self.extent
        if eye is not None:
            away = np.linalg.norm(np.maximum(np.maximum(self.lower - eye, eye - self.upper), 0.0), axis=1)
            near = float(self.extent[self.is_leaf].min())
            apparent = self.extent / np.maximum(away, near)
        has_parent = self.parent >= 0
        above = np.where(has_parent, apparent[self.parent], np.inf)
        own = apparent.copy()
        own[self.is_leaf] = 0.0
        low, high = max(finest, 1e-9), float(apparent.max()) * 1.01
        if np.count_nonzero((above > low) & (own <= low)) > budget:
            for _ in range(30):
                middle = math.sqrt(low * high)
                if np.count_nonzero((above > middle) & (own <= middle)) > budget:
                    low = middle
                else:
                    high = middle
            low = high
        return np.flatnonzero((above > low) & (own <= low))
