# SPDX-License-Identifier: BSD-3-Clause
"""NumPy's files: the leaves of a map, or all of it as a dense grid of states."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ndtree._errors import WrongValue
from ndtree._native._core import OccupancyMap
from ndtree.base.files import replaced
from ndtree.logs.core.archive import is_archive
from ndtree.maps.writers.cells import centres, selected


def holds_no_scans(path: str) -> bool:
    """Whether a file is no recording, and may be replaced by a map's arrays."""
    return not is_archive(path)


def write_leaves(
    m: OccupancyMap,
    path: Path,
    *,
    states: Sequence[str] = ("occupied", "free"),
    cell_size: float | None = None,
) -> None:
    """An .npz with the array ``leaves``, one record each.

    Its fields are lower and center (dim), size [m], probability, state (-1 unknown, 0 free, 1 occupied), hits
    and misses. Beside it stand ``branching`` and ``min_cell_size``.
    """
    cells = selected(m, states, cell_size)
    leaves = np.zeros(
        len(cells),
        dtype=[
            ("lower", "<f8", (m.dim,)),
            ("center", "<f8", (m.dim,)),
            ("size", "<f8"),
            ("probability", "<f4"),
            ("state", "i1"),
            ("hits", "<u4"),
            ("misses", "<u4"),
        ],
    )
    leaves["lower"] = cells.lower * cells.unit
    leaves["center"] = centres(cells)
    leaves["size"] = cells.size * cells.unit
    for name in ("probability", "state", "hits", "misses"):
        leaves[name] = getattr(cells, name)
    with replaced(path, holds_no_scans) as part:
        np.savez_compressed(
            part,
            leaves=leaves,
            branching=m.branching,
            min_cell_size=m.options["min_cell_size"] if cell_size is None else cell_size,
        )


def write_grid(m: OccupancyMap, path: Path, *, cell_size: float | None = None) -> None:
    """The states of all that is known, int8, the first axis x: see ``OccupancyMap.to_grid()``.

    An .npz holds ``states``, ``lower``, the first cell's lower corner [m], and ``cell_size``; an .npy the
    states alone.
    """
    size = m.options["min_cell_size"] if cell_size is None else cell_size
    leaves = m.leaves()
    known = leaves.state >= 0
    if not known.any():
        raise ValueError("the map is empty: nothing is known")
    if not (size > 0 and np.isfinite(size)):
        raise WrongValue.of("cell_size", f"{size} m", "> 0 and finite")
    lower = np.floor(leaves.lower[known].min(axis=0) / size + 1e-9) * size
    upper = (leaves.lower + leaves.size[:, None])[known].max(axis=0)
    states = m.to_grid([lower, upper], size)
    with replaced(path, holds_no_scans) as part:
        if path.suffix == ".npy":
            np.save(part, states)
        else:
            np.savez_compressed(part, states=states, lower=lower, cell_size=size)
