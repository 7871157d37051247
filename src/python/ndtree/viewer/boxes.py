# SPDX-License-Identifier: BSD-3-Clause
"""Boxes as the page draws them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndtree.cells.lattice import Floats, Integers, Pyramid

#: The page takes instances' colors as amounts of light, not as what a screen is told.
_LINEAR = np.rint(255 * (np.arange(256) / 255) ** 2.2).astype(np.uint8)
_CUBE = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
_CUBE_FACES = np.array(
    [
        *((0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1)),
        *((2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)),
    ]
)


def drawn_boxes(pyramid: Pyramid, chosen: Integers, flat_axis: int | None, lift: float) -> dict[str, Any]:
    """What the page needs to draw boxes: one cube or tile, and where and how large it is each time."""
    lower, upper = pyramid.lower[chosen], pyramid.upper[chosen]
    positions, scales = 0.5 * (lower + upper), upper - lower
    vertices, faces = _CUBE, _CUBE_FACES
    if flat_axis is not None:
        vertices = np.zeros((4, 3))
        across = [a for a in range(3) if a != flat_axis]
        vertices[:, across] = ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))
        faces = np.array([(0, 1, 2), (0, 2, 3)])
        scales[:, flat_axis] = 1.0
        positions[:, flat_axis] += lift
    wxyzs = np.zeros((len(chosen), 4), dtype=np.float32)
    wxyzs[:, 0] = 1.0
    return {
        "vertices": vertices.astype(np.float32),
        "faces": faces.astype(np.uint32),
        "batched_wxyzs": wxyzs,
        "batched_positions": positions.astype(np.float32),
        "batched_scales": scales.astype(np.float32),
        "batched_colors": _LINEAR[pyramid.colors[chosen]],
    }


def edges_of(lower: Floats, upper: Floats) -> NDArray[np.float32]:
    """The edges of a box: (12, 2, 3)."""
    corners = np.where(_CUBE > 0, upper, lower)
    pairs = [(i, j) for i in range(8) for j in range(i) if np.count_nonzero(_CUBE[i] != _CUBE[j]) == 1]
    return corners[np.array(pairs)].astype(np.float32)
