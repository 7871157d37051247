# SPDX-License-Identifier: BSD-3-Clause
"""How true maps are: over the number of their cells, and over the probability that they give."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from ndtree.plot.figures import Path, Picture, axes_or_new, written

_MARKERS = "osD^vP*X"
#: Bins of fewer pairs are not drawn: their shares are chance.
FEWEST_PAIRS = 20
_PANELS = (("free", "cells called free"), ("occupied", "cells called occupied"))


def truth_by_cell_size(comparison: Mapping[str, Any], ax: Axes | None = None, *, of: str = "free") -> Axes:
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
    ax = axes_or_new(ax)
    ax.set_xscale("log")
    ax.bar(size, count / count.sum(), 0.3 * size, color="0.85", zorder=0, label="fraction of all")
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


def truth_against_cells(
    rows: Sequence[Mapping[str, Any]], path: Path | None = None, *, width: float = 6.0, dpi: float = 150.0
) -> Figure:
    """Draw how true the maps of a study are over how many cells they need: up and to the left is better.

    Parameters
    ----------
    rows : sequence of dict
        Of `ndtree.study.run`: each with "log", "map", "cells" and "truth".
    path : str or path, optional
        The picture to write; its ending chooses the format.
    width : float
        Of the panel of one log [inches].
    dpi : float
        Pixels an inch.

    Returns
    -------
    matplotlib.figure.Figure
        A panel for each log, a mark for each map; maps without truth are left out.
    """
    rows = [row for row in rows if (row.get("truth") or {}).get("balanced_accuracy") is not None]
    logs = list(dict.fromkeys(row["log"] for row in rows)) or [None]
    names = list(dict.fromkeys(row["map"] for row in rows))
    marks = {name: (f"C{i % 10}", _MARKERS[(i // 10 + i) % len(_MARKERS)]) for i, name in enumerate(names)}
    across = min(2, len(logs))
    down = math.ceil(len(logs) / across)
    figure = Picture(figsize=(width * across, 4.0 * down), layout="constrained")
    panels = figure.subplots(down, across, squeeze=False).ravel()
    for log, ax in zip(logs, panels):
        for row in rows:
            if row["log"] == log:
                color, marker = marks[row["map"]]
                ax.plot(
                    row["cells"], row["truth"]["balanced_accuracy"], marker, color=color, label=row["map"]
                )
        ax.set_xscale("log")
        ax.yaxis.set_major_formatter(PercentFormatter(1.0))
        ax.set_xlabel("cells")
        ax.set_ylabel("balanced accuracy on scans held out")
        ax.set_title(log or "no truth: no scans were held out")
        ax.grid(alpha=0.3)
        if rows:
            ax.legend(fontsize=8)
    for ax in panels[len(logs) :]:
        ax.remove()
    return written(figure, path, dpi)


def reliability(comparison: Mapping[str, Any], path: Path | None = None) -> Figure:
    """Draw how often held-out beams end in cells, over how often each map says that they do.

    Parameters
    ----------
    comparison : Comparison
        Made with ``calibration=True``.
    path : str or os.PathLike, optional
        The picture, in the format of its ending.

    Returns
    -------
    matplotlib.figure.Figure
        Panels for cells called free and occupied, with a line for each map. Marks have an area in proportion
        to their pairs of a beam and a cell; on the diagonal a map is right.
    """
    rows = [row for row in comparison["maps"] if row.get("calibration")]
    if not rows:
        raise ValueError(
            "no calibration: the comparison must be made with calibration=True and scans held out"
        )
    figure = Picture(figsize=(9.0, 4.6), layout="constrained")
    for ax, (key, title) in zip(figure.subplots(1, len(_PANELS)), _PANELS):
        ax.plot([0.0, 1.0], [0.0, 1.0], color="0.6", linewidth=0.8, zorder=0)
        for row in rows:
            of = row["calibration"][key]
            bins = [one for one in of["bins"] if one["pairs"] >= FEWEST_PAIRS]
            said, ends, pairs = (
                np.array([one[name] for one in bins]) for name in ("probability", "ends", "pairs")
            )
            error = "" if of["ece"] is None else f", error {of['ece']:.3f}"
            (line,) = ax.plot(said, ends, linewidth=1.2, label=f"{row['map']}{error}")
            ax.scatter(said, ends, s=6.0 + 120.0 * pairs / max(pairs.sum(), 1), color=line.get_color())
        ax.set(
            title=title, xlabel="probability that a beam ends in the cell", xlim=(0.0, 1.0), ylim=(0.0, 1.0)
        )
        ax.set_ylabel("beams held out that did")
        ax.set_aspect("equal")
        ax.legend(loc="upper left", frameon=False)
    figure.suptitle(os.path.basename(comparison["log"]))
    return written(figure, path, 150)
