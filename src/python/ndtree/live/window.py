# SPDX-License-Identifier: BSD-3-Clause
"""A window that moves with a robot: what is far away is forgotten."""

from __future__ import annotations

import math

import numpy as np

from ndtree._errors import WrongValue
from ndtree._native._core import OccupancyMap
from ndtree.base.scan import Scan
from ndtree.live.way import last_origin

#: The window follows when the sensor has moved by this share of its radius.
FOLLOWS = 0.05


class Window:
    """Keeps what is within a radius of the sensor.

    Parameters
    ----------
    radius : float
        Cells farther than that from where the sensor is are forgotten [m]; those that it sees beyond are
        forgotten with the next step of the window, after at most 5 % of the radius.

    Raises
    ------
    ValueError
        If it is not > 0 and finite.
    """

    def __init__(self, radius: float) -> None:
        if not 0 < radius < math.inf:
            raise WrongValue.of("window", f"{radius:g} m", "> 0 and finite")
        self.radius = radius
        self.begin()

    def begin(self) -> None:
        """Begin with an empty map."""
        self._center: np.ndarray | None = None

    def moved(self, m: OccupancyMap, scan: Scan) -> None:
        """Forget what is far from a scan's sensor, if that has moved enough."""
        center = last_origin(scan)
        if center is None:
            return
        if self._center is None or np.linalg.norm(center - self._center) >= FOLLOWS * self.radius:
            self._center = center
            m.keep_near(center, self.radius)
