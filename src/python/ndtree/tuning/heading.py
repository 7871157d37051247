# SPDX-License-Identifier: BSD-3-Clause
"""How fast the headings of a planar laser's poses drift, from scans that are near each other on the way.

Strategy: scans are matched with others of their run and with the run before. By how much they have to be
turned has two parts: what every pose errs by itself, and what odometry adds on the way. The squared error
between two scans is ``jitter² + growth · way`` in the mean; only odometry has growth, and poses of a SLAM
system have none. Both are the likeliest ones (Student's t with two degrees of freedom, for some matches are
wrong), and growth counts by its lower bound.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ndtree._errors import Text, key
from ndtree.tuning.pairs import Pairs

Floats = NDArray[np.float64]

#: Growth is a doubt if it turns a map by this much [rad] on the log's way, or on some metres [m] of a longer
#: one: a wall 5 m away is then a third of a metre off.
TURNED, MOST_WAY = math.radians(4.0), 100.0
_LEAST_PAIRS = 12
#: Deviations [rad] and growths [rad²/m] that are tried.
_JITTERS = np.radians(np.geomspace(0.1, 3.0, 40))
_GROWTHS = np.concatenate([[0.0], np.radians(1.0) ** 2 * np.geomspace(0.01, 100.0, 81)])
_SURE = 1.92  # Of the log likelihood: growth is larger than its lower bound with 97.5 %.


@dataclass(frozen=True)
class HeadingDrift:
    """By how much poses of a log turn otherwise than its scans, from `heading_drift`."""

    growth: float  # Of the variance [rad²/m].
    least: float  # The same, with 97.5 %.
    way: float  # Of the robot [m].

    def __str__(self) -> str:
        """What was found and what helps, in one line."""
        turned = math.degrees(math.sqrt(self.growth * self.way))
        return Text(
            f"from scan to scan, poses turn otherwise than what the laser sees: about {turned:.0f} degrees "
            f"over the {self.way:.0f} m of the path; use {key('align')} or the poses of a SLAM system"
        )


def heading_drift(matched: Pairs) -> HeadingDrift | None:
    """Find whether the headings of a 2-D log drift as those of odometry do.

    Returns: None where they do not, or too little tells.
    """
    near = [pair for pair in matched.near if pair.is_near and pair.is_matched]
    errors = np.array([(pair.error[2], pair.way) for pair in near]).reshape(-1, 2)
    if len(errors) < _LEAST_PAIRS:
        return None
    squared, moved = errors[:, 0] ** 2, errors[:, 1]
    variance = (_JITTERS**2)[:, None, None] + _GROWTHS[:, None] * moved
    likelihood = (
        (-0.5 * np.log(variance) - 1.5 * np.log1p(squared / (2.0 * variance))).sum(axis=-1).max(axis=0)
    )
    best = int(likelihood.argmax())
    least = float(_GROWTHS[likelihood > likelihood[best] - _SURE][0])
    places = np.array([run[0].pose[:2] for run in matched.runs])
    way = float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())
    if least * min(way, MOST_WAY) < TURNED**2:
        return None
    return HeadingDrift(float(_GROWTHS[best]), least, way)
