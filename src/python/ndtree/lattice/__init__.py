# SPDX-License-Identifier: BSD-3-Clause
"""Leaves on the lattice of the smallest: neighbours, covered faces, unknown by free space, coarser views."""

from ndtree.lattice.cells import Booleans, Cells, Floats, Integers
from ndtree.lattice.neighbours import CellIndex, covered_faces, frontier, hidden, neighbours
from ndtree.lattice.pyramid import Pyramid, coarsened

__all__ = [
    "Booleans",
    "CellIndex",
    "Cells",
    "Floats",
    "Integers",
    "Pyramid",
    "coarsened",
    "covered_faces",
    "frontier",
    "hidden",
    "neighbours",
]
