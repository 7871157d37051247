# SPDX-License-Identifier: BSD-3-Clause
"""Pictures of maps as in the paper's Figs. 4 to 6: leaves, occupancy, slices, occupied cells in 3-D.

What draws into one ``Axes`` takes it as ``ax``, makes a figure if it is left out, and returns it. What draws
several panels returns its ``Figure``, and writes it if there is a path, in the format of its ending.
"""

from __future__ import annotations

from ndtree._lazy import needs

with needs("ndtree.plot needs matplotlib", "plot"):
    import matplotlib as _matplotlib  # noqa: F401

from ndtree.plot.close_ups import close_up
from ndtree.plot.colors import COLORS, Coloring, coloring
from ndtree.plot.cubes import occupied, projected
from ndtree.plot.figures import FORMATS
from ndtree.plot.flat import cell_sizes, cells, occupancy, slice
from ndtree.plot.pages import overview, overview_3d, side_by_side, side_by_side_3d
from ndtree.plot.truth import reliability, truth_against_cells, truth_by_cell_size

__all__ = [
    "COLORS",
    "FORMATS",
    "Coloring",
    "cell_sizes",
    "cells",
    "close_up",
    "coloring",
    "occupancy",
    "occupied",
    "overview",
    "overview_3d",
    "projected",
    "reliability",
    "side_by_side",
    "side_by_side_3d",
    "slice",
    "truth_against_cells",
    "truth_by_cell_size",
]
