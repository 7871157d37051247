# SPDX-License-Identifier: BSD-3-Clause
"""Reliability diagrams: how often beams end in cells, over the probability that maps give."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ndtree.plot.figures import Path, Picture, written

#: Bins of fewer pairs are not drawn: their shares are chance.
FEWEST_PAIRS = 20
_PANELS = (("free", "cells called free"), ("occupied", "cells called occupied"))


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
