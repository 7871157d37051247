# SPDX-License-Identifier: BSD-3-Clause
"""PCD and PLY: cells as points with size, probability and state; of PLY, or the mesh of their surface."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ndtree._lazy import needs
from ndtree._native import _core
from ndtree._native._core import OccupancyMap
from ndtree.base.files import replaced
from ndtree.maps.writers import mesh
from ndtree.maps.writers.cells import as_float32, centres, in_space, selected


def write_pcd(
    m: OccupancyMap, path: Path, *, states: Sequence[str] = ("occupied",), cell_size: float | None = None
) -> None:
    """Binary, with float32 coordinates as the Point Cloud Library has them."""
    with needs("PCD files need pypcd4", "convert"):
        from pypcd4 import PointCloud
    cells = selected(m, states, cell_size)
    xyz = as_float32(in_space(centres(cells)), cells.unit, "PCD")
    columns = [
        *xyz.T,
        (cells.size * cells.unit).astype(np.float32),
        cells.probability.astype(np.float32),
        cells.state,
    ]
    cloud = PointCloud.from_points(
        columns, ("x", "y", "z", "size", "probability", "state"), (*[np.float32] * 5, np.int8)
    )
    with replaced(path) as part:
        cloud.save(part)


def write_ply(
    m: OccupancyMap,
    path: Path,
    *,
    states: Sequence[str] = ("occupied",),
    faces: bool = False,
    cell_size: float | None = None,
) -> None:
    """Points, with the layers of the map's own cells; or with `faces` the mesh of `mesh.quads`."""
    if faces:
        mesh.write_faces(m, path, states=states, cell_size=cell_size)
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
