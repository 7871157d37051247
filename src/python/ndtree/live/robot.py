# SPDX-License-Identifier: BSD-3-Clause
"""Where a robot's base is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ndtree.base.scan import Scan
from ndtree.live.intake import Intake


class Robot:
    """Follows a robot's base in the map; the sensor, where nothing tells how that moves on the robot.

    It gets scans as a `Way` does, from the thread that maps.

    `intake`: Knows the poses of the last scan.
    Attributes:
    `position` (3,) or None: Of the base at the last scan [m]; None before the first.
    """

    def __init__(self, intake: Intake) -> None:
        self._intake = intake
        self.position: NDArray[np.float64] | None = None

    def begin(self) -> None:
        """Forget where it was."""
        self.position = None

    def add(self, scan: Scan) -> None:
        """Take note of where it was when a scan was measured."""
        motion = self._intake.motion()
        if motion is not None:
            self.position = (motion.sensor @ motion.mount.inverse()).position
            return
        origins = np.atleast_2d(scan.origin)
        if len(origins) and np.isfinite(origins[-1]).all():
            self.position = np.r_[origins[-1], np.zeros(3 - scan.dim)]
