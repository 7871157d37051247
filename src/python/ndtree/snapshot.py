# SPDX-License-Identifier: BSD-3-Clause
"""What is seen of a map at one time: boxes of its cells, coarser where they are too many, picking one."""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ndtree._core import OccupancyMap
from ndtree.lattice import Cells, Floats, Pyramid, frontier, hidden
from ndtree.plot import COLORS, Coloring, coloring
from ndtree.regions import ceiling, found_region

if TYPE_CHECKING:
    from ndtree.scan import Scan

AXES = "xyz"
KINDS = ("occupied", "free", "unknown", "plane_occupied", "plane_free")
IN_PLANE = KINDS[3:]
MAX_TRACK = 4096  # Points of a trajectory.
MAX_LAYERS = 6  # Kept for the next time they are asked for.

_FREE_COLOR = (160, 190, 215)
_UNKNOWN_COLOR = (240, 140, 40)
_STATES = {-1: "unknown", 0: "free", 1: "occupied"}


@dataclass(frozen=True)
class Look:
    """What of a map is shown, and how.

    Parameters
    ----------
    color : {"height", "size", "probability"}
        What the colors of occupied cells say. A 2-D map has no heights.
    occupied, free, unknown, track, grid : bool
        What is drawn: occupied cells, free cells, unknown cells beside free ones, where the sensor was, and a
        grid with axes and a scale bar.
    axis : {0, 1, 2}
        Of the slice.
    slice_at : float, optional
        Its position [m]; left out, there is none.
    cut : bool
        Leave out what is beyond the slice.
    plane : bool
        Draw the cells that the slice goes through.
    """

    color: str = "height"
    occupied: bool = True
    free: bool = False
    unknown: bool = False
    track: bool = True
    grid: bool = True
    axis: int = 2
    slice_at: float | None = None
    cut: bool = True
    plane: bool = True

    @classmethod
    def of(cls, dim: int, **more: Any) -> Look:
        """What suits maps of a dimension: flat ones show free cells, too, and no heights."""
        usual: dict[str, Any] = {"color": "probability", "free": True} if dim == 2 else {}
        return cls(**{**usual, **{name: value for name, value in more.items() if value is not None}})

    @classmethod
    def below_ceiling(cls, m: OccupancyMap, **more: Any) -> Look:
        """As `of`, but rooms are cut just below their ceiling, so that one sees into them."""
        if m.dim == 3 and more.get("slice_at") is None and np.any(m.leaves().state == 1):
            some = Cells.of(m)
            top = ceiling(some.where(some.occupied))
            if top is not None:
                more = {**more, "axis": 2, "slice_at": top, "cut": True, "plane": False}
        return cls.of(m.dim, **more)

    def validate(self, dim: int) -> None:
        """@raises ValueError if a map of this dimension cannot be shown so."""
        known = COLORS if dim == 3 else COLORS[1:]
        if self.color not in known:
            raise ValueError(f"color = {self.color!r}: must be one of {', '.join(known)} for a {dim}-D map")
        if self.axis not in (0, 1, 2):
            raise ValueError(f"axis = {self.axis!r}: must be 0, 1 or 2")
        if self.slice_at is not None and dim == 2:
            raise ValueError("slice_at: a 2-D map has no slices")


@dataclass(frozen=True)
class Layer:
    """Cells of one kind with the boxes that are drawn for them, in the page's frame."""

    cells: Cells
    pyramid: Pyramid
    coloring: Coloring | None


class Snapshot:
    """A map at one time, and what is drawn of it. Layers are made when they are first asked for."""

    def __init__(self, m: OccupancyMap) -> None:
        if m.dim not in (2, 3):
            raise ValueError(f"the map is {m.dim}-D: only 2-D and 3-D maps can be seen")
        self.dim = m.dim
        self.refinement = m.refinement
        self.cells = Cells.of(m)
        region = np.asarray(found_region(self.cells)).reshape(-1, 2)
        #: Bounds [m] of what was found, (3, 2) in the map's frame.
        self.region = np.vstack([region, np.zeros((3 - self.dim, 2))])
        #: Where the page's frame is: far from the map's origin, float32 has no room for small cells.
        self.origin = np.round(self.region.mean(axis=1))
        self._lock = threading.Lock()
        self._layers: dict[Any, Layer] = {}

    @cached_property
    def frontier(self) -> Cells:
        return frontier(self.cells)

    @cached_property
    def _occupied(self) -> tuple[Cells, NDArray[np.bool_]]:
        chosen = self.cells.where(self.cells.occupied)
        return chosen, hidden(chosen)

    @cached_property
    def _free(self) -> tuple[Cells, NDArray[np.bool_]]:
        chosen = self.cells.where(self.cells.free)
        return chosen, hidden(chosen)

    def layer(self, kind: str, look: Look) -> Layer:
        """Cells of one of the `KINDS`."""
        sliced = (look.axis, look.slice_at) if look.slice_at is not None else None
        if kind not in IN_PLANE and not look.cut:
            sliced = None
        key = (kind, look.color if kind.endswith("occupied") else None, sliced)
        with self._lock:
            layer = self._layers.pop(key, None)
            if layer is None:
                while len(self._layers) >= MAX_LAYERS:
                    del self._layers[next(iter(self._layers))]
                layer = self._made(kind, look, sliced)
            self._layers[key] = layer  # The last, and so the last to be dropped.
            return layer

    def _made(self, kind: str, look: Look, sliced: tuple[int, float] | None) -> Layer:
        colors = None
        if kind in IN_PLANE:
            assert sliced is not None
            some = self._occupied[0] if kind == "plane_occupied" else self._free[0]
            some = some.through(*sliced)
        elif kind == "unknown":
            some = self.frontier
        else:
            some, inner = self._occupied if kind == "occupied" else self._free
            if sliced is not None:
                at = sliced[1] / some.unit
                inner = inner & ~((some.lower[:, sliced[0]] <= at) & (at < some.upper[:, sliced[0]]))
            if self.dim == 3:  # All of a flat map is seen from above.
                some = some.where(~inner)
        if sliced is not None and kind not in IN_PLANE:
            some = some.where(some.lower[:, sliced[0]] * some.unit < sliced[1])
        lower, upper = np.zeros((2, len(some), 3))
        lower[:, : self.dim] = some.lower * some.unit
        upper[:, : self.dim] = some.upper * some.unit
        if sliced is not None:
            upper[:, sliced[0]] = np.minimum(upper[:, sliced[0]], sliced[1])
            if kind in IN_PLANE:
                lower[:, sliced[0]] = sliced[1]
        color = np.tile(np.array(_UNKNOWN_COLOR if kind == "unknown" else _FREE_COLOR), (len(some), 1))
        if kind.endswith("occupied") and len(self._occupied[0]):
            colors = coloring(self._occupied[0], look.color)
            color = np.rint(255 * colors(some))
        pyramid = Pyramid(some, lower - self.origin, upper - self.origin, color.astype(np.uint8))
        return Layer(some, pyramid, colors)

    def picked(self, origin: Floats, direction: Floats, look: Look) -> tuple[Cells, int] | None:
        """The first cell of those that are shown, on a ray in the page's frame, and its number there."""
        best: tuple[float, Cells, int] | None = None
        for kind in shown_kinds(look):
            layer = self.layer(kind, look)
            n = layer.pyramid.leaves
            enter, number = _first_on_ray(layer.pyramid.lower[:n], layer.pyramid.upper[:n], origin, direction)
            if number >= 0 and (best is None or enter < best[0]):
                best = (enter, layer.cells, number)
        return best[1:] if best else None


def shown_kinds(look: Look) -> list[str]:
    """Layers that a look has."""
    wanted = {"occupied": look.occupied, "free": look.free, "unknown": look.unknown}
    kinds = [kind for kind, is_wanted in wanted.items() if is_wanted]
    return [*kinds, *IN_PLANE] if look.slice_at is not None and look.plane else kinds


def _first_on_ray(lower: Floats, upper: Floats, origin: Floats, direction: Floats) -> tuple[float, int]:
    """Distance and number of the first box on a ray; -1 for none. Flat boxes are met, too."""
    if not len(lower):
        return math.inf, -1
    with np.errstate(divide="ignore", invalid="ignore"):
        one, two = (lower - origin) / direction, (upper - origin) / direction
    inside = (lower <= origin) & (origin <= upper)
    nan = np.isnan(one) | np.isnan(two)  # Parallel to a face, and in its plane.
    low = np.where(nan, np.where(inside, -np.inf, np.inf), np.fmin(one, two))
    high = np.where(nan, np.where(inside, np.inf, -np.inf), np.fmax(one, two))
    enter, leave = np.maximum(low.max(axis=1), 0.0), high.min(axis=1)
    met = np.flatnonzero(enter <= leave + 1e-12)
    if not len(met):
        return math.inf, -1
    first = met[np.argmin(enter[met])]
    return float(enter[first]), int(first)


def numbers_of(cells: Cells, number: int) -> str:
    """A cell's numbers as Markdown."""
    middle = (cells.lower[number] + 0.5 * cells.size[number]) * cells.unit
    rows = {
        "centre": f"({', '.join(f'{c:.3f}' for c in middle)}) m",
        "size": f"{cells.size[number] * cells.unit:g} m",
        "state": _STATES[int(cells.state[number])],
        "probability": f"{cells.probability[number]:.3f}",
        "hits": f"{cells.hits[number]:,}",
        "misses": f"{cells.misses[number]:,}",
    }
    return "\n".join(["| | |", "|---|---|", *(f"| {name} | {value} |" for name, value in rows.items())])


class Track:
    """Where the sensor was, in a bounded number of points: where there are too many, every second goes."""

    def __init__(self) -> None:
        self.points: list[Floats] = []
        self._step, self._seen = 1, 0

    def add(self, scan: Scan) -> None:
        """The mean origin of a scan's beams."""
        if self._seen % self._step == 0:
            origin = np.asarray(scan.origin, dtype=np.float64)
            self.points.append(origin if origin.ndim == 1 else origin.mean(axis=0))
            if len(self.points) > MAX_TRACK:
                self.points = self.points[::2]
                self._step *= 2
        self._seen += 1

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Floats:
        points = np.zeros((len(self.points), 3))
        if self.points:
            points[:, : len(self.points[0])] = self.points
        return points
