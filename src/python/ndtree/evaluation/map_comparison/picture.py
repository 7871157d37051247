# SPDX-License-Identifier: BSD-3-Clause
"""Where two maps differ, as a picture."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from ndtree.cells.raster import pixels_in
from ndtree.evaluation.map_comparison.blocks import common_grid
from ndtree.maps.open import PlacedMap
from ndtree.plot.figures import written

# What is shown of a cell: states in a and b, color and words. Of a column that has occupied cells, those are
# shown, and what most of them are.
_SHOWN = (
    ((0, 0), "#ffffff", None),
    ((1, 1), "#e6e6e6", "free in both"),
    ((1, 0), "#f6ddd2", "free in a, unknown in b"),
    ((0, 1), "#d3e3f3", "free in b, unknown in a"),
    ((2, 2), "#303030", "occupied in both"),
    ((2, 0), "#ef9a6a", "occupied in a, unknown in b"),
    ((0, 2), "#7fb2e0", "occupied in b, unknown in a"),
    ((2, 1), "#c4161c", "occupied in a, free in b"),
    ((1, 2), "#1f4fb4", "occupied in b, free in a"),
)
_FIRST_OCCUPIED = 4
_MAX_PIXELS = 2000


def draw_differences(a: PlacedMap, b: PlacedMap, cell_size: float, path: Path) -> None:
    """Draw what each of two maps says of the same cells."""
    image, extent = _differences(a, b, cell_size)
    wide, high = extent[1] - extent[0], extent[3] - extent[2]
    above, below = 0.6, 1.5  # Room for the title, and for the words below [inches].
    size = (9.0, min(14.0, max(3.0, 8.2 * high / wide)) + above + below)
    figure = Figure(figsize=size)
    FigureCanvasAgg(figure)
    figure.subplots_adjust(left=0.09, right=0.98, bottom=below / size[1], top=1 - above / size[1])
    axes = figure.add_subplot()
    axes.imshow(
        image.T,
        origin="lower",
        extent=extent,
        cmap=ListedColormap([color for _, color, _ in _SHOWN]),
        vmin=-0.5,
        vmax=len(_SHOWN) - 0.5,
        interpolation="nearest",
    )
    axes.set_aspect("equal")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    seen = "" if a.map.dim == 2 else ", from above"
    axes.set_title(f"a: {a.name}\nb: {b.name}{seen}", fontsize=9, loc="left")
    there = set(np.unique(image).tolist())
    patches = [
        Patch(facecolor=color, edgecolor="#808080", linewidth=0.5, label=text)
        for i, (_, color, text) in enumerate(_SHOWN)
        if text and i in there
    ]
    figure.legend(handles=patches, loc="lower center", ncol=3, fontsize=8, frameon=False)
    written(figure, path, 150)


def _differences(
    a: PlacedMap, b: PlacedMap, cell_size: float
) -> tuple[NDArray[np.int8], tuple[float, float, float, float]]:
    """Numbers in `_SHOWN` by x and y, and x_min, x_max, y_min, y_max [m]."""
    grid = common_grid(a, b, cell_size)
    bounds = grid.around(a, b)
    if bounds is None:
        raise ValueError("neither map knows anything: there is nothing to draw")
    low, high = bounds[0][:2], bounds[1][:2] + 1
    step = max(1, math.ceil(int(np.max(high - low)) / _MAX_PIXELS))
    shape = -(-(high - low) // step)
    counts = np.zeros((len(_SHOWN), *shape), dtype=np.float32)
    number = np.zeros((3, 3), dtype=np.int64)
    for i, (states, _, _) in enumerate(_SHOWN):
        number[states] = i
    for lower, edge, states in grid.blocks(a, b):
        kind = number[states[:, 0], states[:, 1]]
        first = (lower[:, :2] - low) // step
        last = (lower[:, :2] + edge - 1 - low) // step + 1
        weight = edge ** (a.map.dim - 2) * min(edge, step) ** 2  # Of a block in each of its pixels.
        at, which = pixels_in(first[:, ::-1], last[:, ::-1], shape[1])
        np.add.at(counts.reshape(len(_SHOWN), -1), (kind[which], at), weight)
    counts[_FIRST_OCCUPIED:] *= np.float32(2) ** 40  # However few they are.
    image = np.where(counts.any(axis=0), counts.argmax(axis=0), 0).astype(np.int8)
    corner = grid.origin[:2] + low * grid.cell_size
    upper = corner + shape * step * grid.cell_size
    return image, (float(corner[0]), float(upper[0]), float(corner[1]), float(upper[1]))
