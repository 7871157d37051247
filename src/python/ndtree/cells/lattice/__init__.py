# SPDX-License-Identifier: BSD-3-Clause
"""Leaves on the lattice of the smallest: neighbours, covered faces, unknown by free space, coarser views."""

from ndtree.cells.lattice.cells import (
    Block,
    Booleans,
    Cells,
    Floats,
    Integers,
    around,
    block_edge,
    block_runs,
    cells_through,
    joined,
    observed_bounds,
    observed_sizes,
    occupied_cells,
    parted,
    with_rim,
)
from ndtree.cells.lattice.neighbours import CellIndex, covered_faces, frontier, hidden, neighbours
from ndtree.cells.lattice.pyramid import Pyramid, coarsened

__all__ = [
    "Block",
    "Booleans",
    "CellIndex",
    "Cells",
    "Floats",
    "Integers",
    "Pyramid",
    "around",
    "block_edge",
    "block_runs",
    "cells_through",
    "coarsened",
    "covered_faces",
    "frontier",
    "hidden",
    "joined",
    "neighbours",
    "observed_bounds",
    "observed_sizes",
    "occupied_cells",
    "parted",
    "with_rim",
]
