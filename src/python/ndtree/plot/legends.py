# SPDX-License-Identifier: BSD-3-Clause
"""What tells a reader how large things are, and what black and white mean."""

from __future__ import annotations

import math
from typing import Any

from matplotlib.axes import Axes
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke

from ndtree.plot.figures import STATE_COLORS

#: A scale bar takes at most this share of the width.
_WIDEST = 0.25


def scale_bar(ax: Axes) -> Any:
    """Draw a bar of 1, 2 or 5 times a power of ten metres in the lower left; returns its line."""
    left, right = ax.get_xlim()
    bottom, top = ax.get_ylim()
    length = round_length(_WIDEST * (right - left))
    begin, height = left + 0.03 * (right - left), bottom + 0.04 * (top - bottom)
    outline = [withStroke(linewidth=5.0, foreground="white")]
    (line,) = ax.plot(
        [begin, begin + length],
        [height, height],
        color="black",
        linewidth=3.0,
        solid_capstyle="butt",
        path_effects=outline,
        zorder=10,
        label="_scale",
    )
    ax.annotate(
        f"{length:g} m" if length >= 0.01 else f"{1000 * length:g} mm",
        (begin + 0.5 * length, height),
        (0, 4),
        textcoords="offset points",
        ha="center",
        va="bottom",
        fontsize=9,
        zorder=10,
        path_effects=[withStroke(linewidth=3.0, foreground="white")],
    )
    return line


def round_length(most: float) -> float:
    """The largest of 1, 2 and 5 times powers of ten that is at most so long."""
    power = 10.0 ** math.floor(math.log10(most))
    return max(step * power for step in (1, 2, 5) if step * power <= most * (1 + 1e-9))


def name_axes(ax: Axes, names: str = "xy") -> None:
    """Say which coordinates the axes have, in metres, where they have no names yet."""
    if not ax.get_xlabel() and not ax.get_ylabel():
        ax.set_xlabel(f"{names[0]} [m]")
        ax.set_ylabel(f"{names[1]} [m]")


def explain_states(ax: Axes, style: str = "paper") -> None:
    """A legend above the picture: what is white, black and grey."""
    patches = [
        Patch(facecolor=color, edgecolor="0.4", linewidth=0.6, label=state)
        for state, color in STATE_COLORS[style].items()
    ]
    ax.legend(
        handles=patches,
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=3,
        fontsize=8,
        frameon=False,
        handlelength=1.2,
        handleheight=1.0,
        borderaxespad=0.1,
        columnspacing=1.0,
    )
