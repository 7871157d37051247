# SPDX-License-Identifier: BSD-3-Clause
"""What is seen of a map at one time: layers of cells, each made when it is first asked for."""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ndtree._native._core import OccupancyMap
from ndtree.cells.lattice import Cells, Floats, Pyramid, frontier, hidden
from ndtree.cells.regions import found_region, picture_region
from ndtree.plot import Coloring, coloring
from ndtree.viewer.look import IN_PLANE, Look, shown_kinds

MAX_LAYERS = 6  # Kept for the next time they are asked for.

_FREE_COLOR = (160, 190, 215)
_UNKNOWN_COLOR = (240, 140, 40)
_STATES = {-1: "unknown", 0: "free", 1: "occupied"}


@dataclass(frozen=True, eq=False)
class Layer:
    """Cells of one kind, with the boxes that are drawn for them, in the page's frame."""

    cells: Cells
    pyramid: Pyramid  # Boxes of the cells come first.
    coloring: Coloring | None

    @property
    def boxes(self) -> tuple[Floats, Floats]:
        """Lower and upper corners (n, 3) [m] of what is drawn for the cells."""
        return self.pyramid.lower[: len(self.cells)], self.pyramid.upper[: len(self.cells)]


class Snapshot:
    """A map at one time, and what is drawn of it.

    `origin` (3,): Where the page's frame is [m]; left out, in the middle of what was found. Far from the
        map's origin, float32 has no room for small cells.
    """

    def __init__(self, m: OccupancyMap, origin: Floats | None = None) -> None:
        if m.dim not in (2, 3):
            raise ValueError(f"the map is {m.dim}-D: only 2-D and 3-D maps can be seen")
        self.dim, self.refinement = m.dim, m.refinement
        #: As it is now, for questions about ways; None of an OctoMap.
        self.map = None if m.refinement == "octomap" else m.snapshot()
        #: Edge [m] of the smallest cells.
        self.unit = m.options["min_cell_size"]
        every = Cells.of_leaves(m.leaves(), self.unit, m.branching)
        if not np.any(every.observed):
            raise ValueError("the map is empty: nothing was inserted that could be drawn")
        largest = every.size[every.observed].max()
        self.cells = every.where(every.observed | (every.size <= largest))
        bounds = picture_region(self.cells) if self.dim == 2 else found_region(self.cells)
        #: Bounds [m] of what was found, (3, 2) in the map's frame.
        self.region = np.vstack([np.asarray(bounds).reshape(-1, 2), np.zeros((3 - self.dim, 2))])
        self.origin = np.round(self.region.mean(axis=1)) if origin is None else origin
        self._lock = threading.Lock()
        self._layers: dict[object, Layer] = {}
        self._colorings: dict[str, Coloring | None] = {}

    @cached_property
    def counts(self) -> tuple[int, int]:
        """Numbers of observed and of occupied cells."""
        return int(np.count_nonzero(self.cells.observed)), int(np.count_nonzero(self.cells.occupied))

    def layer(self, kind: str, look: Look) -> Layer:
        """Cells of a kind, as a look wants them, with what is drawn for them."""
        sliced = (look.axis, look.slice_at) if look.slice_at is not None else None
        if kind not in IN_PLANE and not look.cut:
            sliced = None
        color = look.color if kind.endswith("occupied") else None
        key = (kind, color, sliced)
        with self._lock:
            layer = self._layers.pop(key, None) or self._made(kind, sliced, color)
            for oldest in list(self._layers)[: max(0, len(self._layers) - MAX_LAYERS + 1)]:
                del self._layers[oldest]
            self._layers[key] = layer  # The last, and so the last to be dropped.
            return layer

    def _coloring(self, color: str | None) -> Coloring | None:
        """Colors of occupied cells, if there are any."""
        if color is None:
            return None
        if color not in self._colorings:
            some = self.cells.where(self.cells.occupied)
            self._colorings[color] = coloring(some, color) if len(some) else None
        return self._colorings[color]

    def _chosen(self, kind: str, sliced: tuple[int, float] | None) -> Cells:
        """Cells of a kind that can be seen."""
        if kind == "unknown":
            some = frontier(self.cells)
        else:
            some = self.cells.where(self.cells.state == (1 if kind.endswith("occupied") else 0))
            if kind not in IN_PLANE and self.dim == 3:  # All of a flat map is seen from above.
                inner = hidden(some)
                if sliced is not None:
                    at = sliced[1] / self.unit
                    inner &= ~((some.lower[:, sliced[0]] <= at) & (at < some.upper[:, sliced[0]]))
                some = some.where(~inner)
        if sliced is None:
            return some
        if kind in IN_PLANE:
            return some.through(*sliced)
        return some.where(some.lower[:, sliced[0]] * self.unit < sliced[1])

    def _made(self, kind: str, sliced: tuple[int, float] | None, color: str | None) -> Layer:
        some, colors = self._chosen(kind, sliced), self._coloring(color)
        lower, upper = np.zeros((2, len(some), 3))
        lower[:, : self.dim] = some.lower * self.unit
        upper[:, : self.dim] = some.upper * self.unit
        if sliced is not None:
            upper[:, sliced[0]] = np.minimum(upper[:, sliced[0]], sliced[1])
            if kind in IN_PLANE:
                lower[:, sliced[0]] = sliced[1]
        rgb = np.tile(np.array(_UNKNOWN_COLOR if kind == "unknown" else _FREE_COLOR), (len(some), 1))
        if colors is not None:
            rgb = np.rint(255 * colors(some))
        pyramid = Pyramid.of(some, lower - self.origin, upper - self.origin, rgb.astype(np.uint8))
        return Layer(some, pyramid, colors)

    def picked(self, origin: Floats, direction: Floats, look: Look) -> tuple[Cells, int] | None:
        """The first cell of those that are shown, on a ray in the page's frame, and its number there."""
        best: tuple[float, Cells, int] | None = None
        for kind in shown_kinds(look):
            layer = self.layer(kind, look)
            enter, number = first_on_ray(*layer.boxes, origin, direction)
            if number >= 0 and (best is None or enter < best[0]):
                best = (enter, layer.cells, number)
        return best[1:] if best else None


def first_on_ray(lower: Floats, upper: Floats, origin: Floats, direction: Floats) -> tuple[float, int]:
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
