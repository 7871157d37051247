# SPDX-License-Identifier: BSD-3-Clause
"""Points of a log before and after those that moved are left out."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ndtree.plot.figures import Path, Picture, written

#: Points of a panel.
MOST_DRAWN = 400_000
MOVED_COLOR = "#d62728"
STANDING_COLOR = "#30506b"


def moved_points(
    points: NDArray[np.floating[Any]], moved: NDArray[np.bool_], path: Path | None = None, *, dpi: float = 130
) -> Figure:
    """Draw points from above: what stands and, in red, what moved; and beside it what is left.

    `points` (n, 2) or (n, 3): In the map [m].
    `moved`: (n,) bool.
    `path`: Where the picture is written.
    `dpi`: Dots an inch.
    """
    lower, upper = (
        np.percentile(points[:, :2], [0.2, 99.8], axis=0)
        if len(points)
        else np.array([[0.0, 0.0], [1.0, 1.0]])
    )
    span = np.maximum(upper - lower, 1e-3)
    side_by_side = span[1] >= 0.7 * span[0]
    figure = Picture(figsize=(11, 6.2) if side_by_side else (10, 9), layout="constrained")
    panels = figure.subplots(*((1, 2) if side_by_side else (2, 1)), sharex=True, sharey=True)
    step = max(1, len(points) // MOST_DRAWN)
    count = int(np.count_nonzero(moved))
    for axes, after in zip(panels, (False, True)):
        standing = points[~moved][::step]
        axes.plot(*standing[:, :2].T, ",", color=STANDING_COLOR, alpha=0.5, rasterized=True)
        if not after:
            axes.plot(*points[moved][::step, :2].T, ",", color=MOVED_COLOR, rasterized=True)
        axes.set_aspect("equal")
        axes.set_xlim(lower[0] - 0.03 * span[0], upper[0] + 0.03 * span[0])
        axes.set_ylim(lower[1] - 0.03 * span[1], upper[1] + 0.03 * span[1])
        axes.set_xlabel("x [m]")
        axes.set_ylabel("y [m]")
        axes.set_title(
            f"{len(points) - count:,} points that stand"
            if after
            else f"{len(points):,} points; {count:,} moved (red)"
        )
    return written(figure, path, dpi)
