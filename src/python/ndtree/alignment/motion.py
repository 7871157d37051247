# SPDX-License-Identifier: BSD-3-Clause
"""How far a sensor may have moved, and the pose of a scan that fits best then."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from ndtree._native._core import Matcher
from ndtree.alignment.planar import Floats, between, pose_of, thinned
from ndtree.alignment.sensor_scans import SensorScan

SIGMAS = 3.0  # Of odometry, that the window has to each side.
LARGEST = np.array([1.0, 1.0, 0.5])  # Window of one step [m, m, rad].
AS_BEFORE = math.log(0.01)  # How often a sensor moves about as before, against odometry,
ANYHOW = math.log(0.001)  # and how often anyhow.
_SOME_TURN = 0.2  # Where a log does not say how far the sensor turned [rad].
_OF_MEDIAN = 1.4826  # Standard deviation over the median deviation, of a normal distribution.
_LEARNED_FROM = 500  # The last motions that tell how far odometry is wrong.
PIECE = 0.2  # End points on one piece of surface of this size are wrong alike: it counts once [m].


@dataclass(frozen=True)
class Motion:
    """How far odometry may be wrong, as standard deviations."""

    still: float = 0.02  # Of a place, whatever the way [m];
    still_angle: float = 0.01  # of the yaw [rad];
    rate: float = 0.1  # of a way, of a turn;
    turn: float = 0.02  # of the yaw for a way [rad/m].

    def sigmas(self, step: Floats, has_heading: bool) -> Floats:
        """Of x, y and yaw, for one motion."""
        way = math.hypot(step[0], step[1])
        place = self.still + self.rate * way
        turned = abs(step[2]) if has_heading else _SOME_TURN
        return np.array([place, place, self.still_angle + self.turn * way + self.rate * turned])


#: Of logs without odometry: the scan before moved so, this one does nearly.
NO_ODOMETRY = Motion(still=0.08, still_angle=0.05, rate=0.5, turn=0.1)


class LearnedRate:
    """How far odometry is wrong for a way, learned where scans tell the way themselves.

    `rate`: Beforehand; it counts as one scan.
    """

    def __init__(self, rate: float) -> None:
        self._before = rate
        self._ratios: deque[float] = deque(maxlen=_LEARNED_FROM)

    def learn(self, told: Floats, moved: Floats) -> None:
        """Take a motion by odometry and by scans."""
        square = float(told[:2] @ told[:2])
        if square > 0.0:
            self._ratios.append(float(told[:2] @ moved[:2]) / square)

    @property
    def rate(self) -> float:
        """A standard deviation: of the median ratio from 1, and of what is not known of it."""
        count = len(self._ratios)
        if count == 0:
            return self._before
        middle = float(np.median(self._ratios))
        scatter = _OF_MEDIAN * float(np.median(np.abs(np.array(self._ratios) - middle)))
        off = abs(middle - 1.0) * count / (1.0 + count)
        return math.hypot(off, max(scatter, self._before) / math.sqrt(1.0 + count))


@dataclass(frozen=True)
class Hypothesis:
    """How a sensor may have moved, and the pose that fits best then."""

    pose: Floats
    covariance: Floats
    score: float
    inliers: float
    posterior: float  # Logarithm, but for a constant.


def pieces_of(scan: SensorScan) -> int:
    """How many pieces of surface a scan sees."""
    return len(thinned(scan.points, PIECE))


def best_near(
    matcher: Matcher, scan: SensorScan, guess: Floats, sigmas: Floats, pieces: int, weight: float = 0.0
) -> Hypothesis:
    """The best pose around a guess, with the standard deviations of that.

    `pieces`: Of surface that the scan sees.
    `weight`: Logarithm of how often the sensor moves so.
    """
    match = matcher.match(
        scan.points,
        guess,
        window=np.minimum(SIGMAS * sigmas, LARGEST),
        information=np.diag(sigmas**-2),
        second=False,
    )
    pose = pose_of(match.pose)
    off = between(guess, pose) / sigmas
    prior = weight - float(np.log(sigmas).sum()) - 0.5 * float(off @ off)
    return Hypothesis(pose, match.covariance, match.score, match.inliers, pieces * match.score + prior)
