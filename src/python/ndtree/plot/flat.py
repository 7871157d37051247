# SPDX-License-Identifier: BSD-3-Clause
"""A 2-D map, or a slice of a 3-D map, in one ``Axes``."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm

from ndtree._native._core import OccupancyMap
from ndtree.cells.lattice import Cells, cells_through
from ndtree.cells.regions import picture_region
from ndtree.plot.colors import name_axes
from ndtree.plot.figures import (
    BORDER_COLOR,
    SIZE_COLORS,
    UNKNOWN,
    Region,
    add_bar,
    axes_or_new,
    axis_number,
    colormap_of,
    framed,
    require_dim,
)
from ndtree.plot.images import PooledImage, draw_borders, draw_occupancy, image_of, smallest_of


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
    m, ax, region
        As for `occupancy`.
    color : str
        Of the lines.
    linewidth : float
        Of the lines [points].
    """
    require_dim(m, 2)
    return _named(draw_borders(Cells.of(m), axes_or_new(ax), region, color, linewidth), ax)


def occupancy(
    m: OccupancyMap,
    ax: Axes | None = None,
    *,
    region: Region | None = None,
    borders: bool = False,
    color: str = "state",
) -> Axes:
    """Draw a 2-D map: occupied black, free white, unknown grey, as map_server and RViz do.

    A pixel of the picture that has an occupied cell in it is drawn occupied, however small the cell.

    Parameters
    ----------
    m : AdaptiveMap, FixedMap or OctoMap
        With ``dim`` 2.
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure if left out.
    region : (x_min, x_max, y_min, y_max), optional
        What to show [m]; left out, what was observed.
    borders : bool
        Draw the leaves' borders, too.
    color : {"state", "probability"}
        What greys say: the state alone, or the probability, in levels between these three.
    """
    require_dim(m, 2)
    every = Cells.of(m)
    drawn = draw_occupancy(every, axes_or_new(ax), region, color)
    if borders:
        draw_borders(every, drawn, (*drawn.get_xlim(), *drawn.get_ylim()))
    return _named(drawn, ax)


def cell_sizes(
    m: OccupancyMap, ax: Axes | None = None, *, region: Region | None = None, colormap: str = SIZE_COLORS
) -> Axes:
    """Draw a 2-D map with each observed cell in the color of its size; a pixel shows its smallest cell.

    Parameters
    ----------
    m, ax, region
        As for `occupancy`.
    colormap : str
        Of matplotlib.

    Returns
    -------
    matplotlib.axes.Axes
        With a bar beside it that says which color is which size.
    """
    require_dim(m, 2)
    every, given, ax = Cells.of(m), ax, axes_or_new(ax)
    region = tuple(region) if region is not None else picture_region(every)
    shown = every.where(every.observed).inside(region)
    largest = float(every.size[every.observed].max()) * every.unit
    # The image keeps the largest value of a pixel: sizes go in as their inverses.
    image, extent = image_of(replace(shown, probability=1.0 / (shown.size * every.unit)), region, empty=0.0)
    with np.errstate(divide="ignore"):
        sizes = np.ma.masked_invalid(1.0 / image)
    colors = colormap_of(colormap).with_extremes(bad=str(UNKNOWN))
    norm = LogNorm(every.unit, max(largest, 1.001 * every.unit))
    drawn = PooledImage(ax, smallest_of, cmap=colors, norm=norm, extent=extent)
    drawn.set_data(sizes)
    ax.add_image(drawn)
    add_bar(drawn, [ax], "cell size [m]", np.unique(every.size[every.observed]) * every.unit)
    return _named(framed(ax, region), given)


def slice(
    m: OccupancyMap,
    axis: str | int | None = None,
    value: float | None = None,
    ax: Axes | None = None,
    *,
    x: float | None = None,
    y: float | None = None,
    z: float | None = None,
    region: Region | None = None,
    borders: bool = False,
) -> Axes:
    """Draw the plane through a 3-D map where one coordinate has a value.

    Parameters
    ----------
    m : AdaptiveMap, FixedMap or OctoMap
        With ``dim`` 3.
    axis : {"x", "y", "z", 0, 1, 2}, optional
        The coordinate that is held.
    value : float, optional
        Its value [m].
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure if left out.
    x, y, z : float, optional
        One of them instead of `axis` and `value`, as in ``slice(m, z=1.0)`` [m].
    region : (min, max, min, max), optional
        What to show of the other two coordinates [m]; left out, what was observed.
    borders : bool
        Draw the leaves' borders, too, but not of leaves so small that nothing else would be seen.
    """
    require_dim(m, 3)
    held, value = _held(axis, value, {"x": x, "y": y, "z": z})
    others = [a for a in range(3) if a != held]
    flat = cells_through(m, held, value).along(others)
    if not flat.observed.any():
        raise ValueError(f"{'xyz'[held]} = {value:g} m: the map was not observed there")
    ax = draw_occupancy(flat, axes_or_new(ax), region)
    if borders:
        shown = (*ax.get_xlim(), *ax.get_ylim())
        span = max(shown[1] - shown[0], shown[3] - shown[2])
        draw_borders(flat.where(flat.size * flat.unit > span / 400), ax, shown)
    name_axes(ax, "".join("xyz"[a] for a in others))
    return ax


def _held(axis: str | int | None, value: float | None, by_name: dict[str, float | None]) -> tuple[int, float]:
    """The axis that is held and its value, from `slice`'s two ways to say so."""
    named = {name: at for name, at in by_name.items() if at is not None}
    if axis is not None and value is not None and not named:
        return axis_number(axis), value
    if axis is None and value is None and len(named) == 1:
        ((name, at),) = named.items()
        return axis_number(name), at
    given = [*named, *(["axis"] if axis is not None else []), *(["value"] if value is not None else [])]
    raise ValueError(
        f"slice(): {' and '.join(given) or 'nothing'} given, expected one of x, y and z, or axis and value"
    )


def _named(ax: Axes, given: Axes | None) -> Axes:
    """Axes of a figure of ours have names; others are their owner's."""
    if given is None:
        name_axes(ax)
    return ax
