# SPDX-License-Identifier: BSD-3-Clause
"""A way for a body through a map."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False, repr=False)
class Path:
    """A way from a start to a goal; true if one was found.

    Attributes
    ----------
    points : (n, dim) float64
        From start to goal [m], straight between them; (0, dim) without one.
    status : {"found", "none", "out of time"}
        Why there is none: no chain of free cells leads to the goal, so there is none for a body that is a
        smallest cell larger on each side; or the search had no time left.
    length : float
        [m]; inf without one.
    clearance : float
        Least distance of the body to an obstacle on the way [m]; nan without one.
    expanded : int
        Cells that the search looked at.
    """

    points: NDArray[np.float64]
    status: Literal["found", "none", "out of time"]
    length: float
    clearance: float
    expanded: int

    def __bool__(self) -> bool:
        return self.status == "found"

    def __len__(self) -> int:
        return len(self.points)

    def __repr__(self) -> str:
        if not self:
            return f"Path({self.status}, {self.expanded:,} cells expanded)"
        return f"Path({len(self)} points, {self.length:.3f} m, clearance {self.clearance:.3f} m)"
