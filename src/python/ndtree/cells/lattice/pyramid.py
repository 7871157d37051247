# SPDX-License-Identifier: BSD-3-Clause
"""Coarser views of cells."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ndtree.cells.lattice.cells import Block, Booleans, Cells, Floats, Integers, block_runs
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
        index = CellIndex(cells.lower, cells.size, cells.branching) if len(cells) else None
        return cls._of_leaves(lower, upper, colors)._grown(index, cells.branching**cells.dim)

    @classmethod
    def of_blocks(
        cls, cells: Cells, lower: Floats, upper: Floats, colors: NDArray[np.uint8], edge: int
    ) -> dict[Block, Pyramid]:
        """A pyramid of each cube of `edge` units, see `parted`."""
        if not len(cells):
            return {}
        index = CellIndex(cells.lower, cells.size, cells.branching, least_block=edge)
        levels = round(math.log(edge, cells.branching))
        whole = cls._of_leaves(lower, upper, colors)._grown(index, cells.branching**cells.dim, levels)
        blocks = np.zeros((len(whole.parent), cells.dim), dtype=np.int64)
        blocks[: len(cells)] = cells.lower // edge
        nodes = np.arange(len(cells))
        while len(nodes):
            nodes = nodes[whole.parent[nodes] >= 0]
            blocks[whole.parent[nodes]] = blocks[nodes]
            nodes = np.unique(whole.parent[nodes])
        place = np.empty(len(blocks), dtype=np.int64)
        parts = {}
        for block, run in block_runs(blocks):
            place[run] = np.arange(len(run))
            part = whole._where(run)
            part.parent[:] = np.where(part.parent >= 0, place[part.parent], -1)
            parts[block] = part
        return parts

    @classmethod
    def over(cls, parts: Mapping[Block, Pyramid], branching: int) -> Pyramid:
        """One of those of all cubes: their boxes in the order of the parts, and coarser ones after them."""
        every = list(parts.values())
        offsets = np.cumsum([0, *(len(part.parent) for part in every)])
        parents = [
            np.where(part.parent >= 0, part.parent + offset, -1) for part, offset in zip(every, offsets)
        ]
        whole = cls(
            *(np.concatenate([getattr(part, name) for part in every]) for name in _DRAWN),
            np.concatenate(parents),
            np.concatenate([part.is_leaf for part in every]),
        )
        corners = np.array(list(parts), dtype=np.int64)
        index = CellIndex(corners, np.ones(len(corners), dtype=np.int64), branching)
        roots = np.flatnonzero(whole.parent < 0)  # One of each, as it is for a cube.
        return whole._grown(index, branching ** corners.shape[1], roots=roots)

    @classmethod
    def _of_leaves(cls, lower: Floats, upper: Floats, colors: NDArray[np.uint8]) -> Pyramid:
        n = len(lower)
        return cls(
            lower.astype(np.float32),
            upper.astype(np.float32),
            colors.astype(np.uint8),
            np.ones(n),
            np.full(n, -1, dtype=np.int64),
            np.ones(n, dtype=np.bool_),
        )

    def _where(self, chosen: Integers) -> Pyramid:
        return Pyramid(*(getattr(self, field.name)[chosen] for field in fields(self)))

    def _grown(
        self, index: CellIndex | None, fan: int, levels: int | None = None, roots: Integers | None = None
    ) -> Pyramid:
        """With the boxes of cells that are coarser by up to this many levels, each of `fan` parts.

        The i-th cell of the index is the i-th of the roots, which are all boxes if none are given.
        """
        if index is None:
            return self
        nodes, group = index.order if roots is None else roots[index.order], index.first
        low, high = self.lower[nodes], self.upper[nodes]
        color, weight = self.colors[nodes].astype(np.float64), self.weight[nodes]
        parts = [(self.lower, self.upper, self.colors, self.weight)]
        total = len(self.parent)
        above = []  # Children and their parents.
        while len(nodes) > 1 and levels != 0:
            levels = None if levels is None else levels - 1
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
        more = total - len(self.parent)
        parent = np.append(self.parent, np.full(more, -1, dtype=np.int64))
        for child, its_parent in above:
            parent[child] = its_parent
        is_leaf = np.append(self.is_leaf, np.zeros(more, dtype=np.bool_))
        return Pyramid(*(np.concatenate(each) for each in zip(*parts)), parent, is_leaf)

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


_DRAWN = ("lower", "upper", "colors", "weight")
