# SPDX-License-Identifier: BSD-3-Clause
"""PLY: cells as points with size, probability and state, or the mesh of their surface."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ndtree import _core
from ndtree._core import OccupancyMap
from ndtree.writers import mesh
from ndtree.writers.cells import centres, in_space, selected


def write(m: OccupancyMap, path: Path, *, states: Sequence[str] = ("occupied",), faces: bool = False) -> None:
    """Points, or with `faces` the mesh of `ndtree.writers.mesh.quads`."""
    if faces:
        mesh.write_ply(m, path, states=states)
        return
    cells = selected(m, states)
    _core.write_ply(
        path,
        in_space(centres(cells)),
        size=cells.size * cells.unit,
        probability=cells.probability,
        state=cells.state,
    )
