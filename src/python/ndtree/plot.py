# SPDX-License-Identifier: BSD-3-Clause
"""Pictures of maps in the paper's style (Figs. 4 to 6): leaves, occupancy, slices, occupied cells in 3-D."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Union

import numpy as np
from numpy.typing import NDArray

from ndtree._core import Leaves, OccupancyMap

try:
    from matplotlib.axes import Axes
    from matplotlib.backend_bases import FigureCanvasBase
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.collections import LineCollection, PolyCollection
    from matplotlib.figure import Figure
except ImportError as error:
    raise ImportError(
        f"ndtree.plot needs matplotlib ({error}); install it with: pip install 'ndtree-mapping[plot]'"
    ) from None

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Region = Sequence[float]
CutAbove = Union[float, str, None]

#: Endings of picture files.
FORMATS = tuple(f".{ending}" for ending in sorted(FigureCanvasBase.get_supported_filetypes()))
MAX_IMAGE_CELLS = 16_000_000
UNKNOWN = 0.5
BORDER_COLOR = "#2b5c8a"


@dataclass(frozen=True)
class _Cells:
    """Leaves on the lattice of the smallest: corners and edges in whole units of `unit` metres."""

    unit: float
    lower: Integers  # (n, dim)
    size: Integers  # (n,)
    probability: Floats  # (n,)
    observed: NDArray[np.bool_]  # (n,)
    hits: Integers  # (n,)

    def where(self, chosen: NDArray[np.bool_]) -> _Cells:
        return replace(
            self,
            lower=self.lower[chosen],
            size=self.size[chosen],
            probability=self.probability[chosen],
            observed=self.observed[chosen],
            hits=self.hits[chosen],
        )

    def along(self, axes: Sequence[int]) -> _Cells:
        """The same cells with some of their axes only."""
        return replace(self, lower=self.lower[:, list(axes)])

    @property
    def upper(self) -> Integers:
        return self.lower + self.size[:, None]

    @property
    def occupied(self) -> NDArray[np.bool_]:
        return self.probability > UNKNOWN


# --- 2-D ------------------------------------------------------------------------------------------


def cells(
    m: OccupancyMap, ax: Axes | None = None, *, region: Region | None = None, color: str = BORDER_COLOR
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

    Returns
    -------
    matplotlib.axes.Axes
    """
    _require_dim(m, 2)
    return _draw_borders(_cells_of(m), _axes(ax), region, color)


def occupancy(m: OccupancyMap, ax: Axes | None = None, *, region: Region | None = None) -> Axes:
    """Draw a 2-D map: occupied white, free black, unknown grey, as in the paper's Figs. 4b and 4c.

    Parameters
    ----------
    m : AdaptiveMap, FixedMap or OctoMap
        With ``dim`` 2.
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure if left out.
    region : (x_min, x_max, y_min, y_max), optional
        What to show [m]; left out, where something was found.

    Returns
    -------
    matplotlib.axes.Axes
    """
    _require_dim(m, 2)
    return _draw_occupancy(_cells_of(m), _axes(ax), region)


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
        Draw the leaves' borders, too.

    Returns
    -------
    matplotlib.axes.Axes
    """
    _require_dim(m, 3)
    held = "xyz".index(axis) if axis in ("x", "y", "z") else axis
    if held not in (0, 1, 2):
        raise ValueError(f"axis = {axis!r}: must be x, y, z, 0, 1 or 2")
    every = _cells_of(m)
    at = math.floor(value / every.unit)
    cut = every.where((every.lower[:, held] <= at) & (at < every.upper[:, held]))
    others = [a for a in range(3) if a != held]
    flat = cut.along(others)
    if not flat.observed.any():
        raise ValueError(f"{'xyz'[held]} = {value:g} m: the map was not observed there")
    ax = _draw_occupancy(flat, _axes(ax), region)
    if borders:
        _draw_borders(flat, ax, (*ax.get_xlim(), *ax.get_ylim()), BORDER_COLOR)
    ax.set_xlabel(f"{'xyz'[others[0]]} [m]")
    ax.set_ylabel(f"{'xyz'[others[1]]} [m]")
    return ax


def side_by_side(
    adaptive: OccupancyMap,
    fixed: OccupancyMap,
    path: str | os.PathLike[str],
    *,
    region: Region | None = None,
    row: bool | None = None,
    width: float = 16.0,
    dpi: float = 200.0,
) -> None:
    """Write one picture with an adaptive map's leaves and occupancy, and a fixed map's occupancy (Fig. 4).

    Parameters
    ----------
    adaptive, fixed : AdaptiveMap, FixedMap or OctoMap
        With ``dim`` 2, of the same log.
    path : str or path
        The picture; its ending chooses the format.
    region : (x_min, x_max, y_min, y_max), optional
        What to show [m]; left out, where something was found.
    row : bool, optional
        The panels in a row, or one below the other. Left out, as suits the region's shape.
    width : float
        Of the picture [inches].
    dpi : float
        Pixels an inch.
    """
    for m in (adaptive, fixed):
        _require_dim(m, 2)
    fine, even = _cells_of(adaptive), _cells_of(fixed)
    shown = tuple(region) if region is not None else _found(fine)
    shape = (shown[3] - shown[2]) / (shown[1] - shown[0])
    in_row = shape > 0.4 if row is None else row
    figure, axes = _panels(3, in_row, shape, width)
    _draw_borders(fine, axes[0], shown, BORDER_COLOR)
    _draw_occupancy(fine, axes[1], shown)
    _draw_occupancy(even, axes[2], shown)
    axes[0].set_title(_title(fine, "adaptive"))
    axes[1].set_title("the same map: occupied white, free black, unknown grey")
    axes[2].set_title(_title(even, "fixed"))
    figure.savefig(path, dpi=dpi)


# --- 3-D ------------------------------------------------------------------------------------------


def occupied(
    m: OccupancyMap,
    ax: Axes | None = None,
    *,
    azimuth: float = -60.0,
    elevation: float = 50.0,
    cut_above: CutAbove = "auto",
    region: Region | None = None,
    colormap: str = "turbo",
    heights: tuple[float, float] | None = None,
) -> Axes:
    """Draw the occupied leaves of a 3-D map as cubes, coloured by height, as in the paper's Figs. 5 and 6.

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
    colormap : str
        Of matplotlib.
    heights : (float, float), optional
        Where the colours begin and end [m]; left out, where the cells do.

    Returns
    -------
    matplotlib.axes.Axes
        Without frame; its coordinates are metres in the plane of the picture.
    """
    _require_dim(m, 3)
    chosen, bounds = _chosen_cubes(_cells_of(m), region, cut_above)
    return _draw_cubes(chosen, bounds, _axes(ax), azimuth, elevation, colormap, heights or _heights(chosen))


def side_by_side_3d(
    adaptive: OccupancyMap,
    fixed: OccupancyMap,
    path: str | os.PathLike[str],
    *,
    azimuth: float = -60.0,
    elevation: float = 50.0,
    cut_above: CutAbove = "auto",
    region: Region | None = None,
    slice_at: float | None = None,
    width: float = 16.0,
    dpi: float = 200.0,
) -> None:
    """Write one picture of an adaptive and a fixed 3-D map: occupied cells, seen alike, and a level slice.

    Parameters
    ----------
    adaptive, fixed : AdaptiveMap, FixedMap or OctoMap
        With ``dim`` 3, of the same log.
    path : str or path
        The picture; its ending chooses the format.
    azimuth, elevation, cut_above, region
        As for `occupied`.
    slice_at : float, optional
        Height of the slices [m]; left out, half-way up what the cubes show.
    width : float
        Of the picture [inches].
    dpi : float
        Pixels an inch.
    """
    maps = {"adaptive": adaptive, "fixed": fixed}
    _draw_3d(maps, path, azimuth, elevation, cut_above, region, slice_at, width, dpi)


def overview_3d(
    m: OccupancyMap,
    path: str | os.PathLike[str],
    *,
    azimuth: float = -60.0,
    elevation: float = 50.0,
    cut_above: CutAbove = "auto",
    region: Region | None = None,
    slice_at: float | None = None,
    width: float = 12.0,
    dpi: float = 150.0,
) -> None:
    """Write one picture of a 3-D map: its occupied cells above, a level slice with the leaves below.

    Parameters
    ----------
    m : AdaptiveMap, FixedMap or OctoMap
        With ``dim`` 3.
    path, azimuth, elevation, cut_above, region, slice_at, width, dpi
        As for `side_by_side_3d`.
    """
    _draw_3d({"occupied": m}, path, azimuth, elevation, cut_above, region, slice_at, width, dpi)


def _draw_3d(
    maps: dict[str, OccupancyMap],
    path: str | os.PathLike[str],
    azimuth: float,
    elevation: float,
    cut_above: CutAbove,
    region: Region | None,
    slice_at: float | None,
    width: float,
    dpi: float,
) -> None:
    """A column for each map: its cubes, and below them its slice; the first map chooses what is shown."""
    for m in maps.values():
        _require_dim(m, 3)
    every = [_cells_of(m) for m in maps.values()]
    region = tuple(region) if region is not None else _found(every[0])
    if cut_above == "auto":
        cut_above = _ceiling(_inside(every[0].where(every[0].occupied), region))
    chosen = [_chosen_cubes(one, region, cut_above) for one in every]
    heights = _heights(chosen[0][0])
    if slice_at is None:
        slice_at = 0.5 * (heights[0] + heights[1])
    probe = _draw_cubes(*chosen[0], _axes(None), azimuth, elevation, "turbo", heights)
    shapes = (
        float(np.ptp(probe.get_ylim()) / np.ptp(probe.get_xlim())),
        (region[3] - region[2]) / (region[1] - region[0]),
    )
    figure = Figure(figsize=(width, width / len(maps) * sum(shapes) + 1.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, len(maps), squeeze=False, height_ratios=shapes)
    for column, (kind, m, one, whole) in enumerate(zip(maps, maps.values(), chosen, every)):
        above, below = axes[:, column]
        _draw_cubes(*one, above, azimuth, elevation, "turbo", heights)
        above.set_xlim(probe.get_xlim())
        above.set_ylim(probe.get_ylim())
        above.set_title(_title(whole, kind))
        slice(m, "z", slice_at, below, region=region[:4], borders=kind != "fixed")
        below.set_title(f"slice at z = {slice_at:.2f} m: occupied white, free black, unknown grey")
    figure.savefig(path, dpi=dpi)


# --- Leaves and axes ------------------------------------------------------------------------------


def _cells_of(m: OccupancyMap) -> _Cells:
    leaves: Leaves = m.leaves()
    size = np.asarray(leaves.size, dtype=np.float64)
    if not size.size or not np.any(leaves.observed):
        raise ValueError("the map is empty: nothing was inserted that could be drawn")
    unit = float(size.min())
    return _Cells(
        unit,
        np.rint(np.asarray(leaves.lower) / unit).astype(np.int64),
        np.rint(size / unit).astype(np.int64),
        np.asarray(leaves.probability, dtype=np.float64),
        np.asarray(leaves.observed, dtype=np.bool_),
        np.asarray(leaves.hits, dtype=np.int64),
    )


def _brightness(probability: Floats) -> Floats:
    """0 for the freest cells, 1 for the most surely occupied, 0.5 for unknown: no clamp leaves white grey."""
    low, high = min(probability.min(), 0.499), max(probability.max(), 0.501)
    return np.interp(probability, (low, UNKNOWN, high), (0.0, UNKNOWN, 1.0))


def _require_dim(m: OccupancyMap, dim: int) -> None:
    if m.dim != dim:
        raise ValueError(f"the map is {m.dim}-D: this picture needs a {dim}-D map")


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


def _found(every: _Cells) -> tuple[float, ...]:
    """Bounds [m] of what was found: nearly all occupied cells, and some more; few strays are left out."""
    hit = every.where(every.occupied & (every.hits > 0))
    if not len(hit.size):
        hit = every.where(every.occupied)
    if not len(hit.size):
        hit = every.where(every.observed)
    weight = np.maximum(hit.hits, 1).astype(np.float64)
    seen = every.where(every.observed)
    bounds: list[float] = []
    for a in range(every.lower.shape[1]):
        # Half a cell is enough: what was hit is in it, and large cells reach far behind it.
        middle = hit.lower[:, a] + hit.size // 2
        low, high = (_quantile(middle, weight, share) for share in (0.002, 0.998))
        margin = 0.03 * (high - low) + 2.0
        bounds.append(max(low - margin, float(seen.lower[:, a].min())) * every.unit)
        bounds.append(min(high + margin, float(seen.upper[:, a].max())) * every.unit)
    return tuple(bounds)


def _quantile(values: Integers, weights: Floats, share: float) -> float:
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, share * total[-1])])


def _inside(cubes: _Cells, region: Region) -> _Cells:
    """Cells that touch a region [m]."""
    keep = np.ones(len(cubes.size), dtype=np.bool_)
    for a in range(cubes.lower.shape[1]):
        keep &= cubes.upper[:, a] * cubes.unit > region[2 * a]
        keep &= cubes.lower[:, a] * cubes.unit < region[2 * a + 1]
    return cubes.where(keep)


def _title(one: _Cells, kind: str) -> str:
    """For example "adaptive, 0.05 to 1.6 m: 16,390 cells"."""
    low, high = (float(edge(one.size[one.observed])) * one.unit for edge in (np.min, np.max))
    sizes = f"{low:g} m" if low == high else f"{low:g} to {high:g} m"
    return f"{kind}, {sizes}: {np.count_nonzero(one.observed):,} cells"


# --- Drawing in the plane -------------------------------------------------------------------------


def _draw_borders(every: _Cells, ax: Axes, region: Region | None, color: str) -> Axes:
    region = tuple(region) if region is not None else _found(every)
    shown = _inside(every, region)
    lines = []
    for along in (0, 1):
        for level in (shown.lower, shown.upper):
            across = 1 - along
            lines.append(np.stack([level[:, across], shown.lower[:, along], shown.upper[:, along]], axis=1))
        merged = _joined(np.concatenate(lines[-2:])) * every.unit
        points = np.empty((len(merged), 2, 2))
        points[:, :, 1 - along] = merged[:, :1]
        points[:, :, along] = merged[:, 1:]
        ax.add_collection(LineCollection(points, colors=color, linewidths=0.35), autolim=False)
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


def _draw_occupancy(every: _Cells, ax: Axes, region: Region | None) -> Axes:
    region = tuple(region) if region is not None else _found(every)
    seen = every.where(every.observed)
    seen = replace(seen, probability=_brightness(seen.probability))
    image, extent = _image(_inside(seen, region), region)
    ax.set_facecolor(str(UNKNOWN))
    ax.imshow(image, cmap="gray", vmin=0.0, vmax=1.0, origin="lower", extent=extent)
    return _framed(ax, region)


def _image(shown: _Cells, region: Region) -> tuple[NDArray[np.float32], tuple[float, float, float, float]]:
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
    image[image < 0] = UNKNOWN
    left, bottom = low * shown.unit
    extent = (left, left + width * step * shown.unit, bottom, bottom + height * step * shown.unit)
    return image, extent


def _framed(ax: Axes, region: Region) -> Axes:
    ax.set_aspect("equal")
    ax.set_xlim(region[0], region[1])
    ax.set_ylim(region[2], region[3])
    return ax


# --- Drawing cubes --------------------------------------------------------------------------------


def _chosen_cubes(every: _Cells, region: Region | None, cut_above: CutAbove) -> tuple[_Cells, Region]:
    """Occupied leaves to be shown, and the bounds [m] to which they are cut."""
    cubes = every.where(every.occupied)
    if not len(cubes.size):
        raise ValueError("the map has no occupied cells that could be drawn")
    bounds = list(region if region is not None else _found(every))
    cubes = _inside(cubes, bounds)
    if cut_above == "auto":
        cut_above = _ceiling(cubes)
    if isinstance(cut_above, str):
        raise ValueError(f"cut_above = {cut_above!r}: must be a height in metres, 'auto' or None")
    if cut_above is not None:
        bounds[5] = min(bounds[5], cut_above)
        cubes = _inside(cubes, bounds)
    if not len(cubes.size):
        raise ValueError(f"region = {tuple(bounds)}: no occupied cell is in it")
    return cubes, bounds


def _ceiling(cubes: _Cells) -> float | None:
    """Height [m] just below a ceiling: a layer much wider than what is around it, with little above.

    Only small cells are looked at: large ones stand for whole regions behind surfaces.
    """
    small = cubes.where(cubes.size <= 4 * cubes.size.min())
    area = small.size.astype(np.float64) ** 2
    bottom = int(_quantile(small.lower[:, 2], area, 0.001))
    layers = int(_quantile(small.upper[:, 2], area, 0.999)) - bottom
    if not 4 <= layers <= 1_000_000:
        return None
    begin = np.clip(small.lower[:, 2] - bottom, 0, layers)
    end = np.clip(small.upper[:, 2] - bottom, 0, layers)
    width = np.bincount(begin, area, layers + 1) - np.bincount(end, area, layers + 1)
    lower, upper = np.split(np.cumsum(width)[:layers], [layers // 2])
    peak = int(upper.argmax())
    is_wide = upper[peak] >= 0.25 * lower.max() and upper[peak] >= 2.0 * np.median(upper)
    is_top = upper[peak + 4 :].sum() <= 0.05 * (lower.sum() + upper.sum())
    if not (is_wide and is_top):
        return None
    rise = np.flatnonzero(upper[: peak + 1] < 0.3 * upper[peak])
    first = int(rise[-1]) + 1 if len(rise) else 0
    return float((bottom + layers // 2 + first) * cubes.unit)


def _heights(cubes: _Cells) -> tuple[float, float]:
    middle = (cubes.lower[:, 2] + 0.5 * cubes.size) * cubes.unit
    low, high = np.percentile(middle, (1, 99))
    return float(low), float(max(high, low + cubes.unit))


def _draw_cubes(
    cubes: _Cells,
    bounds: Region,
    ax: Axes,
    azimuth: float,
    elevation: float,
    colormap: str,
    heights: tuple[float, float],
) -> Axes:
    a, e = math.radians(azimuth), math.radians(elevation)
    to_viewer = np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])
    right = np.array([-math.sin(a), math.cos(a), 0.0])
    up = np.cross(to_viewer, right)
    screen = np.stack([right, up], axis=1)

    cubes = cubes.where(_far_to_near(cubes, to_viewer))
    side = np.where(to_viewer >= 0, 1, -1)
    shades = 0.62 + 0.38 * np.array([0.15, 0.5, 1.0])
    middle = (cubes.lower[:, 2] + 0.5 * cubes.size) * cubes.unit
    level = np.clip((middle - heights[0]) / (heights[1] - heights[0]), 0.0, 1.0)
    colors = _colormap(colormap)(0.05 + 0.9 * level)[:, :3]

    lower = np.maximum(cubes.lower * cubes.unit, np.asarray(bounds[0::2], dtype=np.float64))
    upper = np.minimum(cubes.upper * cubes.unit, np.asarray(bounds[1::2], dtype=np.float64))
    faces, face_colors, order = [], [], []
    for axis in range(3):
        if abs(to_viewer[axis]) < 1e-9:
            continue
        open_ = np.flatnonzero(_is_open(cubes, axis, int(side[axis])))
        low, high = lower[open_], upper[open_]
        quad = np.repeat(low[:, None, :], 4, axis=1)
        if side[axis] > 0:
            quad[:, :, axis] = high[:, None, axis]
        one, two = (b for b in range(3) if b != axis)
        quad[:, 1:3, one] = high[:, None, one]
        quad[:, 2:4, two] = high[:, None, two]
        faces.append(quad @ screen)
        face_colors.append(colors[open_] * shades[axis])
        order.append(open_)
    # A cube's own faces do not hide each other, so that only the order of the cubes counts.
    sequence = np.argsort(np.concatenate(order), kind="stable")
    quads = np.concatenate(faces)[sequence]
    fill = np.concatenate(face_colors)[sequence]
    ax.add_collection(
        PolyCollection(quads, facecolors=fill, edgecolors=0.8 * fill, linewidths=0.25), autolim=False
    )
    low, high = quads.reshape(-1, 2).min(axis=0), quads.reshape(-1, 2).max(axis=0)
    margin = 0.01 * float(np.max(high - low))
    _framed(ax, (low[0] - margin, high[0] + margin, low[1] - margin, high[1] + margin))
    ax.set_axis_off()
    return ax


def _colormap(name: str) -> Any:
    from matplotlib import colormaps

    return colormaps[name]


def _far_to_near(cubes: _Cells, to_viewer: Floats) -> Integers:
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


def _is_open(cubes: _Cells, axis: int, side: int) -> NDArray[np.bool_]:
    """Whether a cube's face is not covered by one occupied neighbour of its size or larger."""
    beyond = cubes.lower.copy()
    beyond[:, axis] += cubes.size if side > 0 else -1
    covered = np.zeros(len(cubes.size), dtype=np.bool_)
    base = cubes.lower.min(axis=0) - cubes.size.max()
    span = cubes.upper.max(axis=0) + cubes.size.max() - base
    for size in np.unique(cubes.size):
        keys = _keys(cubes.lower[cubes.size == size] // size, base // size, span // size + 2)
        candidates = np.flatnonzero(cubes.size <= size)
        wanted = _keys(beyond[candidates] // size, base // size, span // size + 2)
        covered[candidates] |= np.isin(wanted, keys)
    return ~covered


def _keys(cell: Integers, base: Integers, span: Integers) -> Integers:
    """One number for each position on a lattice."""
    c = cell - base
    return (c[:, 0] * span[1] + c[:, 1]) * span[2] + c[:, 2]
