# SPDX-License-Identifier: BSD-3-Clause
"""The occupied cells of a 3-D map as shaded cubes, those in front before those behind."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypedDict

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from numpy.typing import ArrayLike

from ndtree._native._core import OccupancyMap
from ndtree.cells.lattice import (
    Booleans,
    CellIndex,
    Cells,
    Floats,
    Integers,
    coarsened,
    neighbours,
    observed_bounds,
    occupied_cells,
)
from ndtree.cells.regions import ceiling, found_region
from ndtree.plot.colors import Coloring, coloring
from ndtree.plot.figures import CutAbove, Region, axes_or_new, framed, require_dim

if TYPE_CHECKING:
    from typing_extensions import Unpack

MAX_VECTOR_FACES = 20_000  # More are an image in SVG and PDF, too.
_OUTLINE = 0.8  # Brightness of a face's border, of that of the face.
_LINEWIDTH = 0.25  # Of it [points].


class ViewOptions(TypedDict, total=False):
    """Keywords of `occupied`, which pictures with it take, too."""

    azimuth: float
    elevation: float
    cut_above: CutAbove
    region: Region | None
    color: str


@dataclass(frozen=True)
class View:
    """What is drawn of the occupied cells, and from where."""

    azimuth: float = -60.0
    elevation: float = 50.0
    cut_above: CutAbove = "auto"
    region: Region | None = None
    color: str = "height"

    @property
    def angles(self) -> tuple[float, float]:
        return self.azimuth, self.elevation


def occupied(
    m: OccupancyMap,
    ax: Axes | None = None,
    *,
    colormap: str | None = None,
    heights: tuple[float, float] | None = None,
    finest: float = 0.0,
    **view: Unpack[ViewOptions],
) -> Axes:
    """Draw the occupied leaves of a 3-D map as shaded cubes, as in the paper's Figs. 5 and 6.

    The projection is orthographic. What is in front hides what is behind, exactly: the cubes are drawn in the
    order of the tree, far children first.

    Parameters
    ----------
    m : AdaptiveMap, FixedMap or OctoMap
        With ``dim`` 3.
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure if left out.
    azimuth : float
        Where the viewer stands, counter-clockwise from x, seen from above [degrees].
    elevation : float
        How high, from -90 below to 90 above [degrees].
    cut_above : float, "auto" or None
        What is above this height is left out [m]. "auto" finds a ceiling, if there is one.
    region : (x_min, x_max, y_min, y_max, z_min, z_max), optional
        What to show [m]; left out, where something was found.
    color : {"height", "size", "probability"}
        What the colors say: height of a cell's middle, its edge length, or its probability.
    colormap : str, optional
        Of matplotlib; left out, one for each `color`.
    heights : (float, float), optional
        Where the colors of heights begin and end [m]; left out, where the cells do.
    finest : float
        Cells smaller than this, such as a pixel, are drawn as one [m].

    Returns
    -------
    matplotlib.axes.Axes
        Without frame; its coordinates are metres in the plane of the picture.
    """
    require_dim(m, 3)
    shown, cubes = View(**view), occupied_cells(m)
    region = found_region(cubes, observed_bounds(m)) if shown.region is None else shown.region
    chosen, bounds = chosen_cubes(cubes, region, shown.cut_above)
    colors = coloring(chosen, shown.color, colormap, heights)
    drawn = draw_cubes(chosen, bounds, axes_or_new(ax), shown.angles, colors, finest)
    return framed(drawn, bounds_on_screen(chosen, bounds, *shown.angles))


def projected(points: ArrayLike, *, azimuth: float = -60.0, elevation: float = 50.0) -> Floats:
    """Where points (n, 3) [m] lie in a picture of `occupied` with the same view: (n, 2) [m]."""
    return np.asarray(points, dtype=np.float64).reshape(-1, 3) @ _screen(azimuth, elevation)[1]


def chosen_cubes(cubes: Cells, region: Region, cut_above: CutAbove) -> tuple[Cells, Region]:
    """Of the occupied leaves those to be shown, and the bounds [m] to which they are cut."""
    if not len(cubes.size):
        raise ValueError("the map has no occupied cells that could be drawn")
    bounds = list(region)
    cubes = cubes.inside(bounds)
    if cut_above == "auto":
        cut_above = ceiling(cubes)
    if isinstance(cut_above, str):
        raise ValueError(f"cut_above = {cut_above!r}: must be a height in metres, 'auto' or None")
    if cut_above is not None:
        bounds[5] = min(bounds[5], cut_above)
        cubes = cubes.inside(bounds)
    if not len(cubes.size):
        raise ValueError(f"region = {tuple(bounds)}: no occupied cell is in it")
    return cubes, bounds


def _screen(azimuth: float, elevation: float) -> tuple[Floats, Floats]:
    """The direction to the viewer, and the picture's right and up as columns."""
    a, e = math.radians(azimuth), math.radians(elevation)
    to_viewer = np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])
    right = np.array([-math.sin(a), math.cos(a), 0.0])
    return to_viewer, np.stack([right, np.cross(to_viewer, right)], axis=1)


def _clipped(cubes: Cells, bounds: Region) -> tuple[Floats, Floats]:
    lower = np.maximum(cubes.lower * cubes.unit, np.asarray(bounds[0::2], dtype=np.float64))
    upper = np.minimum(cubes.upper * cubes.unit, np.asarray(bounds[1::2], dtype=np.float64))
    return lower, upper


def bounds_on_screen(cubes: Cells, bounds: Region, azimuth: float, elevation: float) -> tuple[float, ...]:
    """What the cubes take up in the picture [m], and a little more."""
    _, screen = _screen(azimuth, elevation)
    lower, upper = _clipped(cubes, bounds)
    low, high = np.empty(2), np.empty(2)
    for k in range(2):  # Of each cube the corner that is farthest along an axis of the picture.
        first, last = np.zeros(len(cubes)), np.zeros(len(cubes))
        for a, weight in enumerate(screen[:, k]):
            ends = (lower[:, a], upper[:, a]) if weight > 0 else (upper[:, a], lower[:, a])
            first += weight * ends[0]
            last += weight * ends[1]
        low[k], high[k] = first.min(), last.max()
    margin = 0.01 * float(np.max(high - low))
    return (low[0] - margin, high[0] + margin, low[1] - margin, high[1] + margin)


def draw_cubes(
    cubes: Cells, bounds: Region, ax: Axes, view: tuple[float, float], colors: Coloring, finest: float
) -> Axes:
    """Cells that are smaller than `finest` [m] are drawn as large, in their mean color. Has no frame yet."""
    to_viewer, screen = _screen(*view)
    fills = colors(cubes)
    if finest >= cubes.unit:
        steps = int(math.log(finest / cubes.unit * 1.000001, cubes.branching))
        joined, number = coarsened(cubes, cubes.branching**steps)
        count = np.bincount(number)[:, None]
        fills = np.stack([np.bincount(number, fills[:, k]) for k in range(3)], axis=1) / count
        cubes = joined
    number, axis = _open_faces(cubes, to_viewer)
    corners = _corners(cubes, bounds, number, axis, to_viewer >= 0, screen)
    shades = np.array([0.15, 0.5, 1.0]) * 0.38 + 0.62
    fill = fills[number] * shades[axis, None]  # Darker to the sides.
    first, one, two = np.moveaxis(corners, 1, 0)
    faces = PolyCollection(
        np.stack([first, one, one + two - first, two], axis=1),
        facecolors=fill,
        edgecolors=_OUTLINE * fill,
        linewidths=_LINEWIDTH,
        rasterized=len(fill) > MAX_VECTOR_FACES,
    )
    ax.add_collection(faces, autolim=False)
    ax.set_axis_off()
    return ax


def _open_faces(cubes: Cells, to_viewer: Floats) -> tuple[Integers, Integers]:
    """Cube and axis of each face that looks to the viewer and lies on no cube as large; far ones first."""
    index = CellIndex(cubes.lower, cubes.size, cubes.branching)
    open_ = np.zeros((len(cubes), 3), dtype=np.bool_)
    for a in np.flatnonzero(np.abs(to_viewer) >= 1e-9):
        beside = index.find(neighbours(cubes, a, to_viewer[a] >= 0))
        open_[:, a] = (beside < 0) | (cubes.size[beside] < cubes.size)
    order = _far_to_near(cubes, to_viewer)
    place, axis = np.nonzero(open_[order])  # A cube's own faces do not hide each other.
    return order[place], axis


def _corners(
    cubes: Cells, bounds: Region, number: Integers, axis: Integers, is_upper: Booleans, screen: Floats
) -> Floats:
    """Three corners (n, 3, 2) of faces on the screen [m], the one between the others first."""
    lower, upper = _clipped(cubes, bounds)
    extent = upper - lower
    raised = np.where(is_upper[axis], extent[number, axis], 0.0)
    corners = np.repeat((lower @ screen)[number, None] + (raised[:, None] * screen[axis])[:, None], 3, axis=1)
    for k, others in enumerate(np.array([[1, 0, 0], [2, 2, 1]])[:, axis]):
        corners[:, 1 + k] += extent[number, others, None] * screen[others]
    return corners


def _far_to_near(cubes: Cells, to_viewer: Floats) -> Integers:
    """Order in which cubes of a tree hide only cubes before them.

    Mirrored so that the viewer is on the upper side of every axis, a child hides only siblings that are not
    above it on any axis. Comparing the offsets level by level, the coarsest first, is such an order.
    """
    sizes = np.unique(cubes.size)
    largest = int(sizes[-1])
    mirrored = np.where(to_viewer >= 0, cubes.lower, -cubes.upper)
    keys = [mirrored[:, a] // largest for a in range(3)]
    for coarse, fine in zip(sizes[:0:-1], sizes[-2::-1]):
        keys += [(mirrored[:, a] % coarse) // fine for a in range(3)]
    return np.lexsort(keys[::-1])
