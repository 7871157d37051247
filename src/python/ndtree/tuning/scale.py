# SPDX-License-Identifier: BSD-3-Clause
"""Whether scans are in metres and in one frame: ranges and jumps beside the size of the cells."""

from __future__ import annotations

import math

import numpy as np

from ndtree._errors import Text, key
from ndtree.base.scan import Scan

#: More smallest cells on a beam, or from one scan's origin to the next, than sensors and robots have:
#: of 0.05 m they are 1 km.
MOST_CELLS = 20_000


class Scale:
    """What of some scans is absurdly large for cells of a size; silent for those who gave a `max_range`.

    `cell_size`: Of the smallest cells [m].
    `max_range`: Longer beams are cut there: those who say so mean it [m].
    """

    def __init__(self, cell_size: float, max_range: float = math.inf) -> None:
        self._cell, self._max_range = cell_size, max_range
        self._limit = MOST_CELLS * cell_size
        self._number = 0
        self._far: tuple[int, float] | None = None
        self._jump: tuple[int, float] | None = None
        self._at: np.ndarray | None = None

    def add(self, scan: Scan) -> None:
        """Look at the next scan."""
        if len(scan):
            origin = scan.origin if scan.origin.ndim == 1 else scan.origin[0]
            if self._far is None and math.isinf(self._max_range):
                apart = np.abs(scan.endpoints - scan.origin)
                longest = float(apart[np.isfinite(apart)].max(initial=0.0))
                if longest > self._limit:
                    self._far = (self._number, longest)
            if self._at is not None and self._jump is None:
                jump = float(np.abs(origin - self._at).max())
                if jump > self._limit:
                    self._jump = (self._number, jump)
            if np.isfinite(origin).all():
                self._at = origin
        self._number += 1

    def warning(self) -> str | None:
        """The first that is absurd, and what it may be, in one line; None if nothing is."""
        if self._far is not None:
            number, length = self._far
            return Text(
                f"scan {number} has a beam of {length:,.0f} m, {length / self._cell:,.0f} cells: expected "
                "metres, and origins in the frame of the end points; if it is right, set "
                f"{key('max_range')}"
            )
        if self._jump is not None:
            number, length = self._jump
            return Text(
                f"scan {number} lies {length:,.0f} m from the one before: expected all scans in one frame, "
                f"such as UTM or a local one, and {key('origin')} for coordinates far away"
            )
        return None
