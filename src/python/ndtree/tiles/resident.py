# SPDX-License-Identifier: BSD-3-Clause
"""The part of a tiled map that is in memory: one map, into which tiles come and from which they go."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from ndtree._native._core import OccupancyMap
from ndtree.base.scan import Scan
from ndtree.tiles.grid import Tile, TileGrid, nowhere


class Resident:
    """A map that holds some tiles of a larger one, each of them whole.

    `m`: The frame: no cells, and the root of the whole map.
    `load`: The map of a tile; None if nothing was ever seen there.
    `limit`: Of the tiles' bytes in memory: beyond it those go that were not asked for longest, but for the
        ones that are being asked for.
    Attributes:
    `map`: What is in memory. What is not is unknown to it.
    `loads`, `hits`: How often a tile was read, and how often it was there already.
    """

    def __init__(
        self,
        m: OccupancyMap,
        grid: TileGrid,
        load: Callable[[Tile], OccupancyMap | None],
        limit: float = math.inf,
    ) -> None:
        self.map = m
        self.loads = self.hits = 0
        self._grid = grid
        self._load = load
        self._limit = limit
        self._held: OrderedDict[Tile, int] = OrderedDict()  # With what they take in memory.
        self._bytes = 0

    def __contains__(self, tile: Tile) -> bool:
        return tile in self._held

    @property
    def tiles(self) -> list[Tile]:
        """Tiles in memory; those that were not asked for longest come first."""
        return list(self._held)

    @property
    def bytes(self) -> int:
        """Memory of the tiles that were read."""
        return self._bytes

    def hold(self, tiles: Iterable[Tile]) -> None:
        """Have these tiles in memory."""
        needed = set(tiles)
        missing = []
        for tile in sorted(needed):
            if tile in self._held:
                self._held.move_to_end(tile)
                self.hits += 1
            else:
                missing.append(tile)
        for tile in missing:
            loaded = self._load(tile)
            size = 0
            if loaded is not None:
                size = loaded.stats().memory_bytes
                self._make_room(size, needed)
                self.map.adopt(loaded, self._grid.box(tile))
                self.loads += 1
            self._held[tile] = size
            self._bytes += size

    def _make_room(self, size: int, spared: set[Tile]) -> None:
        oldest = iter([tile for tile in self._held if tile not in spared])
        while self._bytes + size > self._limit:
            tile = next(oldest, None)
            if tile is None:
                return
            self.let_go([tile])

    def cut_out(self, tile: Tile, into: OccupancyMap) -> OccupancyMap:
        """A tile's cells, taken over by an empty map, which is returned."""
        into.adopt(self.map, self._grid.box(tile))
        return into

    def let_go(self, tiles: Iterable[Tile]) -> None:
        """Forget tiles."""
        for tile in tiles:
            if tile in self._held:
                self._bytes -= self._held.pop(tile)
                self.map.clear(self._grid.box(tile))


Floats = NDArray[np.float64]


class Growth:
    """Where the root of a map is depends on all scans in their order, and on nothing else.

    `frame`: With the root so far, and no cell; it grows.
    """

    def __init__(self, frame: OccupancyMap) -> None:
        self.map = frame
        self._look()

    def contains(self, box: tuple[Floats, Floats] | None) -> bool:
        """Whether a scan that stays in a box leaves the root as it is."""
        return box is None or bool((box[0] >= self._lower).all() and (box[1] < self._upper).all())

    def include(self, scan: Scan, max_range: float) -> None:
        """Grow as a map does that takes the scan in."""
        scan.insert_into(self.map, max_range=max_range, window=nowhere(self.map))
        self._look()

    def _look(self) -> None:
        leaves = self.map.leaves()
        self._lower = leaves.lower.min(axis=0)
        self._upper = (leaves.lower + leaves.size[:, None]).max(axis=0)
