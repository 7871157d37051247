# SPDX-License-Identifier: BSD-3-Clause
"""PCD: cells as points x, y, z with size, probability and state."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ndtree._lazy import needs
from ndtree._native._core import OccupancyMap
from ndtree.base.files import replaced
from ndtree.maps.writers.cells import as_float32, centres, in_space, selected


def write(
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
