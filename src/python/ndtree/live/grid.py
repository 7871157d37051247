# SPDX-License-Identifier: BSD-3-Clause
"""A grid in the plane that follows a map: what has changed since the last look is drawn anew, and no more.

Strategy: a map in the plane is drawn as a whole by `OccupancyMap.map_server_image`, as is one in space whose
pixels are not as large as its smallest cells. Of others each pixel is painted from the cells above it; the
map tells which regions have another state than at the last look, and what is near these is painted anew.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ndtree._errors import WrongValue
from ndtree._native._core import OccupancyMap
from ndtree._native.results import Changes
from ndtree.live.canvas import Canvas, GridPart, Ints, Pixels, difference
from ndtree.live.columns import AboveGround, Boxes, Counts
from ndtree.maps.ground import FREE, OCCUPIED, SLOPE, UNKNOWN
from ndtree.maps.writers.map_server import noise_depth

#: No map reaches so far [m].
_EVERYWHERE = 1e12
#: By the grey of an image of map_server.
_VALUES = np.full(256, UNKNOWN, dtype=np.int8)
_VALUES[[254, 0]] = FREE, OCCUPIED


class GridFollower:
    """A pixel is occupied if some occupied cell overlaps it, else free if some free one does, else unknown.

    Free cells that hold something thin (`Leaves.thin`) are occupied, too, in a 2-D map if they touch no
    occupied pixel. So `OccupancyMap.map_server_image` has it; the grid may be larger, and is unknown there.

    Parameters
    ----------
    cell_size : float, optional
        Of a pixel [m]; left out, that of the map's smallest cells.
    height : (low, high), optional
        Of a 3-D map: only cells that overlap low <= z < high [m]; left out, all.
    wall_depth : float, optional
        As of `OccupancyMap.save_map_server` [m]; left out, `noise_depth`.

    Attributes
    ----------
    values : (rows, columns) int8 or None
        The whole grid; None before something is known.
    """

    def __init__(
        self,
        cell_size: float | None = None,
        height: tuple[float, float] | None = None,
        wall_depth: float | None = None,
    ) -> None:
        if cell_size is not None and not 0 < cell_size < math.inf:
            raise WrongValue.of("cell_size", f"{cell_size:g} m", "> 0 and finite")
        if height is not None and not height[0] < height[1]:
            raise WrongValue.of("height", f"{height[0]:g} to {height[1]:g} m", "from low to high")
        if wall_depth is not None and not wall_depth > 0:
            raise WrongValue.of("wall_depth", f"{wall_depth:g} m", "> 0")
        self._wanted, self._height, self._wall_depth = cell_size, height, wall_depth
        self._canvas: Canvas | None = None
        self._columns: Counts | AboveGround = Counts()
        self._draws_images, self._is_measured = True, False
        self._seen: OccupancyMap | None = None
        self.cell_size = cell_size or 0.0

    @property
    def values(self) -> Pixels | None:
        """The whole grid; None before something is known."""
        return None if self._canvas is None else self._canvas.values

    @property
    def origin(self) -> tuple[float, float]:
        """Lower corner [m]."""
        x, y = (0, 0) if self._canvas is None else self._canvas.lower.tolist()
        return x * self.cell_size, y * self.cell_size

    def follow(self, m: OccupancyMap) -> GridPart | None:
        """Become the grid of a map; None if nothing is another than before.

        Parameters
        ----------
        m : OccupancyMap
            A snapshot, which is kept.
        """
        unit = m.options["min_cell_size"]
        is_same = self.cell_size == (self._wanted or unit)
        self.cell_size = self._wanted or unit
        if self._draws_images and (m.dim == 2 or self.cell_size != unit):
            self._seen = None
            return self._become(*self._image(m), is_same)
        changes, self._seen = self._changes(m), m
        if changes is None or not self._is_measured:
            self._is_measured = bool((m.leaves(states=["occupied"]).hits > 0).any())
        depth = self._depth(m) if self._is_measured else None
        if changes is None or self._canvas is None or depth != self._columns.depth:
            self._columns.depth = depth
            return self._anew(m)
        corners, states = (changes.lower, changes.size), (changes.before, changes.after)
        boxes = Boxes.of(corners, states, self.cell_size, unit, self._height)
        if not boxes:
            return None
        if (boxes.after == -1).any() and self._canvas.is_wasteful:
            return self._anew(m)
        around = self._canvas.grow(boxes.first.min(axis=0), boxes.last.max(axis=0))
        if around is not None:
            self._columns.grow(around)
        return self._painted(m, boxes, is_whole=around is not None)

    def _depth(self, m: OccupancyMap) -> float | None:
        """How far behind free pixels large occupied cells are drawn [m]."""
        return noise_depth(m) if self._wall_depth is None else self._wall_depth

    def _anew(self, m: OccupancyMap) -> GridPart | None:
        boxes = Boxes.known(m, self.cell_size, self._height)
        if boxes:
            self._canvas = Canvas(boxes.first.min(axis=0), boxes.last.max(axis=0))
        elif self._canvas is None:
            return None
        self._canvas.values[:] = UNKNOWN
        self._columns.begin(*self._canvas.values.shape)
        return self._painted(m, boxes, is_whole=True)

    def _painted(self, m: OccupancyMap, boxes: Boxes, *, is_whole: bool) -> GridPart | None:
        """Paint what is near boxes; what of the grid is another."""
        assert self._canvas is not None
        canvas, reach = self._canvas, self._columns.reach(self.cell_size)
        if boxes:
            first = np.maximum(boxes.first.min(axis=0) - reach, canvas.lower)
            last = np.minimum(boxes.last.max(axis=0) + reach, canvas.upper)
            at = canvas.part(first, last)
            part = self._columns.painted(m, boxes, first, at, self.cell_size)
            found = difference(canvas.values[at], part, at[1].start, at[0].start)
            canvas.values[at] = part
        return GridPart(0, 0, canvas.values, True) if is_whole else found

    def _image(self, m: OccupancyMap) -> tuple[Pixels, Ints]:
        """The smallest grid of all that is known, and its first pixel."""
        height, depth = None if m.dim == 2 else self._height, self._depth(m)
        try:
            image, corner, _ = m.map_server_image(cell_size=self._wanted, height=height, wall_depth=depth)
        except ValueError:
            if _is_known(m, height):
                raise
            return np.zeros((0, 0), np.int8), np.zeros(2, np.int64)
        return _VALUES[image[::-1]], np.rint(np.array(corner) / self.cell_size).astype(np.int64)

    def _become(self, image: Pixels, first: Ints, is_same: bool) -> GridPart | None:
        """Become an image that begins at a pixel, with room around it; what of that is new.

        `is_same`: Pixels are as large as before.
        """
        before, last = self._canvas, first + image.shape[::-1]
        if before is None and not image.size:
            return None
        old = None
        if before is not None and is_same and (not image.size or before.has_room(first, last)):
            self._canvas, old = Canvas(before.lower, before.upper), before.values
        else:
            self._canvas = Canvas(first, last)
        if image.size:
            self._canvas.values[self._canvas.part(first, last)] = image
        values = self._canvas.values
        return GridPart(0, 0, values, True) if old is None else difference(old, values)

    def _changes(self, m: OccupancyMap) -> Changes | None:
        """What is another than at the last look; None if that was at no map, or at one of another kind."""
        box: NDArray[np.float64] | None = None
        if self._height is not None:  # And a cell more, for rounding.
            low, high = self._height[0] - self.cell_size, self._height[1] + self.cell_size
            box = np.array([[-_EVERYWHERE, -_EVERYWHERE, low], [_EVERYWHERE, _EVERYWHERE, high]])
        try:
            return None if self._seen is None else m.changes(since=self._seen, of="columns", box=box)
        except ValueError:
            return None


def _is_known(m: OccupancyMap, height: tuple[float, float] | None) -> bool:
    if m.dim == 2:
        return len(m.leaves(states=["free", "occupied"])) > 0
    return bool(Boxes.known(m, m.options["min_cell_size"], height))


class GroundFollower(GridFollower):
    """As `GridFollower`, of a 3-D map, with heights above the ground, which need not be flat.

    `cell_size`: As for `GridFollower`.
    `height` (low, high): Above the ground [m].
    `slope`: The steepest ground [m/m].
    `wall_depth`: As for `GridFollower`.
    Raises ValueError if a number is out of its limits.
    """

    def __init__(
        self,
        cell_size: float | None,
        height: tuple[float, float],
        slope: float = SLOPE,
        wall_depth: float | None = None,
    ) -> None:
        super().__init__(cell_size, height, wall_depth)
        if not 0 <= slope < math.inf:
            raise WrongValue.of("slope", f"{slope:g}", ">= 0 and finite")
        self._columns, self._draws_images = AboveGround(height, slope), False
        self._height = None  # Whatever changes, may change the ground.
