# SPDX-License-Identifier: BSD-3-Clause
"""Blocks of cells in which each of two maps has one state."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ndtree._errors import WrongValue, key
from ndtree.maps.open import PlacedMap

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
STATES = ("unknown", "free", "occupied")
_BLOCKS_AT_ONCE = 1 << 15
#: Parts of the finer map's cells along an axis: smaller ones say nothing more, and take for ever.
_FINEST = 64
_TOO_LARGE = 1 << 40  # Cells along an axis: more have no exact numbers.


def common_grid(a: PlacedMap, b: PlacedMap, cell_size: float | None) -> _Grid:
    """Cells that begin where those of the finer map do."""
    finer = a if a.cell_size <= b.cell_size else b
    least = finer.cell_size / _FINEST
    if cell_size is not None and not cell_size >= least:
        expected = f">= {least:g} m, a {_FINEST}th of the finer map's cells"
        raise WrongValue.of("cell_size", f"{cell_size:g} m", expected)
    return _Grid(finer.offset, finer.cell_size if cell_size is None else cell_size)


class _Grid:
    """Cells of one size: number i on an axis is [origin + i * cell_size, origin + (i + 1) * cell_size)."""

    def __init__(self, origin: Floats, cell_size: float) -> None:
        self.origin = origin
        self.cell_size = cell_size

    def centres(self, cells: Integers) -> Floats:
        return self.origin + (cells + 0.5) * self.cell_size

    def around(self, *maps: PlacedMap) -> tuple[Integers, Integers] | None:
        """First and last numbers, (dim,) each, of the cells that any of the maps has observed."""
        lows, highs = [], []
        for one in maps:
            leaves = one.map.leaves()
            known = leaves.state >= 0
            if known.any():
                lower = leaves.lower[known] + one.offset
                lows.append(lower.min(axis=0))
                highs.append((lower + leaves.size[known, None]).max(axis=0))
        if not lows:
            return None
        low = np.floor((np.min(lows, axis=0) - self.origin) / self.cell_size)
        high = np.ceil((np.max(highs, axis=0) - self.origin) / self.cell_size)
        if np.abs([low, high]).max() > _TOO_LARGE:
            raise WrongValue(
                f"{key('cell_size')} = {self.cell_size} m: too small for maps that lie so far from 0"
            )
        return low.astype(np.int64), high.astype(np.int64) - 1

    def blocks(self, a: PlacedMap, b: PlacedMap) -> Iterator[tuple[Integers, int, Integers]]:
        """Blocks of cells in which each map has one state: all cells that one of them knows, each once.

        Yields lower cells (n, dim), the edge in cells, and states (n, 2), 0 to 2 for `STATES`.
        """
        bounds = self.around(a, b)
        if bounds is None:
            return
        first, last = bounds
        dim = len(first)
        edge = 1 << max(0, int(np.max(last - first)).bit_length())
        ways = np.stack(np.meshgrid(*[[0, 1]] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
        waiting = [(first[None, :], edge)]
        while waiting:
            lower, edge = waiting.pop()
            states = np.column_stack([self._states(one, lower, edge) for one in (a, b)])
            done = (states >= 0).all(axis=1)
            some = done & (states > 0).any(axis=1)
            if some.any():
                yield lower[some], edge, states[some]
            open_ = lower[~done]
            half = edge // 2
            for begin in range(0, len(open_), _BLOCKS_AT_ONCE):
                part = open_[begin : begin + _BLOCKS_AT_ONCE]
                waiting.append(((part[:, None, :] + ways * half).reshape(-1, dim), half))

    def _states(self, one: PlacedMap, lower: Integers, edge: int) -> Integers:
        """State of each block, 0 to 2, or -1 where it has more than one."""
        if edge == 1:
            return one.state(self.centres(lower)).astype(np.int64) + 1
        found = one.map.states_in(
            self.centres(lower) - one.offset, self.centres(lower + (edge - 1)) - one.offset
        )
        return np.where(found.sum(axis=1) == 1, found.argmax(axis=1), -1)
