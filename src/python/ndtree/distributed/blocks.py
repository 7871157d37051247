# SPDX-License-Identifier: BSD-3-Clause
"""Space divided into boxes of tiles with equally much in each: what one worker maps by itself."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndtree.tiles.grid import Tile, TileGrid

#: No tile is farther from the first: farther than any map gets.
FAR = 1 << 40
_UNEVEN = 0.1  # A cut across the longest axis is preferred, unless it misses the middle by more than this.


@dataclass(frozen=True)
class Block:
    """A box of tiles: those with lower <= place < upper on every axis."""

    lower: Tile
    upper: Tile

    @classmethod
    def everywhere(cls, dim: int) -> Block:
        """All tiles."""
        return cls((-FAR,) * dim, (FAR,) * dim)

    def __contains__(self, tile: Tile) -> bool:
        return all(a <= at < b for a, at, b in zip(self.lower, tile, self.upper))

    def window(self, grid: TileGrid) -> NDArray[np.float64]:
        """(2, dim) float64: its corners [m], as of insert(window=)."""
        return np.array([grid.box(self.lower)[0], grid.box(self.upper)[0]])

    def cut(self, axis: int, place: int) -> tuple[Block, Block]:
        """What lies before a place on an axis, and the rest."""
        upper, lower = list(self.upper), list(self.lower)
        upper[axis] = lower[axis] = place
        return Block(self.lower, tuple(upper)), Block(tuple(lower), self.upper)

    def as_json(self) -> list[list[int]]:
        """Plain numbers."""
        return [list(self.lower), list(self.upper)]

    @classmethod
    def from_json(cls, held: Any) -> Block:
        """Read what `as_json` made."""
        lower, upper = (tuple(int(at) for at in corner) for corner in held)
        return cls(lower, upper)


def divided(block: Block, weights: Mapping[Tile, float], parts: int) -> list[Block]:
    """A block as some smaller ones that fill it, of about the same weight each.

    `weights`: Of its tiles; others have none. A tile is not divided.
    `parts`: How many; fewer if there are fewer tiles.
    """
    if parts <= 1 or len(weights) <= 1:
        return [block]
    tiles, weight = np.array(list(weights)), np.array(list(weights.values()), dtype=np.float64)
    before = parts // 2
    best: tuple[float, float, int, int] | None = None
    for axis in range(tiles.shape[1]):
        places, which = np.unique(tiles[:, axis], return_inverse=True)
        if len(places) == 1:
            continue
        sums = np.bincount(which.ravel(), weight)
        miss = np.abs(np.cumsum(sums)[:-1] / sums.sum() - before / parts)
        at = int(np.argmin(miss))
        mean = np.average(places, weights=sums)
        spread = float(np.average((places - mean) ** 2, weights=sums))
        found = (max(0.0, float(miss[at]) - _UNEVEN), -spread, axis, int(places[at + 1]))
        best = found if best is None else min(best, found)
    if best is None:
        return [block]
    first, second = block.cut(*best[2:])
    return [
        small
        for half, count in ((first, before), (second, parts - before))
        for small in divided(half, {tile: w for tile, w in weights.items() if tile in half}, count)
    ]
