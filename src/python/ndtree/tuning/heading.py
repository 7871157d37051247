# SPDX-License-Identifier: BSD-3-Clause
"""How fast the headings of a planar laser's poses drift, from scans that are near each other on the way.

Strategy: scans are matched with others of their run and with the run before. By how much they have to be
turned has three parts: what every pose errs by itself, and what odometry adds on the way, at random and
always to one side. The error between two scans has the mean ``side · distance`` and the variance ``jitter² +
growth · way``; only odometry has growth and side, and poses of a SLAM system have none. All are the likeliest
ones (Student's t with two degrees of freedom, for some matches are wrong), and what they turn the map by
together counts by its lower bound.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ndtree._errors import Text, key
from ndtree.tuning.pairs import Pairs

Floats = NDArray[np.float64]

#: A doubt if a map is turned by this much [rad] on the log's way, or on some metres [m] of a longer one: a
#: wall 5 m away is then a third of a metre off.
TURNED, MOST_WAY = math.radians(4.0), 100.0
_LEAST_PAIRS = 12
#: Deviations [rad], growths [rad²/m] and turns to the right and left [rad/m] that are tried.
_JITTERS = np.radians(np.geomspace(0.1, 3.0, 14))
_GROWTHS = np.concatenate([[0.0], np.radians(1.0) ** 2 * np.geomspace(0.01, 100.0, 28)])
_SIDES = np.radians(np.concatenate([[0.0], *(sign * np.geomspace(0.05, 6.0, 16) for sign in (-1, 1))]))
#: Of the log likelihood, of growth alone and of both: the map is turned by more than the least with 97.5 %.
_SURE = ((1, 1.92), (len(_SIDES), 3.69))


@dataclass(frozen=True)
class HeadingDrift:
    """By how much poses of a log turn differently from its scans, from `heading_drift`."""

    turned: float  # On the way [rad].
    least: float  # The same on `MOST_WAY` at most, with 97.5 %.
    way: float  # Of the robot [m].

    def __str__(self) -> str:
        """What was found and what helps, in one line."""
        turned = math.degrees(self.turned)
        return Text(
            "from scan to scan, poses turn differently from what the laser sees: by about "
            f"{turned:.0f} degrees over a path of {self.way:.0f} m; use {key('align')} or the poses of a "
            "SLAM system"
        )


def heading_drift(matched: Pairs) -> HeadingDrift | None:
    """Find whether the headings of a 2-D log drift as those of odometry do.

    Returns: None where they do not, or too little tells.
    """
    near = [pair for pair in matched.near if pair.is_near and pair.is_matched]
    if len(near) < _LEAST_PAIRS:
        return None
    error, way, distance = np.array([(one.error[2], one.way, np.hypot(*one.told[:2])) for one in near]).T
    variance = (_JITTERS**2)[:, None, None, None] + (_GROWTHS[:, None] * way)[:, None]
    squared = (error - _SIDES[:, None] * distance) ** 2
    likelihood = (
        (-0.5 * np.log(variance) - 1.5 * np.log1p(squared / (2.0 * variance))).sum(axis=-1).max(axis=0)
    )
    places = np.array([run[0].pose[:2] for run in matched.runs])
    driven = float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())

    def turned(metres: float) -> Floats:
        return np.hypot(np.sqrt(_GROWTHS * metres)[:, None], _SIDES * metres)

    angles = turned(min(driven, MOST_WAY))
    least = max(
        float(angles[:, :sides][likelihood[:, :sides] > likelihood[:, :sides].max() - sure].min())
        for sides, sure in _SURE
    )
    if least < TURNED:
        return None
    return HeadingDrift(float(turned(driven).flat[likelihood.argmax()]), least, driven)
