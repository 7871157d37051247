# SPDX-License-Identifier: BSD-3-Clause
"""Coarser views of cells."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ndtree.lattice.cells import Cells, Floats, Integers
from ndtree.lattice.neighbours import CellIndex


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


class Pyramid:
    """Boxes that can be drawn coarser the farther they are away, never more than a budget of them.

    The boxes are the leaves of a tree; what a coarser cell contains is drawn as the one box that bounds it,
    in its mean color. A node's extent and distance bound those of its children, so that cutting the tree at
    one apparent size leaves every leaf under exactly one drawn node.
    """

    def __init__(self, cells: Cells, lower: Floats, upper: Floats, colors: NDArray[np.uint8]) -> None:
        """`lower`, `upper` (n, 3) are the boxes to draw [m], `colors` (n, 3)."""
        n = len(cells)
        self.leaves = n
        parts = [(lower, upper, colors.astype(np.float64), np.ones(n))]
        parents = np.full(n, -1, dtype=np.int64)
        if n:
            index = CellIndex(cells.lower, cells.size, cells.branching)
            key = np.zeros(n, dtype=np.int64)
            key[index.order] = index.first
            parents = self._joined(key, cells, parts)
        lower, upper, color, self.weight = (np.concatenate(each) for each in zip(*parts))
        self.lower, self.upper = lower.astype(np.float32), upper.astype(np.float32)
        self.colors = np.rint(color).astype(np.uint8)
        self.parent = parents
        self.extent = np.max(self.upper - self.lower, axis=1, initial=0.0)

    @staticmethod
    def _joined(key: Integers, cells: Cells, parts: list[tuple[Floats, ...]]) -> Integers:
        """Adds the coarser cells' boxes to the parts; returns each box's parent."""
        fan = cells.branching**cells.dim
        parents = np.full(len(cells), -1, dtype=np.int64)
        nodes = np.argsort(key, kind="stable")  # The present cut of the tree.
        group = key[nodes]
        while len(nodes) > 1:
            group = group // fan
            first = np.flatnonzero(np.diff(group, prepend=group[0] - 1))
            count = np.diff(np.append(first, len(nodes)))
            joins = count > 1
            low, high, color, weight = (np.concatenate(each) for each in zip(*parts))
            number = np.where(joins, len(parents) + np.cumsum(joins) - 1, nodes[first])
            joined = np.repeat(joins, count)
            parents[nodes[joined]] = np.repeat(number, count)[joined]
            parents = np.append(parents, np.full(np.count_nonzero(joins), -1))
            total = np.add.reduceat(weight[nodes], first)
            mean = np.add.reduceat(color[nodes] * weight[nodes, None], first) / total[:, None]
            lowest = np.minimum.reduceat(low[nodes], first)
            highest = np.maximum.reduceat(high[nodes], first)
            parts.append((lowest[joins], highest[joins], mean[joins], total[joins]))
            nodes, group = number, group[first]
        return parents

    def chosen(self, eye: Floats | None, budget: int, finest: float = 0.0) -> Integers:
        """Numbers of the boxes to be drawn.

        Parameters
        ----------
        eye : (3,), optional
            Where the viewer stands [m]; left out, all boxes are equally far.
        budget : int
            No more boxes than this, if the tree has so coarse a cut.
        finest : float
            Boxes whose extent by distance is less are not told apart.
        """
        if self.leaves <= budget:
            return np.arange(self.leaves)
        apparent = self.extent
        if eye is not None:
            away = np.linalg.norm(np.maximum(np.maximum(self.lower - eye, eye - self.upper), 0.0), axis=1)
            near = float(self.extent[: self.leaves].min())
            apparent = self.extent / np.maximum(away, near)
        has_parent = self.parent >= 0
        above = np.where(has_parent, apparent[self.parent], np.inf)
        own = apparent.copy()
        own[: self.leaves] = 0.0
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
