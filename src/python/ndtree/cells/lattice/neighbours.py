# SPDX-License-Identifier: BSD-3-Clause
"""What lies beside cells: other cells, covered faces, unknown space by free space."""

from __future__ import annotations

import math

import numpy as np

from ndtree.cells.lattice.cells import Booleans, Cells, Integers

_MAX_BLOCK = 1 << 20
_KEY_BITS = 62


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
    """Which cells have all faces on other cells of the set: they cannot be seen from outside."""
    return covered_faces(cells).all(axis=(1, 2))


def _inside_others(lower: Integers, size: Integers) -> Booleans:
    """Which cells of the lattice, all different, lie in a larger one of them."""
    inside = np.zeros(len(size), dtype=np.bool_)
    for larger in np.unique(size)[1:]:
        of_size = np.ascontiguousarray(lower[size == larger])
        smaller = np.flatnonzero(size < larger)
        around = np.ascontiguousarray(lower[smaller] // larger * larger)
        row = np.dtype((np.void, around.dtype.itemsize * around.shape[1]))
        inside[smaller] |= np.isin(around.view(row).ravel(), of_size.view(row).ravel())
    return inside


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
    outermost = ~_inside_others(lower, size)
    lower, size = lower[outermost], size[outermost]
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
