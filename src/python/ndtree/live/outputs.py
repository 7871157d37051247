# SPDX-License-Identifier: BSD-3-Clause
"""What is shown of a map on robots, as arrays: occupied cells as points or boxes, and frontiers as poses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ndtree._native._checked import checked
from ndtree._native._core import FrontierSearch, OccupancyMap
from ndtree._native.results import Changes, Leaves
from ndtree.base.scan import COLOR
from ndtree.live.way import Way
from ndtree.maps.ground import FREE, OCCUPIED, UNKNOWN

#: Cells that are shown.
State = Literal["occupied", "free"]
#: A point: where the cell's centre is, how large it is [m], and how probable that it is occupied.
POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("size", "<f4"), ("probability", "<f4")])
#: The same, and its colour 0x00RRGGBB in the bits of a number, as PCL packs it; grey where none was seen.
COLORED = np.dtype([*POINT.descr, ("rgb", "<f4")])
_GREY = 128
#: Of cells by their size, the smallest first: red, green, blue.
_SIZES = ((0.9, 0.3, 0.1), (0.95, 0.6, 0.1), (0.9, 0.85, 0.2), (0.4, 0.75, 0.3), (0.2, 0.55, 0.8))
#: Of pixels of a grid: red, green, blue, alpha; what is unknown is not drawn.
GRID_COLORS = {UNKNOWN: (0, 0, 0, 0), FREE: (235, 235, 235, 255), OCCUPIED: (30, 30, 30, 255)}
#: A region with another state: its centre and size [m], and the states, -1 unknown, 0 free, 1 occupied.
CHANGE = np.dtype([(name, "<f4") for name in ("x", "y", "z", "size", "before", "after")])


def cell_points(
    m: OccupancyMap, state: State = "occupied", *, without_speckles: bool = False
) -> NDArray[np.void]:
    """Cells of a state as records of `POINT`, of a map with colours of `COLORED`; of a 2-D map at z = 0.

    `state`: {"occupied", "free"}.
    `without_speckles`: Leave out smallest cells without a neighbour of the same state, at corners, too.
    """
    leaves = m.leaves(states=[state])
    center, size, probability = leaves.center, leaves.size, leaves.probability
    if without_speckles:
        keep = ~_are_speckles(m, leaves)
        center, size, probability = center[keep], size[keep], probability[keep]
    points = np.zeros(len(size), dtype=COLORED if COLOR in m.layers else POINT)
    for name, values in zip("xyz", center.T):
        points[name] = values
    points["size"], points["probability"] = size, probability
    if COLOR in m.layers:
        colors = np.nan_to_num(m.layer(COLOR, center), nan=_GREY).round().astype(np.uint32)
        points["rgb"] = (colors @ np.array([1 << 16, 1 << 8, 1], np.uint32)).view(np.float32)
    return points


def _are_speckles(m: OccupancyMap, leaves: Leaves) -> NDArray[np.bool_]:
    """Which leaves, all of one state, are smallest cells of which no neighbour has that state."""
    unit = m.options["min_cell_size"]
    lonely = leaves.size < 1.5 * unit
    for offset in product((-1, 0, 1), repeat=m.dim):
        at = np.flatnonzero(lonely)
        if any(offset) and len(at):
            lonely[at] = m.state(leaves.center[at] + unit * np.array(offset)) != leaves.state[at]
    return lonely


def changed_points(changes: Changes) -> NDArray[np.void]:
    """Regions that have another state than before as records of `CHANGE`; those of a 2-D map lie at z = 0."""
    points = np.zeros(len(changes.size), dtype=CHANGE)
    for name, values in zip("xyz", (changes.lower + 0.5 * changes.size[:, None]).T):
        points[name] = values
    points["size"], points["before"], points["after"] = changes.size, changes.before, changes.after
    return points


class Cells(NamedTuple):
    """Cells of one size [m]: centres (n, 3) [m], and colours (n, 3) or (1, 3), of each or of all, 0 to 1."""

    size: float
    centers: NDArray[np.float64]
    colors: NDArray[np.float64]


def by_size(points: NDArray[np.void]) -> list[Cells]:
    """Cells by their size, the smallest first, in their own colours, else in one for each size."""
    sizes, which = np.unique(points["size"], return_inverse=True)
    centers = np.stack([points[name].astype(np.float64) for name in "xyz"], axis=1)
    found = []
    for number, size in enumerate(sizes.tolist()):
        colors = np.array([_SIZES[min(number, len(_SIZES) - 1)]])
        if points.dtype == COLORED:
            packed = points["rgb"][which == number].view(np.uint32)[:, None]
            colors = (packed >> np.array([16, 8, 0], np.uint32) & 255) / 255.0
        found.append(Cells(size, centers[which == number], colors))
    return found


class FrontierPose(NamedTuple):
    """Where a robot would look into the unknown: a point (3,) [m], and a quaternion x, y, z, w."""

    position: tuple[float, float, float]
    quaternion: tuple[float, float, float, float]


@checked
@dataclass(frozen=True)
class Shown:
    """What of a live map an application shows.

    `period`: From one time to the next [s].
    `height` (low, high): Of a 3-D map: the grid is of cells between these heights [m].
    `way`: Of the sensor.
    `min_cells`: Smaller frontiers are left out.
    Raises ValueError if the period is not >= 0 and finite.
    """

    period: float
    height: tuple[float, float] | None = None
    way: Way | None = None
    min_cells: float = 8.0

    def __post_init__(self) -> None:
        if not 0 <= self.period < math.inf:
            raise ValueError(f"period = {self.period:g} s: must be >= 0 and finite")


class Frontiers:
    """Frontiers that follow a map, as poses whose x axis looks into the unknown; the largest first."""

    def __init__(self, min_cells: float) -> None:
        self._min_cells = min_cells
        self._search: FrontierSearch | None = None

    def follow(self, m: OccupancyMap) -> list[FrontierPose]:
        """Those of a map."""
        try:
            if self._search is None:
                self._search = FrontierSearch(m)
            else:
                self._search.update(m)
        except ValueError:  # Another kind of map.
            self._search = FrontierSearch(m)
        return [
            FrontierPose(_in_space(one.goal), _looking(_in_space(one.direction)))
            for one in self._search.frontiers(min_cells=self._min_cells)
        ]


def _in_space(point: NDArray[np.float64]) -> tuple[float, float, float]:
    x, y, z = [*point.tolist(), 0.0][:3]
    return x, y, z


def direction_of(quaternion: Sequence[float]) -> tuple[float, float, float]:
    """Where the x axis looks that a quaternion x, y, z, w turns."""
    x, y, z, w = quaternion
    return 1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)


def _looking(way: tuple[float, float, float]) -> tuple[float, float, float, float]:
    """The rotation by yaw and pitch that turns x into a direction; none for a direction of length 0."""
    x, y, z = way
    yaw, pitch = math.atan2(y, x), -math.atan2(z, math.hypot(x, y))
    a, b, c, d = math.cos(yaw / 2), math.sin(yaw / 2), math.cos(pitch / 2), math.sin(pitch / 2)
    return -b * d, a * d, b * c, a * c
