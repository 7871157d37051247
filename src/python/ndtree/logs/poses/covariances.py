# SPDX-License-Identifier: BSD-3-Clause
"""Covariances that come with poses: whether they say anything, and how sure a sensor's pose is at a time."""

from __future__ import annotations

import bisect
import math
from collections import deque

import numpy as np
from numpy.typing import ArrayLike

from ndtree._errors import key
from ndtree.base.scan import require_covariance
from ndtree.logs.core.arrays import Floats

#: What is done with covariances: taken if they are no driver's default, never, always.
AUTO, IGNORE, USE = ("auto", "ignore", "use")
#: A larger variance is a driver's word for an axis that it does not measure [m², rad²].
NOT_MEASURED = 1e3
#: Covariances that are remembered of a robot that drives.
REMEMBERED = 4096
_PLANAR = np.array([0, 1, 5])  # x, y and yaw.


class PoseCovariances:
    """Covariances of a topic's poses over time.

    Drivers that know none write zeros, -1, or the same numbers at all times. Wheel odometry writes what
    grows for ever: how unsure the way since the beginning is, not the map around the robot. "auto" takes
    covariances that change, and fall at least once, from then on.

    `topic`: For reports.
    `use`: {"auto", "ignore", "use"}.
    `dim`: Of the log: in the plane x, y and yaw count.
    `most`: As many of the last are remembered. Left out: all.
    Attributes:
    `told`: Poses with a covariance.
    `wrong`: Of these, how many had none that is one: not finite, not symmetric, or with negative eigenvalues.
    """

    def __init__(self, topic: str, use: str = AUTO, dim: int = 3, most: int | None = None) -> None:
        self.topic, self.use = topic, use
        self._axes = _PLANAR if dim == 2 else np.arange(6)
        self._stamps: deque[float] = deque(maxlen=most)
        self._rows: deque[Floats] = deque(maxlen=most)
        self.told = self.wrong = 0
        self._first: Floats | None = None
        self._last = 0.0
        self._changes = self._falls = False

    def add(self, stamp: float, covariance: ArrayLike | None) -> None:
        """What came with the pose of a time [s], 36 numbers or None; in any order."""
        if covariance is None or self.use == IGNORE:
            return
        self.told += 1
        row = np.array(covariance, dtype=np.float64).reshape(6, 6)
        unknown = np.abs(np.diag(row)) >= NOT_MEASURED
        row[unknown] = 0.0
        row[:, unknown] = 0.0
        part = row[np.ix_(self._axes, self._axes)]
        try:
            require_covariance(part, 2 if len(part) == 3 else 3)
        except ValueError:
            self.wrong += 1
            return
        size = float(np.trace(part))
        if self._first is None:
            self._first = part
        else:
            self._changes |= not np.array_equal(part, self._first)
            self._falls |= size < (1 - 1e-9) * self._last
        self._last = size
        whole = np.zeros((6, 6))
        whole[np.ix_(self._axes, self._axes)] = part
        at = len(self._stamps)
        if at and stamp < self._stamps[-1]:
            at = bisect.bisect_right(self._stamps, stamp)
        if self._stamps.maxlen is not None and len(self._stamps) == self._stamps.maxlen:
            self._stamps.popleft()
            self._rows.popleft()
            at = max(at - 1, 0)
        self._stamps.insert(at, stamp)
        self._rows.insert(at, whole)

    @property
    def are_used(self) -> bool:
        """Whether scans get them, by what came so far."""
        if self.use == AUTO:
            return self._changes and self._falls
        return self.use == USE and self._first is not None

    def at(self, stamp: float, lever: ArrayLike) -> Floats | None:
        """Covariance of the pose of a sensor at a time; None where they are not used.

        `stamp`: Between those of poses, covariances are interpolated; outside, the nearest holds [s].
        `lever` (3,): The sensor's place as seen from the body's, along the axes of the map [m].
        """
        if not self.are_used:
            return None
        after = bisect.bisect_left(self._stamps, stamp)
        before = max(after - 1, 0)
        after = min(after, len(self._stamps) - 1)
        span = self._stamps[after] - self._stamps[before]
        share = min(max((stamp - self._stamps[before]) / span, 0.0), 1.0) if span > 0 else 0.0
        body = (1 - share) * self._rows[before] + share * self._rows[after]
        x, y, z = np.asarray(lever, dtype=np.float64)
        there = np.eye(6)
        there[:3, 3:] = [[0, z, -y], [-z, 0, x], [y, -x, 0]]
        result: Floats = there @ body @ there.T
        return result

    def note(self) -> str | None:
        """What a user should know, in a line; None if there is nothing."""
        wrong = f"; {self.wrong} of {self.told} are none" if self.wrong else ""
        if self.are_used:
            rows = np.array(self._rows)
            place = float(np.median(np.sqrt(np.trace(rows[:, :3, :3], axis1=1, axis2=2))))
            turn = math.degrees(float(np.median(np.sqrt(np.trace(rows[:, 3:, 3:], axis1=1, axis2=2)))))
            said = f"standard deviations of {place:.3g} m and {turn:.2g} degrees in the median{wrong}"
            leave = f"{key('pose_covariance')} ignore leaves them"
            return f"the covariances of {self.topic} widen beams: {said}; {leave}"
        if self.use == AUTO and self._changes and not self._falls:
            said = f"the covariances of {self.topic} only grow, as those of odometry do, and are left out"
            return f"{said}; {key('pose_covariance')} use takes them{wrong}"
        return None
