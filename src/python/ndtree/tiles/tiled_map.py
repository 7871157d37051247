# SPDX-License-Identifier: BSD-3-Clause
"""A map in tiles, asked as one that is in memory: tiles are read as answers need them."""

from __future__ import annotations

import functools
import inspect
import math
import operator
import os
import threading
from collections.abc import Callable, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ndtree._native._arguments import TAKEN, flattened, refuse_masked, shaped
from ndtree._native._checked import checked
from ndtree._native._core import DistanceField, OccupancyMap, Shape
from ndtree._native.results import Frontier, Leaves, NearestOccupied, RayEnds
from ndtree.base.voxels import distinct
from ndtree.tiles.grid import Floats, Tile, TileGrid
from ndtree.tiles.manifest import Manifest, open_manifest, read_map
from ndtree.tiles.resident import Resident
from ndtree.tiles.storage import Storage, storage_of

#: Memory that tiles take, unless it is given.
CACHE_BYTES = 1 << 30


def _asks(method: Callable[..., Any]) -> Callable[..., Any]:
    """A query that says of wrong arguments what the whole map would."""

    @functools.wraps(method)
    def call(self: TiledMap, *arguments: Any, **keywords: Any) -> Any:
        try:
            return method(self, *arguments, **keywords)
        except (TypeError, ValueError, LookupError, ArithmeticError):
            with self._lock:
                getattr(self._frame, method.__name__)(*arguments, **keywords)  # Which has no cells.
            raise

    return call


def _bulk(method: Callable[..., Any]) -> Callable[..., Any]:
    """Takes arrays as the maps' own methods do, and answers in their shape."""
    axes = TAKEN[method.__name__]
    signature = inspect.signature(method)

    @functools.wraps(method)
    def call(self: TiledMap, *arguments: Any, **keywords: Any) -> Any:
        given = dict(signature.bind(self, *arguments, **keywords).arguments)
        del given["self"]
        refuse_masked(method.__name__, given)
        order = [name for name in axes if name in given]
        changed, leading = flattened(
            axes, {**{name: given[name] for name in order}, **given}, lambda: self.dim
        )
        with self._lock:
            result = method(self, **{**given, **changed})
        return result if leading is None else shaped(result, leading)

    return _asks(call)


def _told(path: str, doc: str) -> Any:
    """A property that a part of the object has."""
    return property(operator.attrgetter(path), doc=doc)


@checked
class TiledMap:
    """A map whose tiles lie in a folder; it answers as the whole one would, see `OccupancyMap`.

    What one answer needs is in memory together. Beyond that, the tiles that were asked for last stay there,
    as far as `cache_bytes` goes. Threads may share it, and wait for each other.

    Parameters
    ----------
    cache_bytes : int
        Memory of tiles that are kept.

    Attributes
    ----------
    manifest : Manifest
        Which tiles there are.
    """

    url: str = _told("_storage.url", "Where it is, as it was given.")
    dim: int = _told("manifest.kind.dim", "Dimension of space.")
    branching: int = _told("manifest.kind.branching", "Children of a node along each axis.")
    refinement: str = _told("manifest.kind.refinement", "Name of the rule that decides on cell sizes.")
    min_cell_size: float = _told("_frame.min_cell_size", "Edge of the smallest cells [m].")
    max_cell_size: float = _told("_frame.max_cell_size", "Edge of the largest cells that are updated [m].")
    grid: TileGrid = _told("manifest.grid", "Where tiles are.")
    loads: int = _told("_resident.loads", "How many tiles were read so far.")
    hits: int = _told("_resident.hits", "How many times a tile was in memory already.")
    resident_bytes: int = _told("_resident.bytes", "Memory that tiles take now.")

    def __init__(self, storage: Storage, manifest: Manifest, cache_bytes: int = CACHE_BYTES) -> None:
        if not cache_bytes >= 0:  # nan, too.
            raise ValueError(f"cache_bytes = {cache_bytes}: must be >= 0")
        self.manifest = manifest
        self._storage = storage
        self._cache_bytes = cache_bytes
        self._lock = threading.RLock()
        self._frame = read_map(storage, manifest.frame)
        self._resident = Resident(self._frame.snapshot(), manifest.grid, self._load, cache_bytes)

    @property
    def options(self) -> dict[str, float]:
        """The options that the map reads."""
        return dict(self.manifest.kind.options)

    def __repr__(self) -> str:
        kind = self.manifest.kind
        return (
            f"TiledMap({self.url}: dim={kind.dim}, branching={kind.branching}, "
            f"refinement={kind.refinement!r}, {len(self.manifest.tiles)} tiles of {self.grid.size:g} m, "
            f"revision={self.manifest.revision})"
        )

    def bounds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
        """As of `OccupancyMap`; no tile is read."""
        return self.manifest.bounds

    @property
    def observed_leaves(self) -> int:
        """Leaves that at least one beam updated; no tile is read."""
        return sum(entry.observed_leaves for entry in self.manifest.tiles.values())

    def to_map(self) -> OccupancyMap:
        """One map of all tiles: byte for byte the one that would have been made without them.

        Raises
        ------
        MemoryError
            If it would hold more than its max_memory.
        """
        whole = self._frame.snapshot()
        for tile in sorted(self.manifest.tiles):
            loaded = self._load(tile)
            if loaded is not None:
                whole.adopt(loaded, self.grid.box(tile))
        return whole

    def region(self, box: ArrayLike) -> OccupancyMap:
        """A map of the tiles that share a point with a box: all that the whole one knows there.

        Parameters
        ----------
        box : (2, dim) array of float
            Lower and upper corner [m].

        Returns
        -------
        OccupancyMap
            A snapshot: what is done to it changes nothing here.
        """
        self._frame.leaves(box, states=["occupied"])  # Which says what is wrong.
        corners = np.asarray(box, dtype=np.float64)
        with self._lock:
            self._resident.hold(self.grid.nearby(self.manifest.tiles, corners[0], corners[1]))
            return self._resident.map.snapshot()

    @_asks
    def leaves(self, box: ArrayLike | None = None, *, states: Sequence[Any] | None = None) -> Leaves:
        """As of `OccupancyMap`, but for unknown space that is larger than `max_cell_size`.

        How that is divided is kept nowhere; it may be missing here, or come in larger pieces.
        """
        bounds = self.bounds()
        if box is None:
            if bounds is None:
                return self._frame.leaves(states=states)
            return self.region(np.array(bounds)).leaves(states=states)
        return self.region(box).leaves(box, states=states)

    @_asks
    def frontiers(self, box: ArrayLike | None = None, *, min_cells: float = 8.0) -> list[Frontier]:
        """As of `OccupancyMap`."""
        bounds = self.bounds()
        if bounds is None:
            return []
        around = np.array(bounds) if box is None else np.asarray(box, dtype=np.float64)
        return self.region(self._widened(around, self.grid.size)).frontiers(box, min_cells=min_cells)

    @_asks
    def distance_field(
        self, box: ArrayLike, cell_size: float, *, max_distance: float = 2.0, unknown: Any = "free"
    ) -> DistanceField:
        """As of `OccupancyMap`."""
        around = self._widened(np.asarray(box, dtype=np.float64), max_distance + cell_size)
        return self.region(around).distance_field(box, cell_size, max_distance=max_distance, unknown=unknown)

    @_asks
    def to_grid(
        self,
        box: ArrayLike,
        cell_size: float | None = None,
        *,
        values: Any = "state",
        wall_depth: float | None = None,
    ) -> NDArray[Any]:
        """As of `OccupancyMap`."""
        step = self.options["min_cell_size"] if cell_size is None else cell_size
        around = self._widened(np.asarray(box, dtype=np.float64), step)
        return self.region(around).to_grid(box, cell_size, values=values, wall_depth=wall_depth)

    @_bulk
    def probability(
        self, points: ArrayLike, *, of: Any = None, interval: float | None = None
    ) -> NDArray[np.float32] | tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
        """As of `OccupancyMap`."""
        if interval is None:
            return self._at(points, 0.0, lambda m, some: m.probability(some, of=of))
        bounds = self._at(
            points, 0.0, lambda m, some: np.column_stack(m.probability(some, of=of, interval=interval))
        )
        return bounds[:, 0].copy(), bounds[:, 1].copy(), bounds[:, 2].copy()

    @_bulk
    def state(self, points: ArrayLike) -> NDArray[np.int8]:
        """As of `OccupancyMap`."""
        return self._at(points, 0.0, lambda m, some: m.state(some))

    @_bulk
    def occupied_within(self, points: ArrayLike, radius: float) -> NDArray[np.bool_]:
        """As of `OccupancyMap`."""
        return self._at(points, radius, lambda m, some: m.occupied_within(some, radius))

    @_bulk
    def states_in(self, lower: ArrayLike, upper: ArrayLike) -> NDArray[np.bool_]:
        """As of `OccupancyMap`."""
        low, high = np.asarray(lower, dtype=np.float64), np.asarray(upper, dtype=np.float64)

        return self._asked(
            len(low),
            lambda which: self._touching(low[which], high[which]),
            lambda m, which: m.states_in(low[which], high[which]),
            lambda: _order(low),
        )

    @_bulk
    def nearest_occupied(self, points: ArrayLike, *, max_distance: float = math.inf) -> NearestOccupied:
        """As of `OccupancyMap`; of points as near as each other, it may be another one."""
        found = self._frame.nearest_occupied(points, max_distance=max_distance)  # Of the right shape, empty.
        points = np.asarray(points, dtype=np.float64)
        bounds = self.bounds()
        if bounds is None:
            return found
        distance, point = found.distance.copy(), found.point.copy()
        with np.errstate(over="ignore", invalid="ignore"):
            near = np.clip(points, *bounds)
            is_far = np.isinf(np.sum((points - near) ** 2, axis=1))
        if is_far.any() and max_distance == math.inf:  # Then the distance is inf, as maps say.
            point[is_far] = self.nearest_occupied(near[is_far]).point
        left = np.flatnonzero(np.isfinite(points).all(axis=1) & ~is_far)
        gap = np.linalg.norm(points - near, axis=1)  # To where anything is: nothing is nearer.
        radius = 0.25 * self.grid.size
        while left.size:
            radius = min(max(radius, gap[left].min()), max_distance)
            asked = left[gap[left] <= radius]
            one = self._at(points[asked], radius, functools.partial(_nearest, radius=radius))
            distance[asked], point[asked] = one[:, 0], one[:, 1:]
            if radius >= max_distance:
                break
            farthest = np.maximum(np.abs(points[asked] - bounds[0]), np.abs(points[asked] - bounds[1]))
            is_done = (one[:, 0] <= radius) | (np.linalg.norm(farthest, axis=1) <= radius)
            left = np.setdiff1d(left, asked[is_done], assume_unique=True)
            radius *= 2.0
        return NearestOccupied(distance, point)

    @_asks
    def distance_to_occupied(self, points: ArrayLike) -> NDArray[np.float64]:
        """As of `OccupancyMap`."""
        found = self.nearest_occupied(points)
        return np.where(np.isnan(found.point).any(axis=-1), np.nan, found.distance)[()]

    @_bulk
    def cast_rays(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        *,
        max_range: float = math.inf,
        unknown: Literal["pass", "stop"] = "pass",
        at: Literal["surface", "cell"] = "surface",
        details: bool = False,
    ) -> NDArray[np.float64] | RayEnds:
        """As of `OccupancyMap`; in its details, unknown space that ends a ray may be larger."""
        keywords: dict[str, Any] = {"max_range": max_range, "unknown": unknown, "at": at, "details": details}
        self._frame.cast_rays(origins, directions, **keywords)  # Which says what is wrong.
        way = np.asarray(directions, dtype=np.float64)
        start = np.asarray(origins, dtype=np.float64)
        bounds = self.bounds()
        limit = 0.0
        if bounds is not None and way.size:
            far = np.maximum(np.abs(start - bounds[0]), np.abs(start - bounds[1]))
            beyond = float(self.options["min_cell_size"]) if at == "surface" else 0.0
            limit = min(max_range + beyond, float(np.linalg.norm(far, axis=-1).max()))
        heading = way / np.abs(way).max(
            axis=1, keepdims=True
        )  # The length of which neither over- nor underflows.
        ends = start + heading * (limit / np.linalg.norm(heading, axis=1))[:, None]

        def needed(which: Any) -> set[Tile]:
            crossed = self.grid.crossed_by(start if start.ndim == 1 else start[which], ends[which])
            return crossed & self.manifest.tiles.keys()

        def ask(m: OccupancyMap, which: Any) -> Any:
            return m.cast_rays(start if start.ndim == 1 else start[which], way[which], **keywords)

        return self._asked(len(way), needed, ask, lambda: self._order_of_rays(start, ends))

    @_asks
    def collides(self, shape: Shape, poses: ArrayLike, *, unknown: Any = "free") -> NDArray[np.bool_]:
        """As of `OccupancyMap`."""
        return self._about(poses, shape).collides(shape, poses, unknown=unknown)

    @_asks
    def path_collides(self, shape: Shape, poses: ArrayLike, *, unknown: Any = "free") -> int:
        """As of `OccupancyMap`."""
        return self._about(poses, shape).path_collides(shape, poses, unknown=unknown)

    def _about(self, poses: ArrayLike, shape: Shape) -> OccupancyMap:
        """Tiles that a body may touch in some poses."""
        array = np.asarray(poses, dtype=np.float64)
        flat = array.shape[-1:] in ((self.dim,), (7,) if self.dim == 3 else (3,)) and array.ndim < 3
        places = array[..., : self.dim] if flat else array[..., : self.dim, -1]
        places = places.reshape(-1, places.shape[-1] if places.ndim else 1)
        if places.shape[1] != self.dim or not np.isfinite(places).all() or not len(places):
            return self._frame  # Which says what is wrong.
        box = np.stack((places.min(axis=0), places.max(axis=0)))
        return self.region(self._widened(box, shape.reach + self.grid.unit))

    def _load(self, tile: Tile) -> OccupancyMap | None:
        entry = self.manifest.tiles.get(tile)
        return None if entry is None else read_map(self._storage, entry)

    @staticmethod
    def _widened(box: Floats, margin: float) -> Floats:
        return box + np.array([[-margin], [margin]]) if box.shape[:1] == (2,) else box

    def _touching(self, lower: Floats, upper: Floats) -> set[Tile]:
        """Tiles with something in them that share a point with one of some boxes."""
        good = ~(np.isnan(lower).any(axis=1) | np.isnan(upper).any(axis=1))
        lower, upper = lower[good], upper[good]
        if not len(lower) or not self.manifest.tiles:
            return set()
        tiles = np.array(list(self.manifest.tiles))
        first, last = (tiles.min(axis=0) - 1) * self.grid.size, (tiles.max(axis=0) + 2) * self.grid.size
        lower, upper = np.clip(lower, first, last), np.clip(upper, first, last)  # Finite, too.
        near = self.grid.nearby(self.manifest.tiles, lower.min(axis=0), upper.max(axis=0))
        if len(near) < 2:
            return near
        # Most boxes lie in one tile, and well away from its borders, which is told at once.
        begin = np.ceil(lower / self.grid.size - 1e-6).astype(np.int64) - 1
        end = np.floor(upper / self.grid.size + 1e-6).astype(np.int64)
        one = (begin == end).all(axis=1)
        kept = set(map(tuple, distinct(begin[one]).tolist())) & near if one.any() else set()
        lower, upper = lower[~one], upper[~one]
        for tile in near - kept:
            corners = self.grid.box(tile)
            if ((upper >= corners[0]) & (lower <= corners[1])).all(axis=1).any():
                kept.add(tile)
        return kept

    def _at(
        self, points: ArrayLike, radius: float, ask: Callable[[OccupancyMap, NDArray[np.float64]], Any]
    ) -> Any:
        """What each of some points is told, for which what is within a radius is all that counts."""
        array = np.asarray(points)
        if array.ndim != 2 or array.shape[1] != self.dim or array.dtype.kind not in "fiu":
            return ask(self._frame, points)  # type: ignore[arg-type]  # Which says what is wrong.
        array = array.astype(np.float64, copy=False)
        return self._asked(
            len(array),
            lambda which: self._touching(array[which] - radius, array[which] + radius),
            lambda m, which: ask(m, array[which]),
            lambda: _order(array),
        )

    def _asked(
        self,
        count: int,
        needed: Callable[[Any], set[Tile]],
        ask: Callable[[OccupancyMap, Any], Any],
        order: Callable[[], NDArray[np.int64]],
    ) -> Any:
        """Answers to many questions, in batches whose tiles fit into memory.

        `needed`, `ask`: Which tiles the questions with some numbers need, and what a map says to them.
        `order`: Returns (count,) int: the numbers, those beside each other that need the same tiles.
        """
        answers: list[Any] = []

        def answer(which: Any, size: int) -> bool:
            tiles = needed(which)
            of_tiles = sum(self.manifest.tiles[tile].bytes for tile in tiles)
            if of_tiles > self._cache_bytes and size > 1:
                return False
            self._resident.hold(tiles)
            answers.append(ask(self._resident.map, which))
            return True

        def halve(which: NDArray[np.int64]) -> None:
            middle = len(which) // 2
            for half in (which[:middle], which[middle:]):
                if not answer(half, len(half)):
                    halve(half)

        if not count:
            return ask(self._frame, np.arange(0))
        if answer(slice(None), count):
            return answers[0]
        numbers = order()
        halve(numbers)
        back = np.argsort(numbers)
        if isinstance(answers[0], RayEnds):
            parts = {
                name: np.concatenate([getattr(one, name) for one in answers])[back]
                for name in ("distance", "state", "lower", "size")
            }
            return RayEnds(**parts)
        return np.concatenate(answers)[back]

    def _order_of_rays(self, start: Floats, ends: Floats) -> NDArray[np.int64]:
        """Rays from one tile together, those to the same one first."""
        size = self.grid.size
        begin = np.broadcast_to(np.floor(start / size), ends.shape)
        return np.lexsort([*ends.T[::-1], *np.floor(ends / size).T[::-1], *begin.T[::-1]])


def _nearest(m: OccupancyMap, points: NDArray[np.float64], radius: float) -> NDArray[np.float64]:
    found = m.nearest_occupied(points, max_distance=radius)
    return np.column_stack((found.distance, found.point))


def _order(points: NDArray[np.float64]) -> NDArray[np.int64]:
    """Numbers of points, by their place."""
    return np.lexsort(points.T[::-1])


@checked
def open_tiles(url: str | os.PathLike[str], *, cache_bytes: int = CACHE_BYTES) -> TiledMap:
    """Open a map in tiles.

    Parameters
    ----------
    url : str or path
        A folder, or what fsspec (extra ``fleet``) knows: s3://, gs://, memory:// and others.
    cache_bytes : int
        Memory of tiles that are kept; one answer may need more.

    Raises
    ------
    OSError
        If there is none, or it cannot be read.
    ValueError
        If it is damaged; the file is named.
    """
    storage = storage_of(url)
    return TiledMap(storage, open_manifest(storage), cache_bytes)
