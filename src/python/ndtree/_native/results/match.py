# SPDX-License-Identifier: BSD-3-Clause
"""Poses that were found."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_NEARLY = 0.9  # A pose that explains so much of what the best does is another explanation.


@dataclass(frozen=True, eq=False, repr=False)
class Match:
    """The pose of a scan that was found.

    Attributes
    ----------
    pose : (dim + 1, dim + 1) float64
        Of the sensor in the map.
    covariance : (3, 3) or (6, 6) float64
        Of x, y, yaw, or of x, y, z, roll, pitch, yaw, along and about the map's axes [m, rad].
    score : float
        Mean likelihood of the end points at the best pose of the window's grid, 0 to 1.
    second : float
        The same of the best pose elsewhere in the window; 0 if there is none, or it was not looked for.
    inliers : float
        Fraction of the points that lie on a surface at the refined pose.
    """

    pose: NDArray[np.float64]
    covariance: NDArray[np.float64]
    score: float
    second: float
    inliers: float

    @property
    def is_unique(self) -> bool:
        """bool: whether no other pose of the window explains the scan nearly (nine tenths) as well."""
        return self.score > 0 and self.second < _NEARLY * self.score

    def __repr__(self) -> str:
        place = ", ".join(f"{x:.3f}" for x in self.pose[:-1, -1])
        others = "unique" if self.is_unique else f"second={self.second:.2f}"
        return f"Match(at ({place}), score={self.score:.2f}, {others}, inliers={self.inliers:.2f})"
