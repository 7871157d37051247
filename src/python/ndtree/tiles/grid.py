# SPDX-License-Identifier: BSD-3-Clause
"""Space divided into tiles: cubes of a power of N of the coarsest cells, counted from the map's origin; and
of which maps they are.
"""

from __future__ import annotations

import itertools
import math
import struct
import zlib
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ndtree._errors import WrongValue
from ndtree._native import _core
from ndtree._native._core import OccupancyMap
from ndtree.base.scan import Scan
from ndtree.base.voxels import distinct

_PREAMBLE = struct.Struct("<8sIQ")  # Magic, version, length; see io/map_file.hpp.


@dataclass(frozen=True)
class MapKind:
    """What all tiles have in common: enough to make an empty map.

    `options`: All that the refinement reads; of tiles that an older version made, constants of the method,
        too.
    """

    dim: int
    branching: int
    refinement: str
    options: dict[str, float] = field(hash=False)

    @classmethod
    def of(cls, m: OccupancyMap) -> MapKind:
        """That of a map.

        Raises ValueError for an OctoMap, and a map with layers: neither has tiles.
        """
        if m.refinement == "octomap":
            raise ValueError("an OctoMap has no tiles: must be a map of ndtree's own")
        if m.layers:
            raise ValueError(f"layers: {', '.join(m.layers)}: must be none, as tiles hold occupancy alone")
        return cls(m.dim, m.branching, m.refinement, dict(m.options))

    def new(self) -> OccupancyMap:
        """An empty map."""
        known = _core.default_options()
        options = {name: value for name, value in self.options.items() if name in known}
        constants = {name: value for name, value in self.options.items() if name not in known}
        make: Any = _core.FixedMap if self.refinement == "fixed" else _core.AdaptiveMap
        return make(  # type: ignore[no-any-return]
            dim=self.dim, branching=self.branching, refinement=self.refinement, constants=constants, **options
        )

    def is_worth_storing(self, m: OccupancyMap) -> bool:
        """Whether a map of this kind knows anything, parts of cells included."""
        return m.stats().nodes > 1 or m != self.new()


def with_counters(map_file: bytes, updates: int, splits: int, merges: int, scans: int) -> bytes:
    """A map file with other numbers of updates, splits, merges and scans; its cells stay as they are."""
    at = _PREAMBLE.size + 8
    at += 2 + struct.unpack_from("<H", map_file, at)[0]
    options, at = struct.unpack_from("<I", map_file, at)[0], at + 4
    for _ in range(options):
        at += 2 + struct.unpack_from("<H", map_file, at)[0] + 8
    counted = map_file[:at] + struct.pack("<4Q", updates, splits, merges, scans) + map_file[at + 32 : -4]
    return counted + struct.pack("<I", zlib.crc32(counted))


#: Place of a tile on the grid: it covers [place * size, (place + 1) * size) on each axis.
Tile = tuple[int, ...]
Floats = NDArray[np.float64]

#: A tile has at least this many of the coarsest cells along an edge, unless its size is given.
CUBES = 16
_STEP = 0.25  # Of a tile: how far apart beams are looked at.
_GRAIN = 0.125  # Of a tile: ends that are nearer than this are taken as one.


@dataclass(frozen=True)
class TileGrid:
    """Where tiles are.

    `unit`: Edge of the smallest cell [m].
    `cube`: Edge of the coarsest cells that are updated, in smallest cells.
    `cubes`: Edge of a tile, in coarsest cells: a power of the map's branching.
    """

    dim: int
    unit: float
    cube: int
    cubes: int

    @classmethod
    def of(cls, m: OccupancyMap, tile_size: float | None = None) -> TileGrid:
        """The grid for maps of this kind, with the smallest tiles that are at least so large.

        `m`: Any with the options that all tiles will have.
        `tile_size`: [m]; left out, that of 16 coarsest cells, or of more where the branching has no such
            power.
        Raises ValueError if the size is not > 0 and finite, or too large.
        """
        unit = float(m.options["min_cell_size"])
        empty = MapKind.of(m).new()
        edge = float(empty.cell_size(np.zeros(m.dim)))
        cube = round(edge / unit)
        least = CUBES * edge if tile_size is None else float(tile_size)
        if not (least > 0 and math.isfinite(least)):
            raise WrongValue.of("tile_size", f"{tile_size} m", "> 0 and finite")
        cubes = 1
        while cubes * edge < least * (1 - 1e-9):
            cubes *= m.branching
        if cubes * cube > 1 << 36:
            raise WrongValue.of("tile_size", f"{least:g} m", f"at most 2^36 cells of {unit:g} m")
        return cls(m.dim, unit, cube, cubes)

    @property
    def size(self) -> float:
        """Edge of a tile [m]."""
        return self.cubes * self.cube * self.unit

    def box(self, tile: Tile) -> Floats:
        """(2, dim) float64: corners [m], the very doubles at which cells begin and end."""
        edge = self.cubes * self.cube
        return (
            np.array([[place * edge for place in tile], [(place + 1) * edge for place in tile]]) * self.unit
        )

    def tiles_at(self, points: ArrayLike) -> NDArray[np.int64]:
        """(n, dim) int64: the tiles that contain points (n, dim), which must be finite."""
        points = np.asarray(points, dtype=np.float64)
        places = np.floor(points / self.size).astype(np.int64)
        edge = self.cubes * self.cube
        places -= places * edge * self.unit > points  # The quotient may round to the wrong side of a border.
        places += (places + 1) * edge * self.unit <= points
        return places

    def tiles_in(self, lower: ArrayLike, upper: ArrayLike) -> set[Tile]:
        """All tiles that share a point with a closed box."""
        lower, upper = np.asarray(lower, dtype=np.float64), np.asarray(upper, dtype=np.float64)
        first = self.tiles_at(lower)
        first -= self.box(tuple(first.tolist()))[0] == lower  # The neighbour ends where the box begins.
        return set(itertools.product(*(range(a, b + 1) for a, b in zip(first, self.tiles_at(upper)))))

    def nearby(self, tiles: Iterable[Tile], lower: ArrayLike, upper: ArrayLike) -> set[Tile]:
        """Those of some tiles that share a point with a closed box."""
        lower, upper = np.asarray(lower, dtype=np.float64), np.asarray(upper, dtype=np.float64)
        found = set()
        for tile in tiles:
            box = self.box(tile)
            if (box[0] <= upper).all() and (box[1] >= lower).all():
                found.add(tile)
        return found

    def crossed_by(self, starts: Floats, ends: Floats) -> set[Tile]:
        """The tiles that segments cross: (n, dim) ends; starts alike, or (dim,) if all have the same."""
        return set(self.shares_by(starts, ends))

    def shares_by(self, starts: Floats, ends: Floats) -> dict[Tile, int]:
        """What `crossed_by` returns, and how many of the points in each that beams were looked at in.

        Beams that end near each other are one here: the number is a measure of the space that was seen.
        """
        if len(ends) == 0:
            return {}
        grain = _GRAIN * self.size
        if starts.ndim == 1:
            ends = _thinned(ends, grain)
            starts = np.broadcast_to(starts, ends.shape)
        else:
            both = _thinned(np.hstack((starts, ends)), grain)
            starts, ends = both[:, : self.dim], both[:, self.dim :]
        way = ends - starts
        length = np.linalg.norm(way, axis=1)
        counts = np.ceil(length / (_STEP * self.size)).astype(np.int64) + 1
        which = np.repeat(np.arange(len(counts)), counts)
        number = np.arange(len(which)) - np.repeat(np.cumsum(counts) - counts, counts)
        share = number / np.maximum(counts - 1, 1)[which]
        points = starts[which] + share[:, None] * way[which]
        # Between two points there is at most half a step to one of them, and ends moved by half a grain.
        margin = (0.5 * _STEP + 0.5 * _GRAIN) * self.size * (1 + 1e-6) + self.unit
        corners = np.stack((points - margin, points + margin))
        if 2 * margin >= self.size:  # Tiles of hardly more than a cell: there may be some in between.
            boxes, counts = np.unique(corners, axis=1, return_counts=True)
            return _added(
                (self.tiles_in(a, b), count) for (a, b), count in zip(boxes.swapaxes(0, 1), counts.tolist())
            )
        first, last = np.floor(corners / self.size).astype(np.int64)
        rows, counts = distinct(
            2 * first + (last > first), return_counts=True
        )  # Two tiles on an axis, or one.
        return _added(
            (set(itertools.product(*((at >> 1, (at >> 1) + (at & 1)) for at in row))), count)
            for row, count in zip(rows.tolist(), counts.tolist())
        )


def beams_of(scan: Scan, options: dict[str, float], max_range: float) -> tuple[Floats, Floats]:
    """Where the beams of a scan start, and up to where at most they say anything; without invalid ones."""
    scan.require_sensor("maps in tiles")
    origin = np.asarray(scan.origin, dtype=np.float64)
    endpoints = np.asarray(scan.endpoints, dtype=np.float64)
    way = endpoints - origin
    with np.errstate(all="ignore"):
        length = np.sqrt(np.einsum("ij,ij->i", way, way))
        good = np.isfinite(length) & (length > 0)
        used = np.minimum(length, max_range)
        sigma = scan.range_sigma
        if sigma is None:
            sigma = options.get("range_sigma", 0.0) + options.get("range_sigma_quadratic", 0.0) * used**2
        sigma = np.maximum(sigma, options["min_cell_size"] / _core.thinnest_surface)
        reach = used + _core.reach_sigmas * sigma + options["min_cell_size"]
        good &= np.isfinite(reach)
        way *= (reach / length)[:, None]
        way += origin
    if good.all():
        return origin, way
    return (origin if origin.ndim == 1 else origin[good]), way[good]


def reach_of(starts: Floats, ends: Floats) -> tuple[Floats, Floats] | None:
    """A box around segments; None if there are none."""
    if len(ends) == 0:
        return None
    first = _bounds(starts) if starts.ndim > 1 else (starts, starts)
    last = _bounds(ends)
    return np.minimum(first[0], last[0]), np.maximum(first[1], last[1])


def nowhere(m: OccupancyMap) -> Floats:
    """(2, dim) float64: where no beam gets: a scan inserted into this box alone makes the root grow."""
    edge = float(m.options["min_cell_size"])
    return np.array([[0.9 * 2**38 * edge] * m.dim, [(0.9 * 2**38 + 1024) * edge] * m.dim])


def _thinned(points: Floats, grain: float) -> Floats:
    """Centres of the cells of a grid that hold points."""
    return (distinct(np.floor(points / grain).astype(np.int64)) + 0.5) * grain


def _bounds(rows: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Smallest and largest of each column: much faster one by one, as rows are short."""
    columns = [rows[:, axis] for axis in range(rows.shape[1])]
    return np.array([one.min() for one in columns]), np.array([one.max() for one in columns])


def _added(crossed: Iterable[tuple[set[Tile], int]]) -> dict[Tile, int]:
    """Sums of counts, for each tile."""
    found: dict[Tile, int] = {}
    for tiles, count in crossed:
        for tile in tiles:
            found[tile] = found.get(tile, 0) + count
    return found
