# SPDX-License-Identifier: BSD-3-Clause
"""Whole pictures: a map, or two beside each other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from ndtree._errors import WrongValue
from ndtree._native._core import OccupancyMap
from ndtree.cells.lattice import Cells, cells_through, observed_bounds, occupied_cells
from ndtree.cells.regions import ceiling, found_region, picture_region
from ndtree.plot.colors import coloring, explain_states, name_axes, scale_bar
from ndtree.plot.cubes import View, ViewOptions, bounds_on_screen, chosen_cubes, draw_cubes
from ndtree.plot.figures import (
    WITHOUT_BAR,
    Path,
    Picture,
    Region,
    add_bar,
    axis_number,
    framed,
    kind_of,
    panels,
    require_dim,
    shape_of,
    title_of,
    title_of_map,
    written,
)
from ndtree.plot.flat import cell_sizes, occupancy, slice
from ndtree.plot.images import draw_borders, draw_occupancy

if TYPE_CHECKING:
    from typing_extensions import Unpack


def side_by_side(
    adaptive: OccupancyMap,
    fixed: OccupancyMap,
    path: Path | None = None,
    *,
    region: Region | None = None,
    row: bool | None = None,
    width: float = 16.0,
    dpi: float = 200.0,
) -> Figure:
    """Draw an adaptive map's leaves and occupancy, and a fixed map's occupancy, side by side (Fig. 4).

    Parameters
    ----------
    adaptive, fixed : AdaptiveMap, FixedMap or OctoMap
        With ``dim`` 2, of the same log.
    path : str or path, optional
        The picture to write; its ending chooses the format.
    region : (x_min, x_max, y_min, y_max), optional
        What to show [m]; left out, what was observed.
    row : bool, optional
        The panels in a row, or one below the other. Left out, as suits the region's shape.
    width : float
        Of the picture [inches].
    dpi : float
        Pixels an inch.

    Returns
    -------
    matplotlib.figure.Figure
        With three axes.
    """
    for m in (adaptive, fixed):
        require_dim(m, 2)
    fine, even = Cells.of(adaptive), Cells.of(fixed)
    shown = tuple(region) if region is not None else picture_region(fine)
    shape = shape_of(shown)
    in_row = shape > 0.4 if row is None else row
    figure, axes = panels([shape], 3, width) if in_row else panels([shape] * 3, 1, width)
    draw_borders(fine, axes[0], shown)
    draw_occupancy(fine, axes[1], shown)
    draw_occupancy(even, axes[2], shown)
    axes[0].set_title(title_of(fine, "adaptive"))
    scale_bar(axes[0])
    axes[1].set_title("the same map: occupied black, free white, unknown grey")
    axes[2].set_title(title_of(even, "fixed"))
    return written(figure, path, dpi)


def overview(
    m: OccupancyMap,
    path: Path | None = None,
    *,
    region: Region | None = None,
    track: ArrayLike | None = None,
    color: str = "state",
    width: float = 12.0,
    dpi: float = 150.0,
) -> Figure:
    """Draw a 2-D map: its occupancy, or its cells in the color of their size.

    Parameters
    ----------
    m : AdaptiveMap, FixedMap or OctoMap
        With ``dim`` 2.
    path, region, width, dpi
        As for `side_by_side`.
    track : array_like, (n, 2), optional
        Where the robot drove [m]: that is shown, too, if `region` is left out.
    color : {"state", "probability", "size"}
        What the colors say; the first two as for `occupancy`.
    """
    require_dim(m, 2)
    if color not in ("state", "probability", "size"):
        raise ValueError(f"color = {color!r}: must be state, probability or size where the map is 2-D")
    every = Cells.of(m)
    shown = tuple(region) if region is not None else picture_region(every, track)
    shape = shape_of(shown)
    axes_width = width * (WITHOUT_BAR if color == "size" else 1.0)
    figure = Picture(figsize=(width, axes_width * shape + 0.6), layout="constrained")
    ax = figure.add_subplot()
    if color == "size":
        cell_sizes(m, ax, region=shown)
    else:
        occupancy(m, ax, region=shown, color=color)
    ax.set_title(title_of(every, kind_of(m.refinement)), loc="left")
    name_axes(ax)
    scale_bar(ax)
    if color != "size":
        explain_states(ax)
    return written(figure, path, dpi)


class PageOptions(ViewOptions, total=False):
    """Keywords of pictures of 3-D maps with a slice."""

    slice_axis: str | int
    slice_at: float | None


@dataclass(frozen=True)
class _Page(View):
    """What of a 3-D map is drawn, and from where."""

    slice_axis: str | int = "z"
    slice_at: float | None = None


def side_by_side_3d(
    adaptive: OccupancyMap,
    fixed: OccupancyMap,
    path: Path | None = None,
    *,
    width: float = 16.0,
    dpi: float = 200.0,
    **shown: Unpack[PageOptions],
) -> Figure:
    """Draw an adaptive and a fixed 3-D map side by side: occupied cells, seen alike, and a slice of each.

    Parameters
    ----------
    adaptive, fixed : AdaptiveMap, FixedMap or OctoMap
        With ``dim`` 3, of the same log.
    path, width, dpi
        As for `side_by_side`.
    azimuth, elevation, cut_above, region, color
        As for `occupied`.
    slice_axis : {"x", "y", "z", 0, 1, 2}
        The coordinate that is held in the slices.
    slice_at : float, optional
        Its value [m]; left out, half-way through what the cubes show.

    Returns
    -------
    matplotlib.figure.Figure
        With four axes, and a bar that says what the colors mean.
    """
    maps = {"adaptive": adaptive, "fixed": fixed}
    return written(_draw_3d(maps, _Page(**shown), width, dpi), path, dpi)


def overview_3d(
    m: OccupancyMap,
    path: Path | None = None,
    *,
    width: float = 12.0,
    dpi: float = 150.0,
    **shown: Unpack[PageOptions],
) -> Figure:
    """Draw a 3-D map: its occupied cells above, a slice with the leaves below.

    Parameters
    ----------
    m : AdaptiveMap, FixedMap or OctoMap
        With ``dim`` 3.
    path, azimuth, elevation, cut_above, region, color, slice_axis, slice_at, width, dpi
        As for `side_by_side_3d`.

    Returns
    -------
    matplotlib.figure.Figure
        With two axes, and a bar that says what the colors mean.
    """
    return written(_draw_3d({kind_of(m.refinement): m}, _Page(**shown), width, dpi), path, dpi)


def _draw_3d(maps: dict[str, OccupancyMap], shown: _Page, width: float, dpi: float) -> Figure:
    """A column for each map: its cubes, and below them its slice; the first map chooses what is shown."""
    for m in maps.values():
        require_dim(m, 3)
    held, cut_above, region = axis_number(shown.slice_axis), shown.cut_above, shown.region
    lowest, highest = (corner[held] for corner in observed_bounds(next(iter(maps.values()))))
    if shown.slice_at is not None and not lowest <= shown.slice_at < highest:
        seen = f"from {lowest:.2f} to {highest:.2f} m, where something was observed"
        raise WrongValue.of("slice_at", f"{shown.slice_at:g} m", seen)
    titles = [title_of_map(m, kind) for kind, m in maps.items()]
    every = [occupied_cells(m) for m in maps.values()]
    others = [a for a in range(3) if a != held]
    if region is None:
        region = found_region(every[0], observed_bounds(next(iter(maps.values()))))
    if cut_above == "auto":
        cut_above = ceiling(every[0].inside(region)) if len(every[0]) else None
    chosen = [chosen_cubes(one, region, cut_above) for one in every]
    colors = coloring(chosen[0][0], shown.color)
    at = shown.slice_at
    if at is None:
        middle = (chosen[0][0].lower[:, held] + 0.5 * chosen[0][0].size) * every[0].unit
        at = float(np.mean(np.percentile(middle, (1, 99))))
    if shown.region is None:
        flat_region = picture_region(cells_through(next(iter(maps.values())), held, at).along(others))
    else:
        flat_region = tuple(edge for a in others for edge in region[2 * a : 2 * a + 2])
    corners = bounds_on_screen(*chosen[0], *shown.angles)
    shapes = (shape_of(corners), shape_of(flat_region))
    column_width = WITHOUT_BAR * width / len(maps)
    pixel = (corners[1] - corners[0]) / (column_width * dpi)
    figure = Picture(figsize=(width, column_width * sum(shapes) + 1.0), layout="constrained")
    axes = figure.subplots(2, len(maps), squeeze=False, height_ratios=shapes)
    for column, (kind, m, one, title) in enumerate(zip(maps, maps.values(), chosen, titles)):
        above, below = axes[:, column]
        framed(draw_cubes(*one, above, shown.angles, colors, pixel), corners)
        above.set_title(title)
        scale_bar(above)
        slice(m, held, at, below, region=flat_region, borders=kind != "fixed")
        below.set_title(f"slice at {'xyz'[held]} = {at:.2f} m", loc="left")
        explain_states(below)
    add_bar(colors.legend(), list(axes[0]), colors.label, colors.ticks, shrink=0.7)
    return figure
