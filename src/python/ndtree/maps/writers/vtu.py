# SPDX-License-Identifier: BSD-3-Clause
"""VTK's unstructured grid (.vtu), which ParaView and PyVista open: a quad or a hexahedron for each cell."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ndtree._lazy import needs
from ndtree._native._core import OccupancyMap
from ndtree.base.files import replaced
from ndtree.maps.writers.cells import distinct, in_space, selected

# Corners in the order of VTK's quad and hexahedron.
_CORNERS = {
    2: np.array([[0, 0], [1, 0], [1, 1], [0, 1]]),
    3: np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]]),
}


def write(
    m: OccupancyMap,
    path: Path,
    *,
    states: Sequence[str] = ("occupied", "free"),
    cell_size: float | None = None,
) -> None:
    """Cells with probability, state, size, hits and misses."""
    with needs("VTK's files need meshio", "convert"):
        import meshio
    if m.dim not in _CORNERS:
        raise ValueError(f"a map with dim = {m.dim}: must be 2 or 3")
    cells = selected(m, states, cell_size)
    along = _CORNERS[m.dim]
    corners = cells.lower[:, None, :] + cells.size[:, None, None] * along
    points, number = distinct(corners.reshape(-1, m.dim))
    grid = meshio.Mesh(
        in_space(points * cells.unit),
        [("quad" if m.dim == 2 else "hexahedron", number.reshape(-1, len(along)))],
        cell_data={
            "probability": [cells.probability],
            "state": [cells.state.astype(np.int32)],
            "size": [cells.size * cells.unit],
            "hits": [cells.hits.astype(np.int32)],
            "misses": [cells.misses.astype(np.int32)],
        },
    )
    with replaced(path) as part:
        grid.write(part, file_format="vtu")
