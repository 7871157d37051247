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
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ndtree._errors import Text, key
from ndtree.alignment.planar import pose_of, wrapped
from ndtree.alignment.sensor_scans import SensorScan, sensor_scan
from ndtree.base.scan import Scan
from ndtree.tuning.revisits import MOST_RANGE, fitted, is_of_one_place

Floats = NDArray[np.float64]

#: Growth is a doubt if it turns a map by this much [rad] on the log's way, or on some metres [m] of a longer
#: one: a wall 5 m away is then a third of a metre off.
TURNED, MOST_WAY = math.radians(4.0), 100.0
_LEAST_PAIRS = 12
#: Between two scans of a pair, least and most [m]; nearer ones tell no growth, farther ones see others.
_NEAREST, _FARTHEST, _MOST_TURN = 0.03, 6.0, 1.0
#: What a radian of turning counts as way [m]: half the distance of usual wheels, times two.
_OF_TURN = 0.5
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


def heading_drift(runs: Sequence[Sequence[Scan]]) -> HeadingDrift | None:
    """Find whether the headings of a 2-D log drift as those of odometry do.

    `runs`: Consecutive scans in each, as from `ndtree.evaluation.sampling.spread`.
    Returns: None where they do not, or too little tells.
    """
    seen = [[sensor_scan(scan, MOST_RANGE) for scan in run] for run in runs if run and is_of_one_place(run)]
    errors = np.array([found for found in _errors_of(seen) if found is not None]).reshape(-1, 2)
    if len(errors) < _LEAST_PAIRS:
        return None
    squared, moved = errors[:, 0] ** 2, errors[:, 1]
    variance = (_JITTERS**2)[:, None, None] + _GROWTHS[:, None] * moved
    likelihood = (
        (-0.5 * np.log(variance) - 1.5 * np.log1p(squared / (2.0 * variance))).sum(axis=-1).max(axis=0)
    )
    best = int(likelihood.argmax())
    least = float(_GROWTHS[likelihood > likelihood[best] - _SURE][0])
    places = np.array([run[0].pose[:2] for run in seen])
    way = float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())
    if least * min(way, MOST_WAY) < TURNED**2:
        return None
    return HeadingDrift(float(_GROWTHS[best]), least, way)


def _errors_of(runs: Sequence[Sequence[SensorScan]]) -> Iterator[tuple[float, float] | None]:
    """Of pairs of scans: by how much the second has to be turned [rad], and its way from the first [m]."""
    for i, run in enumerate(runs):
        for k in sorted({1, len(run) - 1} if len(run) > 1 else ()):
            yield _error(run[:1], run[k], (0.6, 0.6, 0.2), 0.05)
        if i + 1 < len(runs):
            yield _error(run, runs[i + 1][0], (1.0, 1.0, 0.35), 0.1)


def _error(
    seen: Sequence[SensorScan], scan: SensorScan, window: tuple[float, float, float], cell: float
) -> tuple[float, float] | None:
    step = scan.pose - seen[0].pose
    turn = abs(float(wrapped(step[2])))
    moved = float(np.hypot(*step[:2])) + _OF_TURN * turn
    if not _NEAREST < moved < _FARTHEST or turn > _MOST_TURN:
        return None
    found = fitted(seen, scan, window, cell)
    return (
        None
        if found is None
        else (float(wrapped(pose_of(np.asarray(found[2].pose))[2] - scan.pose[2])), moved)
    )
