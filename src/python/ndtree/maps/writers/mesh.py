# SPDX-License-Identifier: BSD-3-Clause
"""Cells as meshes: their surface, without the faces that other cells hide, as glTF or PLY; or VTK's grid."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndtree._lazy import needs
from ndtree._native._core import OccupancyMap
from ndtree.base.files import replaced
from ndtree.base.voxels import distinct
from ndtree.cells.lattice import Cells, covered_faces
from ndtree.maps.writers.cells import as_float32, in_space, selected

# Colors by height, from low to high: a few stops that are told apart in grey, too.
_STOPS = np.array([[68, 58, 130], [45, 112, 142], [53, 183, 121], [253, 231, 37]], dtype=np.float64)


def quads(cells: Cells) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Corners and faces of the cells' surface.

    In space, all faces but those that lie wholly on others of the cells, their corners counter-clockwise seen
    from outside; in the plane, the cells themselves.

    Returns corners (n, dim) int64: In units of the smallest cell, each once; faces (m, 4) int64: Numbers of
    corners.
    """
    dim = cells.dim
    parts = []
    if dim == 2:
        parts.append(_face(cells, 0, 1, np.zeros(2, dtype=np.int64)))
    elif dim == 3:
        covered = covered_faces(cells)
        for axis in range(3):
            for side in (0, 1):
                seen = cells.where(~covered[:, axis, side])
                u, v = ((axis + 1) % 3, (axis + 2) % 3) if side else ((axis + 2) % 3, (axis + 1) % 3)
                parts.append(_face(seen, u, v, side * np.eye(3, dtype=np.int64)[axis]))
    else:
        raise ValueError(f"a map with dim = {dim}: must be 2 or 3")
    corners, number = distinct(np.concatenate(parts).reshape(-1, dim), return_inverse=True)
    return corners, number.reshape(-1, 4)


def _face(cells: Cells, u: int, v: int, base: NDArray[np.int64]) -> NDArray[np.int64]:
    """(n, 4, dim): corners of one face of each cell, from `base` along the axes u and then v."""
    along = np.zeros((4, cells.dim), dtype=np.int64) + base
    along[[1, 2], u] += 1
    along[[2, 3], v] += 1
    return cells.lower[:, None, :] + cells.size[:, None, None] * along


def write_gltf(
    m: OccupancyMap, path: Path, *, states: Sequence[str] = ("occupied",), cell_size: float | None = None
) -> None:
    """glTF, binary (.glb) or text with its data in it (.gltf), y upwards as glTF has it."""
    mesh = _mesh(m, states, cell_size, "glTF")
    mesh.apply_transform([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    if path.suffix == ".glb":
        content = mesh.export(file_type="glb")
    else:
        from trimesh.exchange.gltf import export_gltf

        content = export_gltf(mesh.scene(), embed_buffers=True)["model.gltf"]
    with replaced(path) as part:
        part.write_bytes(content)


def write_faces(
    m: OccupancyMap, path: Path, *, states: Sequence[str], cell_size: float | None = None
) -> None:
    """A mesh in the map's frame."""
    content = _mesh(m, states, cell_size, "the mesh's PLY").export(file_type="ply")
    with replaced(path) as part:
        part.write_bytes(content)


def _mesh(m: OccupancyMap, states: Sequence[str], cell_size: float | None, what: str) -> Any:
    with needs("meshes need trimesh", "convert"):
        import trimesh
    cells = selected(m, states, cell_size)
    corners, faces = quads(cells)
    points = in_space(corners * cells.unit)
    as_float32(points, cells.unit, what)
    triangles = faces[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
    mesh = trimesh.Trimesh(vertices=points, faces=triangles, process=False)
    mesh.visual.vertex_colors = height_colors(points[:, 2])
    return mesh


def height_colors(height: NDArray[np.float64]) -> NDArray[np.uint8]:
    """(n, 4) red, green, blue and opaqueness."""
    low, high = float(height.min()), float(height.max())
    at = (height - low) / (high - low) if high > low else np.zeros_like(height)
    stops = np.linspace(0, 1, len(_STOPS))
    rgb = np.column_stack([np.interp(at, stops, _STOPS[:, c]) for c in range(3)])
    return np.hstack([np.rint(rgb), np.full((len(at), 1), 255.0)]).astype(np.uint8)


# Corners in the order of VTK's quad and hexahedron.
_CORNERS = {
    2: np.array([[0, 0], [1, 0], [1, 1], [0, 1]]),
    3: np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]]),
}


def write_vtu(
    m: OccupancyMap,
    path: Path,
    *,
    states: Sequence[str] = ("occupied", "free"),
    cell_size: float | None = None,
) -> None:
    """VTK's unstructured grid (.vtu), for ParaView and PyVista: a quad or a hexahedron for each cell."""
    with needs("VTK's files need meshio", "convert"):
        import meshio
    if m.dim not in _CORNERS:
        raise ValueError(f"a map with dim = {m.dim}: must be 2 or 3")
    cells = selected(m, states, cell_size)
    along = _CORNERS[m.dim]
    corners = cells.lower[:, None, :] + cells.size[:, None, None] * along
    points, number = distinct(corners.reshape(-1, m.dim), return_inverse=True)
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
