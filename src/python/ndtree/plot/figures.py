# SPDX-License-Identifier: BSD-3-Clause
"""What all pictures have in common: figures, axes, titles, bars of colors, and files."""

from __future__ import annotations

import io
import math
import os
from collections.abc import Sequence
from typing import Any, Union

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backend_bases import FigureCanvasBase
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from ndtree._native._core import OccupancyMap
from ndtree.base.files import replaced
from ndtree.cells.lattice import Cells, Floats, observed_sizes

Region = Sequence[float]
Path = Union[str, "os.PathLike[str]"]
CutAbove = Union[float, str, None]
#: Endings of picture files.
FORMATS = tuple(f".{ending}" for ending in sorted(FigureCanvasBase.get_supported_filetypes()))
UNKNOWN = 0.5
#: Grey of each state, 0 to 1, as ROS's map_server and RViz have it.
STATE_COLORS = {"occupied": "0.0", "free": str(254 / 255), "unknown": str(205 / 255)}
BORDER_COLOR = "#2b5c8a"
SIZE_COLORS = "viridis_r"
_NOTEBOOK_DPI = 72
#: Of a picture, whatever it shows: more dots an inch than fit into it are not drawn.
MAX_PIXELS = 30_000_000
#: A panel is at most this many times as high as wide, and the other way round.
MOST_LONG = 8.0
WITHOUT_BAR = 0.9  # Share of a picture's width that is left beside a bar of colors.


#: What users call maps by the names of their refinements; others are called by these.
_KINDS = {"evidence": "adaptive", "paper": "adaptive, by the paper's rules", "octomap": "OctoMap"}


def kind_of(refinement: str) -> str:
    """What a map is called in pictures and on pages."""
    return _KINDS.get(refinement, refinement)


def require_dim(m: OccupancyMap, dim: int) -> None:
    if m.dim != dim:
        call = {2: "plot.occupancy(m)", 3: "plot.slice(m, z=1.0)"}.get(m.dim)
        instead = f"; of a {m.dim}-D map:\n  ndtree.{call}" if call else ""
        raise ValueError(f"the map is {m.dim}-D: this picture needs a {dim}-D map{instead}")


def axis_number(axis: str | int) -> int:
    held = "xyz".index(axis) if axis in ("x", "y", "z") else axis
    if held not in (0, 1, 2):
        raise ValueError(f"axis = {axis!r}: must be x, y, z, 0, 1 or 2")
    return int(held)


def add_bar(
    drawn: Any, axes: list[Axes], label: str, ticks: Floats | None = None, shrink: float = 1.0
) -> None:
    """Says beside the axes what their colors mean."""
    bar = axes[0].figure.colorbar(drawn, ax=axes, label=label, ticks=ticks, shrink=shrink, pad=0.01)
    if ticks is not None:
        bar.ax.set_yticklabels([f"{tick:g}" for tick in ticks])
        bar.ax.minorticks_off()


def written(figure: Figure, path: Path | None, dpi: float) -> Figure:
    """The same figure, in a file if there is a path: whole or not at all, and of at most `MAX_PIXELS`.

    It is drawn into memory first, so that ending the program while it draws leaves no hidden file.
    """
    dpi = min(dpi, math.sqrt(MAX_PIXELS / float(np.prod(figure.get_size_inches()))))
    figure.set_dpi(dpi)
    if path is not None:
        drawn = io.BytesIO()
        layout = figure.get_layout_engine()
        for _ in range(2):  # Labels have their place only after the axes have theirs.
            _place(figure)
        try:
            figure.set_layout_engine(None)  # With one, saving would draw all once more.
            figure.savefig(drawn, dpi=dpi, format=os.path.splitext(path)[1][1:].lower() or "png")
        finally:
            figure.set_layout_engine(layout)
        with replaced(path) as part:
            part.write_bytes(drawn.getbuffer())
    return figure


def _place(figure: Figure) -> None:
    """Lays out what is drawn, without its large parts: these take the room that their axes have."""
    large = [part for ax in figure.axes for part in (*ax.get_images(), *ax.collections)]
    images = [part for part in large if part.get_visible()]
    for image in images:
        image.set_visible(False)
    try:
        figure.draw_without_rendering()
    finally:
        for image in images:
            image.set_visible(True)


def shape_of(region: Region) -> float:
    """Height of a panel that shows a region, by its width: of very long ones it has room at their sides."""
    return float(np.clip((region[3] - region[2]) / (region[1] - region[0]), 1 / MOST_LONG, MOST_LONG))


class Picture(Figure):
    """A figure that nothing holds but its user, and that notebooks show at the end of a cell."""

    def __init__(self, **keywords: Any) -> None:
        super().__init__(**keywords)
        FigureCanvasAgg(self)

    def _repr_png_(self) -> bytes:
        drawn = io.BytesIO()
        self.savefig(drawn, format="png", dpi=_NOTEBOOK_DPI)
        return drawn.getvalue()


class PictureAxes(Axes):
    """Axes of a `Picture`: notebooks show all of it."""

    def _repr_png_(self) -> bytes | None:
        figure = self.figure
        return figure._repr_png_() if isinstance(figure, Picture) else None


def axes_or_new(ax: Axes | None) -> Axes:
    if ax is not None:
        return ax
    figure = Picture(figsize=(10, 8))
    figure.subplots_adjust(left=0.08, right=0.98, bottom=0.08, top=0.95)
    return figure.add_subplot(axes_class=PictureAxes)


def panels(
    heights: Sequence[float], columns: int, width: float, title: float = 0.35
) -> tuple[Figure, list[Axes]]:
    """A figure of rows of panels; `heights` are those of each row's panels by their widths.

    `title`: Room above each row [inches].
    """
    gap = 0.1
    wide = (width - (columns + 1) * gap) / columns
    height = sum(wide * one + title for one in heights) + gap
    figure, top, axes = Picture(figsize=(width, height)), height, []
    for one in heights:
        top -= title + wide * one
        for column in range(columns):
            left = gap + column * (wide + gap)
            ax = figure.add_axes((left / width, top / height, wide / width, wide * one / height))
            ax.set_xticks([])
            ax.set_yticks([])
            axes.append(ax)
    return figure, axes


def title_of(one: Cells, kind: str) -> str:
    """For example "adaptive, 16,390 cells of 0.05 m to 1.6 m"."""
    low, high = (float(edge(one.size[one.observed])) * one.unit for edge in (np.min, np.max))
    return _title(kind, np.count_nonzero(one.observed), low, high)


def title_of_map(m: OccupancyMap, kind: str) -> str:
    """`title_of` for a map whose cells are not all in memory."""
    return _title(kind, m.stats().observed_leaves, *observed_sizes(m))


def _title(kind: str, count: int, low: float, high: float) -> str:
    sizes = f"{low:g} m" if low == high else f"{low:g} m to {high:g} m"
    return f"{kind}, {count:,} cells of {sizes}"


def framed(ax: Axes, region: Region) -> Axes:
    ax.set_aspect("equal")
    ax.set_xlim(region[0], region[1])
    ax.set_ylim(region[2], region[3])
    return ax


def colormap_of(name: str) -> Any:
    from matplotlib import colormaps

    return colormaps[name]
