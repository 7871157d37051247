# SPDX-License-Identifier: BSD-3-Clause
"""Two 2-D maps of one log, each whole and from close by, so that their cells can be compared."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from ndtree._native._core import OccupancyMap
from ndtree.cells.lattice import Cells
from ndtree.cells.regions import picture_region
from ndtree.plot.colors import explain_states, scale_bar
from ndtree.plot.figures import Path, Region, kind_of, panels, require_dim, shape_of, title_of, written
from ndtree.plot.images import draw_borders, draw_occupancy

#: Width of a close-up, of the smallest cells of the map with the finest ones, and its height by its width.
CLOSE_UP_CELLS, CLOSE_UP_SHAPE = 100, 0.45
#: Steps, at most, in which a window is moved along an axis to find the close-up.
_STEPS = 1000
#: Above each row [inches].
_TITLE = 0.26
#: Color of the frame around a close-up.
_MARK = "#d1495b"


def close_up(
    adaptive: OccupancyMap,
    fixed: OccupancyMap,
    path: Path | None = None,
    *,
    region: Region | None = None,
    width: float = 14.0,
    dpi: float = 120.0,
) -> Figure:
    """Draw two maps of the same log one beside the other: whole above, from close by with their cells below.

    Occupied is black, free white, unknown grey. The titles say how many cells each map has.

    Parameters
    ----------
    adaptive, fixed, path, width, dpi
        As for `side_by_side`.
    region : (x_min, x_max, y_min, y_max), optional
        What to show from close by [m]; left out, the part that was observed best and has most surfaces in it.

    Returns
    -------
    matplotlib.figure.Figure
        With four axes: the fixed map whole, the adaptive one whole, and below each its close-up.
    """
    for m in (adaptive, fixed):
        require_dim(m, 2)
    fine, even = Cells.of(adaptive), Cells.of(fixed)
    whole = picture_region(fine)
    close = tuple(region) if region is not None else close_up_region(fine)
    figure, axes = panels([shape_of(whole), shape_of(close)], 2, width, _TITLE)
    ratio = np.count_nonzero(even.observed) / np.count_nonzero(fine.observed)
    times = f"{ratio:.1f} times fewer" if ratio >= 1 else f"{1 / ratio:.1f} times more"
    maps = (
        (even, title_of(even, kind_of(fixed.refinement))),
        (fine, f"{title_of(fine, kind_of(adaptive.refinement))}: {times}"),
    )
    for column, (one, title) in enumerate(maps):
        top, bottom = axes[column], axes[2 + column]
        draw_occupancy(one, top, whole)
        top.set_title(title, loc="left", fontsize=13)
        frame = ((close[0], close[2]), close[1] - close[0], close[3] - close[2])
        top.add_patch(Rectangle(*frame, fill=False, edgecolor=_MARK, linewidth=1.8, zorder=9))
        draw_occupancy(one, bottom, close)
        draw_borders(one, bottom, close, linewidth=0.6)
        for edge in bottom.spines.values():
            edge.set(edgecolor=_MARK, linewidth=1.8)
        scale_bar(top)
        scale_bar(bottom)
    explain_states(axes[0])
    return written(figure, path, dpi)


def close_up_region(every: Cells) -> tuple[float, float, float, float]:
    """Where a close-up shows most (x_min, x_max, y_min, y_max) [m].

    Of the windows that were observed at least nine tenths as well as the best one, the one with most occupied
    cells; O(n) of n cells.
    """
    seen = every.where(every.observed)
    region = np.array(picture_region(every)).reshape(2, 2) / every.unit
    span = np.array([CLOSE_UP_CELLS, CLOSE_UP_SHAPE * CLOSE_UP_CELLS])
    span = np.minimum(span, np.ptp(region, axis=1).min() * np.array([1.0, CLOSE_UP_SHAPE]))
    step = np.maximum(span / 4, np.ptp(region, axis=1) / _STEPS)
    span = np.maximum(span, step)
    bins = [np.arange(low, high + s, s) for (low, high), s in zip(region, step)]
    middle = seen.lower + 0.5 * seen.size[:, None]
    area = np.histogram2d(middle[:, 0], middle[:, 1], bins=bins, weights=seen.size.astype(np.float64) ** 2)[0]
    hit = middle[seen.occupied]
    hits = np.histogram2d(hit[:, 0], hit[:, 1], bins=bins)[0]
    window = np.minimum(np.maximum(np.rint(span / step).astype(int), 1), area.shape)
    views = [np.lib.stride_tricks.sliding_window_view(grid, window).sum((2, 3)) for grid in (area, hits)]
    good = np.minimum(views[0], span.prod())
    best = np.where(good >= 0.9 * good.max(), views[1], -1.0)
    at = np.unravel_index(int(best.argmax()), best.shape)
    low = np.array([bins[a][at[a]] for a in (0, 1)]) * every.unit
    high = low + span * every.unit
    return float(low[0]), float(high[0]), float(low[1]), float(high[1])
