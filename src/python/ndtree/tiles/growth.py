# SPDX-License-Identifier: BSD-3-Clause
"""The root that a map gets while it takes scans in, without its cells."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ndtree._native._core import OccupancyMap
from ndtree.base.scan import Scan
from ndtree.tiles.grid import nowhere

Floats = NDArray[np.float64]


class Growth:
    """Where the root of a map is depends on all scans in their order, and on nothing else.

    `frame`: With the root so far, and no cell; it grows.
    """

    def __init__(self, frame: OccupancyMap) -> None:
        self.map = frame
        self._look()

    def contains(self, box: tuple[Floats, Floats] | None) -> bool:
        """Whether a scan that stays in a box leaves the root as it is."""
        return box is None or bool((box[0] >= self._lower).all() and (box[1] < self._upper).all())

    def include(self, scan: Scan, max_range: float) -> None:
        """Grow as a map does that takes the scan in."""
        own = {} if scan.range_sigma is None else {"range_sigma": scan.range_sigma}
        self.map.insert(
            scan.endpoints,
            scan.origin,
            returned=scan.returned,
            max_range=max_range,
            window=nowhere(self.map),
            **own,
        )
        self._look()

    def _look(self) -> None:
        leaves = self.map.leaves()
        self._lower = leaves.lower.min(axis=0)
        self._upper = (leaves.lower + leaves.size[:, None]).max(axis=0)
