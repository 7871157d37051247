# SPDX-License-Identifier: BSD-3-Clause
"""Colours in which live maps are shown."""

from __future__ import annotations

from ndtree.maps.ground import FREE, OCCUPIED, UNKNOWN

#: Of cells by their size, the smallest first: red, green, blue.
_SIZES = ((0.9, 0.3, 0.1), (0.95, 0.6, 0.1), (0.9, 0.85, 0.2), (0.4, 0.75, 0.3), (0.2, 0.55, 0.8))
#: Of pixels of a grid: red, green, blue, alpha; what is unknown is not drawn.
GRID_COLORS = {UNKNOWN: (0, 0, 0, 0), FREE: (235, 235, 235, 255), OCCUPIED: (30, 30, 30, 255)}


def color_of(number: int) -> tuple[float, float, float]:
    """Of the cells of the n-th smallest size: red, green, blue from 0 to 1."""
    return _SIZES[min(number, len(_SIZES) - 1)]
