# SPDX-License-Identifier: BSD-3-Clause
"""Which color a cell has, and what that means."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.colors import LogNorm, Normalize

from ndtree.cells.lattice import Cells, Floats
from ndtree.plot.figures import UNKNOWN, colormap_of


class Coloring:
    """Which color a cell has, and what that means."""

    def __init__(
        self, by: str, label: str, norm: Normalize, colormap: str, ticks: Floats | None = None
    ) -> None:
        self.by, self.label, self.norm, self.ticks = by, label, norm, ticks
        ends = (0.05, 0.95) if colormap == "turbo" else (0.0, 1.0)  # Its ends are nearly black.
        self._map = colormap_of(colormap)
        self._ends = ends

    def __call__(self, some: Cells) -> Floats:
        """Red, green and blue of each cell, from 0 to 1: (n, 3)."""
        values = {"height": _middle_height, "size": _edge, "probability": _probability}[self.by](some)
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
    shown: Cells,
    by: str = "height",
    colormap: str | None = None,
    heights: tuple[float, float] | None = None,
) -> Coloring:
    """Colors for cells by "height", "size" or "probability", stretched over those that are shown."""
    if by not in COLORS:
        raise ValueError(f"color = {by!r}: must be one of {', '.join(COLORS)}")
    if by == "height":
        return Coloring(by, "height [m]", Normalize(*(heights or _heights(shown))), colormap or HEIGHT_COLORS)
    if by == "size":
        sizes = np.unique(shown.size) * shown.unit
        norm = LogNorm(float(sizes[0]), max(float(sizes[-1]), 1.001 * float(sizes[0])))
        return Coloring(by, "cell size [m]", norm, colormap or CUBE_SIZE_COLORS, sizes)
    low = 0.0 if shown.free.any() else UNKNOWN
    return Coloring(by, "probability", Normalize(low, 1.0), colormap or "plasma_r")


def _middle_height(some: Cells) -> Floats:
    return (some.lower[:, -1] + 0.5 * some.size) * some.unit


def _edge(some: Cells) -> Floats:
    return some.size * some.unit


def _probability(some: Cells) -> Floats:
    return some.probability


def _heights(cubes: Cells) -> tuple[float, float]:
    middle = (cubes.lower[:, 2] + 0.5 * cubes.size) * cubes.unit
    low, high = np.percentile(middle, (1, 99))
    return float(low), float(max(high, low + cubes.unit))
