# SPDX-License-Identifier: BSD-3-Clause
"""PLY: cells as points with size, probability and state, or the mesh of their surface."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ndtree._native import _core
from ndtree._native._core import OccupancyMap
from ndtree.maps.writers import mesh
from ndtree.maps.writers.cells import centres, in_space, selected


def write(
    m: OccupancyMap,
    path: Path,
    *,
    states: Sequence[str] = ("occupied",),
    faces: bool = False,
    cell_size: float | None = None,
) -> None:
    """Points, with the layers of the map's own cells; or with `faces` the mesh of `mesh.quads`."""
    if faces:
        mesh.write_ply(m, path, states=states, cell_size=cell_size)
        return
    if m.layers and cell_size is None and "frontier" not in states:
        selected(m, states)  # For its errors.
        state = m.leaves().state
        m.save_ply(path, leaves=((state == 1) & ("occupied" in states)) | ((state == 0) & ("free" in states)))
        return
    cells = selected(m, states, cell_size)
    _core.write_ply(
        path,
        in_space(centres(cells)),
        size=cells.size * cells.unit,
        probability=cells.probability,
        state=cells.state,
    )
