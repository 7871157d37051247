# SPDX-License-Identifier: BSD-3-Clause
"""A way between two places that are clicked."""

from __future__ import annotations

import numpy as np

from ndtree._native._core import OccupancyMap, Sphere
from ndtree.cells.lattice import Floats

MOST_SECONDS = 5.0  # That a page waits for a way.


def place_on_plane(origin: Floats, direction: Floats, height: float) -> Floats | None:
    """Where a ray meets the plane z = height; None if it does not."""
    if direction[2] == 0.0:
        return None
    along = (height - origin[2]) / direction[2]
    return origin + along * direction if along >= 0.0 else None


class Ways:
    """Every second click ends a way that begins at the click before it."""

    def __init__(self) -> None:
        self._start: Floats | None = None

    def clicked(self, m: OccupancyMap | None, place: Floats, radius: float) -> tuple[str, Floats]:
        """What is said about it, and the way's points (n, dim), or the place alone."""
        if m is None:
            return "no paths through maps of OctoMap's own", np.zeros((0, 3))
        place = place[: m.dim]
        if self._start is None:
            self._start = place
            at = ", ".join(f"{x:.2f}" for x in place)
            return f"from ({at}): click where to", place[None]
        start, self._start = self._start, None
        try:
            way = m.plan(start, place, body=Sphere(radius), max_seconds=MOST_SECONDS)
        except ValueError as error:
            return str(error), np.zeros((0, m.dim))
        if not way:
            return f"no path: {way.reason}", np.zeros((0, m.dim))
        return f"{way.length:.2f} m, {way.clearance:.2f} m from obstacles", way.points
