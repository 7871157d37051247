# SPDX-License-Identifier: BSD-3-Clause
"""Pictures of maps in the paper's style (Figs. 4 to 6): leaves, occupancy, slices, occupied cells in 3-D.

What draws into one ``Axes`` takes it as ``ax``, makes a figure if it is left out, and returns it. What draws
several panels returns its ``Figure``, and writes it if there is a path, in the format of its ending.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Union

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ndtree._core import OccupancyMap
from ndtree.comparison import Comparison
from ndtree.files import replaced
from ndtree.lattice import Cells, Floats, Integers, coarsened, covered_faces
from ndtree.regions import ceiling, found_region

try:
    from matplotlib.axes import Axes
    from matplotlib.backend_bases import FigureCanvasBase
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.collections import LineCollection, PolyCollection
    from matplotlib.colors import LogNorm, Normalize
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage
    from matplotlib.ticker import PercentFormatter
except ImportError as error:
    raise ImportError(
        f"ndtree.plot needs matplotlib ({error}); install it with: pip install 'ndtree-mapping[plot]'"
    ) from None

Region = Sequence[float]
Path = Union[str, "os.PathLike[str]"]
CutAbove = Union[float, str, None]

#: Endings of picture files.
FORMATS = tuple(f".{ending}" for ending in sorted(FigureCanvasBase.get_supported_filetypes()))
MAX_IMAGE_CELLS = 16_000_000
MAX_VECTOR_FACES = 20_000  # More are an image in PDF and SVG files, too.
UNKNOWN = 0.5
BORDER_COLOR = "#2b5c8a"
SIZE_COLORS = "viridis_r"
WITHOUT_BAR = 0.9  # Share of a picture's width that is left beside a bar of colors.


# --- 2-D ------------------------------------------------------------------------------------------


def cells(
    m: OccupancyMap,
    ax: Axes | None = None,
    *,
    region: Region | None = None,
    color: str = BORDER_COLOR,
    linewidth: float = 0.35,
) -> Axes:
    """Draw the borders of a 2-D map's leaves, as in the paper's Fig. 4a.

    Parameters
    ----------
    m : AdaptiveMap, FixedMap or OctoMap
        With ``dim`` 2.
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure if left out.
    region : (x_min, x_max, y_min, y_max), optional
        What to show [m]; left out, where something was found.
    color : str
        Of the lines.
    linewidth : float
        Of the lines [points].

    Returns
    -------
    matplotlib.axes.Axes
    """
    _require_dim(m, 2)
    return _draw_borders(Cells.of(m), _axes(ax), region, color, linewidth)


def occupancy(
    m: OccupancyMap, ax: Axes | None = None, *, region: Region | None = None, borders: bool = False
) -> Axes:
    """Draw a 2-D map: occupied white, free black, unknown grey, as in the paper's Figs. 4b and 4c.

    A pixel of the picture that has an occupied cell in it is drawn occupied, however small the cell.

    Parameters
    ----------
    m : AdaptiveMap, FixedMap or OctoMap
        With ``dim`` 2.
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure if left out.
    region : (x_min, x_max, y_min, y_max), optional
        What to show [m]; left out, where something was found.
    borders : bool
        Draw the leaves' borders, too.

    Returns
    -------
    matplotlib.axes.Axes
    """
    _require_dim(m, 2)
    every, ax = Cells.of(m), _axes(ax)
    ax = _draw_occupancy(every, ax, region)
    if borders:
        _draw_borders(every, ax, (*ax.get_xlim(), *ax.get_ylim()))
    return ax


def cell_sizes(
    m: OccupancyMap, ax: Axes | None = None, *, region: Region | None = None, colormap: str = SIZE_COLORS
) -> Axes:
    """Draw a 2-D map with each observed cell in the color of its size; a pixel shows its smallest cell.

    Parameters
    ----------
    m : AdaptiveMap, FixedMap or OctoMap
        With ``dim`` 2.
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure if left out.
    region : (x_min, x_max, y_min, y_max), optional
        What to show [m]; left out, where something was found.
    colormap : str
        Of matplotlib.

    Returns
    -------
    matplotlib.axes.Axes
        With a bar beside it that says which color is which size.
    """
    _require_dim(m, 2)
    every, ax = Cells.of(m), _axes(ax)
    region = tuple(region) if region is not None else found_region(every)
    shown = every.where(every.observed).inside(region)
    largest = float(every.size[every.observed].max()) * every.unit
    # The image keeps the largest value of a pixel: sizes go in as their inverses.
    image, extent = _image(replace(shown, probability=1.0 / (shown.size * every.unit)), region, empty=0.0)
    with np.errstate(divide="ignore"):
        sizes = np.ma.masked_invalid(1.0 / image)
    colors = _colormap(colormap).with_extremes(bad=str(UNKNOWN))
    norm = LogNorm(every.unit, max(largest, 1.001 * every.unit))
    drawn = _PooledImage(ax, _smallest, cmap=colors, norm=norm, extent=extent)
    drawn.set_data(sizes)
    ax.add_image(drawn)
    _add_bar(drawn, [ax], "cell size [m]", np.unique(every.size[every.observed]) * every.unit)
    return _framed(ax, region)


def slice(
    m: OccupancyMap,
    axis: str | int,
    value: float,
    ax: Axes | None = None,
    *,
    region: Region | None = None,
    borders: bool = False,
) -> Axes:
    """Draw the plane through a 3-D map where one coordinate has a value.

    Parameters
    ----------
    m : AdaptiveMap, FixedMap or OctoMap
        With ``dim`` 3.
    axis : {"x", "y", "z", 0, 1, 2}
        The coordinate that is held.
    value : float
        Its value [m].
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure if left out.
    region : (min, max, min, max), optional
        What to show of the other two coordinates [m]; left out, where something was found.
    borders : bool
        Draw the leaves' borders, too, but not of leaves so small that nothing else would be seen.

    Returns
    -------
    matplotlib.axes.Axes
    """
    _require_dim(m, 3)
    held = _axis_number(axis)
    others = [a for a in range(3) if a != held]
    flat = Cells.of(m).through(held, value).along(others)
    if not flat.observed.any():
        raise ValueError(f"{'xyz'[held]} = {value:g} m: the map was not observed there")
    ax = _draw_occupancy(flat, _axes(ax), region)
    if borders:
        shown = (*ax.get_xlim(), *ax.get_ylim())
        span = max(shown[1] - shown[0], shown[3] - shown[2])
        _draw_borders(flat.where(flat.size * flat.unit > span / 400), ax, shown)
    ax.set_xlabel(f"{'xyz'[others[0]]} [m]")
    ax.set_ylabel(f"{'xyz'[others[1]]} [m]")
    return ax


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
        What to show [m]; left out, where something was found.
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
        _require_dim(m, 2)
    fine, even = Cells.of(adaptive), Cells.of(fixed)
    shown = tuple(region) if region is not None else found_region(fine)
    shape = (shown[3] - shown[2]) / (shown[1] - shown[0])
    in_row = shape > 0.4 if row is None else row
    figure, axes = _panels(3, in_row, shape, width)
    _draw_borders(fine, axes[0], shown)
    _draw_occupancy(fine, axes[1], shown)
    _draw_occupancy(even, axes[2], shown)
    axes[0].set_title(_title(fine, "adaptive"))
    axes[1].set_title("the same map: occupied white, free black, unknown grey")
    axes[2].set_title(_title(even, "fixed"))
    return _written(figure, path, dpi)


def overview(
    m: OccupancyMap,
    path: Path | None = None,
    *,
    region: Region | None = None,
    color: str = "probability",
    width: float = 12.0,
    dpi: float = 150.0,
) -> Figure:
    """Draw a 2-D map: its occupancy, or its cells in the color of their size.

    Parameters
    ----------
    m : AdaptiveMap, FixedMap or OctoMap
        With ``dim`` 2.
    path : str or path, optional
        The picture to write; its ending chooses the format.
    region : (x_min, x_max, y_min, y_max), optional
        What to show [m]; left out, where something was found.
    color : {"probability", "size"}
        What the colors say.
    width : float
        Of the picture [inches].
    dpi : float
        Pixels an inch.

    Returns
    -------
    matplotlib.figure.Figure
    """
    _require_dim(m, 2)
    draw = {"probability": occupancy, "size": cell_sizes}.get(color)
    if draw is None:
        raise ValueError(f"color = {color!r}: must be probability or size where the map is 2-D")
    every = Cells.of(m)
    shown = tuple(region) if region is not None else found_region(every)
    shape = (shown[3] - shown[2]) / (shown[1] - shown[0])
    axes_width = width * (WITHOUT_BAR if color == "size" else 1.0)
    figure = Figure(figsize=(width, axes_width * shape + 0.6), layout="constrained")
    FigureCanvasAgg(figure)
    ax = draw(m, figure.add_subplot(), region=shown)
    ax.set_title(_title(every, m.refinement))
    return _written(figure, path, dpi)


def truth_by_cell_size(comparison: Comparison, ax: Axes | None = None, *, of: str = "free") -> Axes:
    """Draw how true the maps of a comparison are where the adaptive map's cells have each size.

    Parameters
    ----------
    comparison : Comparison
        With scans held out, and with an adaptive map.
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure if left out.
    of : {"free", "endpoints"}
        Free space that the maps call free, or end points at an occupied cell.

    Returns
    -------
    matplotlib.axes.Axes
        A line for each map over the cell size; bars say where the samples are.
    """
    measures = {
        "free": ("free", "samples", "free space called free"),
        "endpoints": ("endpoints_near", "endpoints", "end points at an occupied cell"),
    }
    if of not in measures:
        raise ValueError(f"of = {of!r}: must be {' or '.join(measures)}")
    by_size = comparison["truth_by_cell_size"]
    if by_size is None:
        raise ValueError("no truth by cell size: the comparison needs scans held out and an adaptive map")
    right, total, label = measures[of]
    rows = [row for row in by_size["sizes"] if row["size"] is not None and row[total]]
    if not rows:
        raise ValueError("no truth by cell size: no sample of the comparison lies in the map")
    size = np.array([row["size"] for row in rows])
    count = np.array([row[total] for row in rows], dtype=np.float64)
    ax = _axes(ax)
    ax.set_xscale("log")
    ax.bar(size, count / count.sum(), 0.3 * size, color="0.85", zorder=0, label="share of all")
    for name in rows[0][right]:
        share = np.array([row[right][name] for row in rows]) / count
        ax.plot(size, share, marker="o", markersize=4, label=name)
    ax.set_xticks(size, [f"{one:g}" for one in size])
    ax.minorticks_off()
    ax.set_ylim(0.0, 1.02)
    ax.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    ax.set_xlabel(f"cell size of the {by_size['of']} map [m]")
    ax.set_ylabel(label)
    ax.legend()
    return ax


# --- 3-D ------------------------------------------------------------------------------------------


def occupied(
    m: OccupancyMap,
    ax: Axes | None = None,
    *,
    azimuth: float = -60.0,
    elevation: float = 50.0,
    cut_above: CutAbove = "auto",
    region: Region | None = None,
    color: str = "height",
    colormap: str | None = None,
    heights: tuple[float, float] | None = None,
    finest: float = 0.0,
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
    _require_dim(m, 3)
    chosen, bounds = _chosen_cubes(Cells.of(m), region, cut_above)
    colors = coloring(chosen, color, colormap, heights)
    return _draw_cubes(chosen, bounds, _axes(ax), azimuth, elevation, colors, finest)


def projected(points: ArrayLike, *, azimuth: float = -60.0, elevation: float = 50.0) -> Floats:
    """Where points (n, 3) [m] lie in a picture of `occupied` with the same view: (n, 2) [m]."""
    return np.asarray(points, dtype=np.float64).reshape(-1, 3) @ _screen(azimuth, elevation)[1]


def side_by_side_3d(
    adaptive: OccupancyMap,
    fixed: OccupancyMap,
    path: Path | None = None,
    *,
    azimuth: float = -60.0,
    elevation: float = 50.0,
    cut_above: CutAbove = "auto",
    region: Region | None = None,
    color: str = "height",
    slice_axis: str | int = "z",
    slice_at: float | None = None,
    width: float = 16.0,
    dpi: float = 200.0,
) -> Figure:
    """Draw an adaptive and a fixed 3-D map side by side: occupied cells, seen alike, and a slice of each.

    Parameters
    ----------
    adaptive, fixed : AdaptiveMap, FixedMap or OctoMap
        With ``dim`` 3, of the same log.
    path : str or path, optional
        The picture to write; its ending chooses the format.
    azimuth, elevation, cut_above, region, color
        As for `occupied`.
    slice_axis : {"x", "y", "z", 0, 1, 2}
        The coordinate that is held in the slices.
    slice_at : float, optional
        Its value [m]; left out, half-way through what the cubes show.
    width : float
        Of the picture [inches].
    dpi : float
        Pixels an inch.

    Returns
    -------
    matplotlib.figure.Figure
        With four axes, and a bar that says what the colors mean.
    """
    maps = {"adaptive": adaptive, "fixed": fixed}
    view = (azimuth, elevation)
    return _draw_3d(maps, view, cut_above, region, color, (slice_axis, slice_at), path, width, dpi)


def overview_3d(
    m: OccupancyMap,
    path: Path | None = None,
    *,
    azimuth: float = -60.0,
    elevation: float = 50.0,
    cut_above: CutAbove = "auto",
    region: Region | None = None,
    color: str = "height",
    slice_axis: str | int = "z",
    slice_at: float | None = None,
    width: float = 12.0,
    dpi: float = 150.0,
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
    view = (azimuth, elevation)
    return _draw_3d(
        {m.refinement: m}, view, cut_above, region, color, (slice_axis, slice_at), path, width, dpi
    )


def _draw_3d(
    maps: dict[str, OccupancyMap],
    view: tuple[float, float],
    cut_above: CutAbove,
    region: Region | None,
    color: str,
    plane: tuple[str | int, float | None],
    path: Path | None,
    width: float,
    dpi: float,
) -> Figure:
    """A column for each map: its cubes, and below them its slice; the first map chooses what is shown."""
    for m in maps.values():
        _require_dim(m, 3)
    held = _axis_number(plane[0])
    every = [Cells.of(m) for m in maps.values()]
    region = tuple(region) if region is not None else found_region(every[0])
    if cut_above == "auto":
        cut_above = ceiling(every[0].where(every[0].occupied).inside(region))
    chosen = [_chosen_cubes(one, region, cut_above) for one in every]
    colors = coloring(chosen[0][0], color)
    at = plane[1]
    if at is None:
        middle = (chosen[0][0].lower[:, held] + 0.5 * chosen[0][0].size) * every[0].unit
        at = float(np.mean(np.percentile(middle, (1, 99))))
    flat_region = [edge for a in range(3) if a != held for edge in region[2 * a : 2 * a + 2]]
    corners = _bounds_on_screen(*chosen[0], *view)
    shapes = (
        (corners[3] - corners[2]) / (corners[1] - corners[0]),
        (flat_region[3] - flat_region[2]) / (flat_region[1] - flat_region[0]),
    )
    column_width = WITHOUT_BAR * width / len(maps)
    pixel = (corners[1] - corners[0]) / (column_width * dpi)
    figure = Figure(figsize=(width, column_width * sum(shapes) + 1.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, len(maps), squeeze=False, height_ratios=shapes)
    for column, (kind, m, one, whole) in enumerate(zip(maps, maps.values(), chosen, every)):
        above, below = axes[:, column]
        _framed(_draw_cubes(*one, above, *view, colors, pixel), corners)
        above.set_title(_title(whole, kind))
        slice(m, held, at, below, region=flat_region, borders=kind != "fixed")
        meaning = ": occupied white, free black, unknown grey" if len(maps) == 1 else ""
        below.set_title(f"slice at {'xyz'[held]} = {at:.2f} m{meaning}")
    _add_bar(colors.legend(), list(axes[0]), colors.label, colors.ticks, shrink=0.7)
    return _written(figure, path, dpi)


# --- Colors ---------------------------------------------------------------------------------------


class Coloring:
    """Which color a cell has, and what that means."""

    def __init__(
        self, by: str, label: str, norm: Normalize, colormap: str, ticks: Floats | None = None
    ) -> None:
        self.by, self.label, self.norm, self.ticks = by, label, norm, ticks
        ends = (0.05, 0.95) if colormap == "turbo" else (0.0, 1.0)  # Its ends are nearly black.
        self._map = _colormap(colormap)
        self._ends = ends

    def __call__(self, some: Cells) -> Floats:
        """Red, green and blue of each cell, from 0 to 1: (n, 3)."""
        values = {"height": _middle_height, "size": _edge, "probability": _probability}[self.by](some)
        level = np.clip(np.asarray(self.norm(values), dtype=np.float64), 0.0, 1.0)
        return self._map(self._ends[0] + (self._ends[1] - self._ends[0]) * level)[:, :3]

    def legend(self) -> Any:
        """What a bar beside the picture is made of."""
        from matplotlib.cm import ScalarMappable
        from matplotlib.colors import ListedColormap

        return ScalarMappable(self.norm, ListedColormap(self._map(np.linspace(*self._ends, 256))))


COLORS = ("height", "size", "probability")


def coloring(
    shown: Cells,
    by: str = "height",
    colormap: str | None = None,
    heights: tuple[float, float] | None = None,
) -> Coloring:
    """Colors for cells by "height", "size" or "probability", stretched over those that are shown."""
    if by not in COLORS:
        raise ValueError(f"color = {by!r}: must be one of {', '.join(COLORS)}")
    if by == "height":
        return Coloring(by, "height [m]", Normalize(*(heights or _heights(shown))), colormap or "turbo")
    if by == "size":
        sizes = np.unique(shown.size) * shown.unit
        norm = LogNorm(float(sizes[0]), max(float(sizes[-1]), 1.001 * float(sizes[0])))
        return Coloring(by, "cell size [m]", norm, colormap or SIZE_COLORS, sizes)
    low = 0.0 if shown.free.any() else UNKNOWN
    return Coloring(by, "probability", Normalize(low, 1.0), colormap or "plasma_r")


def _middle_height(some: Cells) -> Floats:
    return (some.lower[:, -1] + 0.5 * some.size) * some.unit


def _edge(some: Cells) -> Floats:
    return some.size * some.unit


def _probability(some: Cells) -> Floats:
    return some.probability


# --- Leaves and axes ------------------------------------------------------------------------------


def _brightness(probability: Floats) -> Floats:
    """0 for the freest cells, 1 for the most surely occupied, 0.5 for unknown: no clamp leaves white grey."""
    low, high = min(probability.min(), 0.499), max(probability.max(), 0.501)
    return np.interp(probability, (low, UNKNOWN, high), (0.0, UNKNOWN, 1.0))


def _require_dim(m: OccupancyMap, dim: int) -> None:
    if m.dim != dim:
        raise ValueError(f"the map is {m.dim}-D: this picture needs a {dim}-D map")


def _axis_number(axis: str | int) -> int:
    held = "xyz".index(axis) if axis in ("x", "y", "z") else axis
    if held not in (0, 1, 2):
        raise ValueError(f"axis = {axis!r}: must be x, y, z, 0, 1 or 2")
    return int(held)


def _add_bar(
    drawn: Any, axes: list[Axes], label: str, ticks: Floats | None = None, shrink: float = 1.0
) -> None:
    """Says beside the axes what their colors mean."""
    bar = axes[0].figure.colorbar(drawn, ax=axes, label=label, ticks=ticks, shrink=shrink, pad=0.01)
    if ticks is not None:
        bar.ax.set_yticklabels([f"{tick:g}" for tick in ticks])
        bar.ax.minorticks_off()


def _written(figure: Figure, path: Path | None, dpi: float) -> Figure:
    """The same figure, in a file if there is a path: whole or not at all."""
    figure.set_dpi(dpi)
    if path is not None:
        with replaced(path) as part:
            figure.draw_without_rendering()  # Labels have their place only after the axes have theirs.
            figure.savefig(part, dpi=dpi)
    return figure


def _axes(ax: Axes | None) -> Axes:
    if ax is not None:
        return ax
    figure = Figure(figsize=(10, 8))
    FigureCanvasAgg(figure)
    figure.subplots_adjust(left=0.08, right=0.98, bottom=0.08, top=0.95)
    return figure.add_subplot()


def _panels(count: int, in_row: bool, shape: float, width: float) -> tuple[Figure, list[Axes]]:
    """A figure of as many panels with room for titles; `shape` is a panel's height by its width."""
    gap, title = 0.1, 0.35  # [inches]
    rows, columns = (1, count) if in_row else (count, 1)
    panel_width = (width - (columns + 1) * gap) / columns
    panel_height = panel_width * shape
    height = rows * (panel_height + title) + gap
    figure = Figure(figsize=(width, height))
    FigureCanvasAgg(figure)
    axes = []
    for i in range(count):
        left = gap + (i % columns) * (panel_width + gap)
        bottom = height - (i // columns + 1) * (panel_height + title)
        place = (left / width, bottom / height, panel_width / width, panel_height / height)
        ax = figure.add_axes(place)
        ax.set_xticks([])
        ax.set_yticks([])
        axes.append(ax)
    return figure, axes


def _title(one: Cells, kind: str) -> str:
    """For example "adaptive, 0.05 to 1.6 m: 16,390 cells"."""
    low, high = (float(edge(one.size[one.observed])) * one.unit for edge in (np.min, np.max))
    sizes = f"{low:g} m" if low == high else f"{low:g} to {high:g} m"
    return f"{kind}, {sizes}: {np.count_nonzero(one.observed):,} cells"


# --- Drawing in the plane -------------------------------------------------------------------------


def _draw_borders(
    every: Cells,
    ax: Axes,
    region: Region | None,
    color: str = BORDER_COLOR,
    linewidth: float = 0.35,
) -> Axes:
    region = tuple(region) if region is not None else found_region(every)
    shown = every.inside(region)
    lines = []
    for along in (0, 1):
        for level in (shown.lower, shown.upper):
            across = 1 - along
            lines.append(np.stack([level[:, across], shown.lower[:, along], shown.upper[:, along]], axis=1))
        merged = _joined(np.concatenate(lines[-2:])) * every.unit
        points = np.empty((len(merged), 2, 2))
        points[:, :, 1 - along] = merged[:, :1]
        points[:, :, along] = merged[:, 1:]
        ax.add_collection(LineCollection(points, colors=color, linewidths=linewidth), autolim=False)
    return _framed(ax, region)


def _joined(lines: Integers) -> Integers:
    """Segments (at, from, to), with those that touch or overlap on one line made one."""
    lines = lines[np.lexsort((lines[:, 1], lines[:, 0]))]
    at, start, stop = lines.T
    line = np.cumsum(np.diff(at, prepend=at[0]) != 0)
    span = int(stop.max() - start.min()) + 1
    # Shifted by more than any length, each line's ends rise above those of the line before.
    reach = np.maximum.accumulate(stop - start.min() + line * span)
    first = np.ones(len(at), dtype=np.bool_)
    first[1:] = (start[1:] - start.min() + line[1:] * span) > reach[:-1]
    first[1:] |= line[1:] != line[:-1]
    begins = np.flatnonzero(first)
    ends = np.append(begins[1:], len(at)) - 1
    return np.stack([at[begins], start[begins], reach[ends] - line[begins] * span + start.min()], axis=1)


def _draw_occupancy(every: Cells, ax: Axes, region: Region | None) -> Axes:
    region = tuple(region) if region is not None else found_region(every)
    seen = every.where(every.observed)
    seen = replace(seen, probability=_brightness(seen.probability))
    image, extent = _image(seen.inside(region), region)
    ax.set_facecolor(str(UNKNOWN))
    drawn = _PooledImage(ax, _most_occupied, cmap="gray", norm=Normalize(0.0, 1.0), extent=extent)
    drawn.set_data(image)
    ax.add_image(drawn)
    return _framed(ax, region)


class _PooledImage(AxesImage):
    """An image drawn in pixels no smaller than those of the picture, each made of all that are in it."""

    def __init__(self, ax: Axes, pool: Callable[[Any], Any], *, extent: Sequence[float], **more: Any) -> None:
        super().__init__(ax, origin="lower", extent=extent, interpolation="nearest", **more)
        self._pool = pool
        self.set_clip_path(ax.patch)

    def draw(self, renderer: Any) -> None:
        whole = self.get_array()
        left, right, bottom, top = self.get_extent()
        ends = self.axes.transData.transform([(left, bottom), (right, top)])
        pixels = np.abs(ends[1] - ends[0]) * renderer.get_image_magnification()
        steps = [max(1, math.ceil(n / max(p, 1.0) - 1e-6)) for n, p in zip(whole.shape, pixels[::-1])]
        if steps == [1, 1]:
            super().draw(renderer)
            return
        rows, columns = (-(-n // step) for n, step in zip(whole.shape, steps))
        missing = [(0, n * step - old) for n, step, old in zip((rows, columns), steps, whole.shape)]
        padded = np.pad(np.ma.filled(whole, np.nan), missing, constant_values=np.nan)
        pooled = self._pool(padded.reshape(rows, steps[0], columns, steps[1]))
        wide = (right - left) * columns * steps[1] / whole.shape[1]
        high = (top - bottom) * rows * steps[0] / whole.shape[0]
        try:
            self.set_data(pooled)
            self.set_extent((left, left + wide, bottom, bottom + high))
            super().draw(renderer)
        finally:
            self.set_data(whole)
            self.set_extent((left, right, bottom, top))
            self.stale = False


def _most_occupied(blocks: Floats) -> Floats:
    """Of each block of pixels the most occupied, else the freest, else unknown; nan is beyond the map."""
    most, least = np.fmax.reduce(np.fmax.reduce(blocks, 3), 1), np.fmin.reduce(np.fmin.reduce(blocks, 3), 1)
    return np.where(most > UNKNOWN, most, least)


def _smallest(blocks: Floats) -> Floats:
    return np.ma.masked_invalid(np.fmin.reduce(np.fmin.reduce(blocks, 3), 1))


def _image(
    shown: Cells, region: Region, empty: float = UNKNOWN
) -> tuple[NDArray[np.float32], tuple[float, float, float, float]]:
    """Probabilities, a pixel for each smallest cell; for vast regions pixels are larger and show the largest.

    Returns the image, and where its borders are [m].
    """
    low = np.floor(np.asarray(region[0::2]) / shown.unit).astype(np.int64)
    high = np.ceil(np.asarray(region[1::2]) / shown.unit).astype(np.int64)
    step = max(1, math.ceil(math.sqrt(float(np.prod((high - low).astype(np.float64))) / MAX_IMAGE_CELLS)))
    width, height = (int(n) for n in -(-(high - low) // step))
    image = np.full((height, width), -1.0, dtype=np.float32)
    flat = image.reshape(-1)
    begin = np.clip((shown.lower - low) // step, 0, (width, height))
    end = np.clip(-(-(shown.upper - low) // step), 0, (width, height))
    extents = end - begin
    kind = extents[:, 0] * (height + 1) + extents[:, 1]
    order = np.argsort(kind, kind="stable")
    for alike in np.split(order, np.flatnonzero(np.diff(kind[order])) + 1):
        shape = extents[alike[0]] if len(alike) else np.zeros(2, dtype=np.int64)
        if not shape.all():
            continue
        offsets = (np.arange(shape[1])[:, None] * width + np.arange(shape[0])).ravel()
        for part in np.array_split(alike, max(1, len(alike) * len(offsets) // 4_000_000)):
            corner = begin[part, 1] * width + begin[part, 0]
            pixels = corner[:, None] + offsets
            np.maximum.at(flat, pixels, shown.probability[part, None].astype(np.float32))
    image[image < 0] = empty
    left, bottom = low * shown.unit
    extent = (left, left + width * step * shown.unit, bottom, bottom + height * step * shown.unit)
    return image, extent


def _framed(ax: Axes, region: Region) -> Axes:
    ax.set_aspect("equal")
    ax.set_xlim(region[0], region[1])
    ax.set_ylim(region[2], region[3])
    return ax


# --- Drawing cubes --------------------------------------------------------------------------------


def _chosen_cubes(every: Cells, region: Region | None, cut_above: CutAbove) -> tuple[Cells, Region]:
    """Occupied leaves to be shown, and the bounds [m] to which they are cut."""
    cubes = every.where(every.occupied)
    if not len(cubes.size):
        raise ValueError("the map has no occupied cells that could be drawn")
    bounds = list(region if region is not None else found_region(every))
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


def _heights(cubes: Cells) -> tuple[float, float]:
    middle = (cubes.lower[:, 2] + 0.5 * cubes.size) * cubes.unit
    low, high = np.percentile(middle, (1, 99))
    return float(low), float(max(high, low + cubes.unit))


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


def _bounds_on_screen(cubes: Cells, bounds: Region, azimuth: float, elevation: float) -> tuple[float, ...]:
    """What the cubes take up in the picture [m], and a little more."""
    _, screen = _screen(azimuth, elevation)
    lower, upper = _clipped(cubes, bounds)
    middle, half = 0.5 * (lower + upper) @ screen, 0.5 * (upper - lower) @ np.abs(screen)
    low, high = (middle - half).min(axis=0), (middle + half).max(axis=0)
    margin = 0.01 * float(np.max(high - low))
    return (low[0] - margin, high[0] + margin, low[1] - margin, high[1] + margin)


def _draw_cubes(
    cubes: Cells,
    bounds: Region,
    ax: Axes,
    azimuth: float,
    elevation: float,
    colors: Coloring,
    finest: float,
) -> Axes:
    """Cells that are smaller than `finest` [m] are drawn as large, in their mean color."""
    frame = _bounds_on_screen(cubes, bounds, azimuth, elevation)
    to_viewer, screen = _screen(azimuth, elevation)
    fills = colors(cubes)
    if finest >= cubes.unit:
        steps = int(math.log(finest / cubes.unit * 1.000001, cubes.branching))
        joined, number = coarsened(cubes, cubes.branching**steps)
        count = np.bincount(number)[:, None]
        fills = np.stack([np.bincount(number, fills[:, k]) for k in range(3)], axis=1) / count
        cubes = joined
    order = _far_to_near(cubes, to_viewer)
    cubes, fills = cubes.where(order), fills[order]
    side = np.where(to_viewer >= 0, 1, -1)
    shades = 0.62 + 0.38 * np.array([0.15, 0.5, 1.0])
    covered = covered_faces(cubes)
    lower, upper = _clipped(cubes, bounds)
    faces, face_colors, order = [], [], []
    for axis in range(3):
        if abs(to_viewer[axis]) < 1e-9:
            continue
        open_ = np.flatnonzero(~covered[:, axis, int(side[axis] > 0)])
        low, high = lower[open_], upper[open_]
        quad = np.repeat(low[:, None, :], 4, axis=1)
        if side[axis] > 0:
            quad[:, :, axis] = high[:, None, axis]
        one, two = (b for b in range(3) if b != axis)
        quad[:, 1:3, one] = high[:, None, one]
        quad[:, 2:4, two] = high[:, None, two]
        faces.append(quad @ screen)
        face_colors.append(fills[open_] * shades[axis])
        order.append(open_)
    # A cube's own faces do not hide each other, so that only the order of the cubes counts.
    sequence = np.argsort(np.concatenate(order), kind="stable")
    quads = np.concatenate(faces)[sequence]
    fill = np.concatenate(face_colors)[sequence]
    polygons = PolyCollection(quads, facecolors=fill, edgecolors=0.8 * fill, linewidths=0.25)
    polygons.set_rasterized(len(quads) > MAX_VECTOR_FACES)
    ax.add_collection(polygons, autolim=False)
    _framed(ax, frame)
    ax.set_axis_off()
    return ax


def _colormap(name: str) -> Any:
    from matplotlib import colormaps

    return colormaps[name]


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
