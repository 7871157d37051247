# SPDX-License-Identifier: BSD-3-Clause
"""Leaves on the lattice of the smallest: neighbours, covered faces, unknown by free space, coarser views."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from ndtree._core import Leaves, OccupancyMap

Booleans = NDArray[np.bool_]
Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

_MAX_BLOCK = 1 << 20
_KEY_BITS = 62


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
        """All leaves of a map.

        Raises
        ------
        ValueError
            If nothing was inserted.
        """
        leaves: Leaves = m.leaves()
        size = np.asarray(leaves.size, dtype=np.float64)
        if not size.size or not np.any(leaves.observed):
            raise ValueError("the map is empty: nothing was inserted that could be drawn")
        unit = float(size.min())
        return cls(
            unit,
            m.branching,
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

    def where(self, chosen: Booleans | Integers) -> Cells:
        """Some of the cells, by a mask or by their numbers."""
        arrays = {f.name: getattr(self, f.name)[chosen] for f in fields(self) if f.name not in _SCALARS}
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


_SCALARS = ("unit", "branching")


# --- Neighbours -----------------------------------------------------------------------------------


class CellIndex:
    """Finds the cell at a place, among cells that do not overlap.

    Cells are kept in the order of a tree's depth-first walk, in which all that lies in one cell follows each
    other: a cell is a range of numbers, and a binary search finds the range that a place is in. Blocks of the
    lattice that are too large for such numbers are looked up first.
    """

    def __init__(self, lower: Integers, size: Integers, branching: int) -> None:
        self._n, self._dim = branching, lower.shape[1]
        self._block = _block_size(lower, size, branching)
        self._ways = _spread(np.arange(self._block, dtype=np.int64), branching, self._dim)
        blocks = lower // self._block
        self._axes = [np.unique(blocks[:, a]) for a in range(self._dim)]
        self._blocks = np.unique(self._block_keys(blocks)[0])
        if math.log2(self._block) * self._dim + math.log2(len(self._blocks)) > _KEY_BITS:
            raise ValueError(f"cells in {len(self._blocks)} blocks: too far apart to be drawn together")
        keys = self.keys(lower)
        self.order = np.argsort(keys, kind="stable")
        self.first = keys[self.order]
        self.last = self.first + size[self.order] ** self._dim

    def _block_keys(self, blocks: Integers) -> tuple[Integers, Booleans]:
        """A number for each block on the axes' coordinates, and whether all of its own are among them."""
        key = np.zeros(len(blocks), dtype=np.int64)
        known = np.ones(len(blocks), dtype=np.bool_)
        for a, there in enumerate(self._axes):
            rank = np.minimum(np.searchsorted(there, blocks[:, a]), len(there) - 1)
            known &= there[rank] == blocks[:, a]
            key = key * len(there) + rank
        return key, known

    def keys(self, points: Integers) -> Integers:
        """Place of each point in the depth-first order; -1 where no cell is in its block."""
        blocks = points // self._block
        number, known = self._block_keys(blocks)
        rank = np.minimum(np.searchsorted(self._blocks, number), len(self._blocks) - 1)
        known &= self._blocks[rank] == number
        within = points - blocks * self._block
        key = rank * self._block**self._dim
        for a in range(self._dim):
            key += self._ways[within[:, a]] * self._n**a
        return np.where(known, key, -1)

    def find(self, points: Integers) -> Integers:
        """Number of the cell that contains each point; -1 where there is none."""
        keys = self.keys(points)
        at = np.searchsorted(self.first, keys, side="right") - 1
        found = (at >= 0) & (keys >= 0) & (keys < self.last[at])
        return np.where(found, self.order[at], -1)

    def any_in(self, lower: Integers, size: Integers) -> Booleans:
        """Whether a cell of the tree, of at most a block's size, has one of these cells begin in it."""
        keys = self.keys(lower)
        begin = np.searchsorted(self.first, keys)
        end = np.searchsorted(self.first, keys + size**self._dim)
        return (keys >= 0) & (end > begin)


def _block_size(lower: Integers, size: Integers, n: int) -> int:
    """Edge of the largest cell, or of a larger one of which few hold all cells."""
    span = int(np.max(lower + size[:, None] - lower.min(axis=0)))
    block = int(size.max())
    if block > _MAX_BLOCK:
        raise ValueError(f"cells of 1 to {block} units: too different in size to be drawn together")
    while block < span and block * n <= _MAX_BLOCK // 16:
        block *= n
    return block


def _spread(places: Integers, n: int, dim: int) -> Integers:
    """Digits in base n, each moved up to leave room for those of `dim` - 1 other axes."""
    total = np.zeros_like(places)
    weight = 1
    while np.any(places):
        total += places % n * weight
        places = places // n
        weight *= n**dim
    return total


def neighbours(cells: Cells, axis: int, side: int) -> Integers:
    """Lower corners of equally large cells beyond one face: side 0 is the lower, 1 the upper."""
    moved = cells.lower.copy()
    moved[:, axis] += (1 if side else -1) * cells.size
    return moved


def covered_faces(cells: Cells) -> Booleans:
    """Which faces lie wholly on other cells of the set: (n, dim, 2), the lower and the upper of each axis."""
    n, dim = cells.lower.shape
    covered = np.zeros((n, dim, 2), dtype=np.int64)
    if not n:
        return covered.astype(np.bool_)
    index = CellIndex(cells.lower, cells.size, cells.branching)
    area = cells.size ** (dim - 1)
    for axis in range(dim):
        for side in (0, 1):
            found = index.find(neighbours(cells, axis, side))
            known = np.flatnonzero(found >= 0)
            other = found[known]
            whole = cells.size[other] >= cells.size[known]
            covered[known[whole], axis, side] = area[known[whole]]
            larger = cells.size[other] > cells.size[known]
            np.add.at(covered[:, axis, 1 - side], other[larger], area[known[larger]])
    return covered >= area[:, None, None]


def hidden(cells: Cells) -> Booleans:
    """Which cells have all faces on other cells of the set: nobody sees them from outside."""
    return covered_faces(cells).all(axis=(1, 2))


def frontier(cells: Cells) -> Cells:
    """Unknown space beside free cells, in cells no larger than those: where a map could grow.

    The result has no evidence: probability 0.5, state -1.
    """
    known = cells.where(cells.known)
    free = cells.where(cells.free)
    if not len(free):
        return free
    index = CellIndex(known.lower, known.size, cells.branching)
    lowers, sizes = [], []
    unknown = cells.where(~cells.known & (cells.size < known.size.max()))
    touches = np.zeros(len(unknown), dtype=np.bool_)
    for axis in range(cells.dim):
        for side in (0, 1):
            at = neighbours(free, axis, side)
            open_ = (index.find(at) < 0) & ~index.any_in(at, free.size)
            lowers.append(at[open_])
            sizes.append(free.size[open_])
            found = index.find(neighbours(unknown, axis, side))
            met = found >= 0
            touches[met] |= known.free[found[met]] & (known.size[found[met]] > unknown.size[met])
    lower = np.concatenate([*lowers, unknown.lower[touches]])
    size = np.concatenate([*sizes, unknown.size[touches]])
    order = np.lexsort([size, *lower.T])
    lower, size = lower[order], size[order]
    new = np.ones(len(size), dtype=np.bool_)
    new[1:] = np.any(lower[1:] != lower[:-1], axis=1) | (size[1:] != size[:-1])
    lower, size = lower[new], size[new]
    n = len(size)
    return Cells(
        cells.unit,
        cells.branching,
        lower,
        size,
        np.full(n, 0.5),
        np.zeros(n, dtype=np.bool_),
        np.full(n, -1, dtype=np.int8),
        np.zeros(n, dtype=np.int64),
        np.zeros(n, dtype=np.int64),
    )


# --- Coarser views --------------------------------------------------------------------------------


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
