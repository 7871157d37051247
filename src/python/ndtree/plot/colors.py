# SPDX-License-Identifier: BSD-3-Clause
"""Colours of pictures, and what says which is which: legends and bars of lengths."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke

from ndtree.cells.lattice import Cells, Floats
from ndtree.plot.figures import STATE_COLORS, UNKNOWN, colormap_of


class Coloring:
    """Which color a cell has, and what that means."""

    def __init__(
        self, by: str, label: str, norm: Normalize, colormap: str, ticks: Floats | None = None
    ) -> None:
        if by not in COLORS:
            raise ValueError(f"color = {by!r}: must be one of {', '.join(COLORS)}")
        self.by, self.label, self.norm, self.ticks = by, label, norm, ticks
        self._map = colormap_of(colormap)
        self._ends = (0.05, 0.95) if colormap == "turbo" else (0.0, 1.0)  # Its ends are nearly black.

    def __call__(self, some: Cells) -> Floats:
        """Red, green and blue of each cell, from 0 to 1: (n, 3)."""
        values = some.probability
        if self.by != "probability":
            values = (some.size if self.by == "size" else some.lower[:, -1] + 0.5 * some.size) * some.unit
        level = np.clip(np.asarray(self.norm(values), dtype=np.float64), 0.0, 1.0)
        return self._map(self._ends[0] + (self._ends[1] - self._ends[0]) * level)[:, :3]

    def legend(self) -> Any:
        """What a bar beside the picture is made of."""
        from matplotlib.cm import ScalarMappable
        from matplotlib.colors import ListedColormap

        return ScalarMappable(self.norm, ListedColormap(self._map(np.linspace(*self._ends, 256))))


#: Even for the eye: equal steps of a value look equally different, also printed in grey.
HEIGHT_COLORS = "viridis"
CUBE_SIZE_COLORS = "magma_r"
COLORS = ("height", "size", "probability")


def coloring(
    shown: Cells, by: str = "height", colormap: str | None = None, heights: tuple[float, float] | None = None
) -> Coloring:
    """Colors for cells by "height", "size" or "probability", stretched over those that are shown."""
    if by == "height":
        if heights is None:
            middle = (shown.lower[:, 2] + 0.5 * shown.size) * shown.unit
            low, high = np.percentile(middle, (1, 99))
            heights = float(low), float(max(high, low + shown.unit))
        return Coloring(by, "height [m]", Normalize(*heights), colormap or HEIGHT_COLORS)
    if by == "size":
        sizes = np.unique(shown.size) * shown.unit
        norm = LogNorm(float(sizes[0]), max(float(sizes[-1]), 1.001 * float(sizes[0])))
        return Coloring(by, "cell size [m]", norm, colormap or CUBE_SIZE_COLORS, sizes)
    low = 0.0 if shown.free.any() else UNKNOWN
    return Coloring(by, "probability", Normalize(low, 1.0), colormap or "plasma_r")


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


def explain_states(ax: Axes) -> None:
    """A legend above the picture: what is white, black and grey."""
    patches = [
        Patch(facecolor=color, edgecolor="0.4", linewidth=0.6, label=state)
        for state, color in STATE_COLORS.items()
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
