# SPDX-License-Identifier: BSD-3-Clause
"""OctoMap's files: .ot with log-odds, .bt with states."""

from __future__ import annotations

from pathlib import Path

from ndtree._native._core import OccupancyMap


def write(m: OccupancyMap, path: Path, *, cell_size: float | None = None) -> None:
    """See ``OccupancyMap.save_octomap()``."""
    m.save_octomap(path, cell_size=cell_size)
