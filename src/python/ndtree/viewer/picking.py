# SPDX-License-Identifier: BSD-3-Clause
"""The cell that is clicked, and what is said about it."""

from __future__ import annotations

import math

import numpy as np

from ndtree.cells.lattice import Cells, Floats

_STATES = {-1: "unknown", 0: "free", 1: "occupied"}


def first_on_ray(lower: Floats, upper: Floats, origin: Floats, direction: Floats) -> tuple[float, int]:
    """Distance and number of the first box on a ray; -1 for none. Flat boxes are met, too."""
    if not len(lower):
        return math.inf, -1
    with np.errstate(divide="ignore", invalid="ignore"):
        one, two = (lower - origin) / direction, (upper - origin) / direction
    inside = (lower <= origin) & (origin <= upper)
    nan = np.isnan(one) | np.isnan(two)  # Parallel to a face, and in its plane.
    low = np.where(nan, np.where(inside, -np.inf, np.inf), np.fmin(one, two))
    high = np.where(nan, np.where(inside, np.inf, -np.inf), np.fmax(one, two))
    enter, leave = np.maximum(low.max(axis=1), 0.0), high.min(axis=1)
    met = np.flatnonzero(enter <= leave + 1e-12)
    if not len(met):
        return math.inf, -1
    first = met[np.argmin(enter[met])]
    return float(enter[first]), int(first)


def numbers_of(cells: Cells, number: int) -> str:
    """A cell's numbers as Markdown."""
    middle = (cells.lower[number] + 0.5 * cells.size[number]) * cells.unit
    rows = {
        "centre": f"({', '.join(f'{c:.3f}' for c in middle)}) m",
        "size": f"{cells.size[number] * cells.unit:g} m",
        "state": _STATES[int(cells.state[number])],
        "probability": f"{cells.probability[number]:.3f}",
        "hits": f"{cells.hits[number]:,}",
        "misses": f"{cells.misses[number]:,}",
    }
    return "\n".join(["| | |", "|---|---|", *(f"| {name} | {value} |" for name, value in rows.items())])
