# SPDX-License-Identifier: BSD-3-Clause
"""Where a sensor was."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ndtree.cells.lattice import Floats

if TYPE_CHECKING:
    from ndtree.base.scan import Scan

MAX_TRACK = 4096  # Points of a trajectory.


class Track:
    """Where the sensor was, in a bounded number of points: where there are too many, every second goes."""

    def __init__(self) -> None:
        self.points: list[Floats] = []
        self._step, self._seen = 1, 0

    def add(self, scan: Scan) -> None:
        """The mean origin of a scan's beams."""
        if self._seen % self._step == 0:
            origin = np.asarray(scan.origin, dtype=np.float64)
            self.points.append(origin if origin.ndim == 1 else origin.mean(axis=0))
            if len(self.points) > MAX_TRACK:
                self.points = self.points[::2]
                self._step *= 2
        self._seen += 1

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Floats:
        points = np.zeros((len(self.points), 3))
        if self.points:
            points[:, : len(self.points[0])] = self.points
        return points
