# SPDX-License-Identifier: BSD-3-Clause
"""Leaves on the lattice of the smallest: neighbours, covered faces, unknown by free space, coarser views."""

from ndtree.cells.lattice.cells import (
    Booleans,
    Cells,
    Floats,
    Integers,
    cells_through,
    observed_bounds,
    observed_sizes,
    occupied_cells,
)
from ndtree.cells.lattice.neighbours import CellIndex, covered_faces, frontier, hidden, neighbours
from ndtree.cells.lattice.pyramid import Pyramid, coarsened

__all__ = [
    "Booleans",
    "CellIndex",
    "Cells",
    "Floats",
    "Integers",
    "Pyramid",
    "cells_through",
    "coarsened",
    "covered_faces",
    "frontier",
    "hidden",
    "neighbours",
    "observed_bounds",
    "observed_sizes",
    "occupied_cells",
]
