# SPDX-License-Identifier: BSD-3-Clause
"""Whether scans of a planar laser see through what others saw from the same place, whatever the cause.

Strategy: of two scans whose poses are near each other, what one measured on surfaces lies on those of the
other, or in the free space before them; what lies behind them says nothing. People and doors make some of it
lie in free space, of some pairs. Where poses are wrong, much of it does, of most pairs: one scan before and
one after a robot was carried without its poses' notice, or two of a place that it visits again.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ndtree._errors import Text, key
from ndtree.alignment.planar import Floats, between, placed, wrapped
from ndtree.alignment.sensor_scans import SensorScan
from ndtree.base.words import percent
from ndtree.tuning.pairs import Pairs

#: Share of what is seen in free space from which poses are wrong, of most pairs, and how many it takes. Of
#: those before and after one scan a quarter has at most 0.19 in worlds with crowds, 0.1 with one person.
CONTRADICTS, LEAST_PAIRS = 0.2, 3
#: Distance and turn between poses of a pair at most [m, rad], and runs; or they visit a place again.
_NEAR, _TURNED, _FOLLOW = 1.5, 1.0, 6
#: How far poses and ranges may err, and by how much more for each metre [m].
_MARGIN, _GROWS = 0.4, 0.1
_ON_SURFACE = 0.3  # Of neighbouring end points, their distance [m]: what is thinner is seen past.
_DENSE = math.radians(3.0)  # Between beams that would not miss a surface.
_FEWEST = 40  # End points that can be compared.


@dataclass(frozen=True)
class Contradiction:
    """How much of what scans see lies where others saw free space, from `contradiction`.

    `share`: In the median of places, or at least of three quarters of the pairs before and after.
    `since`: Time of the first scan that does not fit those before [s], from the log's first scan on; nan of
        places that are visited again, or where scans have no times.
    """

    share: float
    since: float

    def __str__(self) -> str:
        """What was found and what helps, in one line."""
        share = percent(self.share)
        if math.isfinite(self.since):
            return Text(
                f"poses do not fit the scans: from {self.since:.1f} s on, {share} of what is seen "
                "lies where scans from the same place saw free space; was the robot carried? Stop before it "
                f"with {key('stop')}, or use {key('align')}"
            )
        return Text(
            f"poses do not fit the scans: where the robot returns, {share} of what is seen "
            f"lies in what was free; use {key('align')} or the poses of a SLAM system"
        )


def contradiction(log: Pairs) -> Contradiction | None:
    """Find whether scans of a 2-D log contradict each other.

    Returns: None where they do not, or too little tells; what looks alike elsewhere does not contradict.
    """
    scans = [_View(run[0]) for run in log.runs]
    poses = np.array([scan.pose for scan in scans]).reshape(-1, 3)
    following, again = [], []
    for j in range(len(scans)):
        off = poses[:j] - poses[j]
        distance = np.hypot(off[:, 0], off[:, 1])
        distance[(distance > _NEAR) | (np.abs(wrapped(off[:, 2])) > _TURNED)] = math.inf
        others = np.flatnonzero(np.isfinite(distance))
        following += [(i, j, _seen_through(scans[i], scans[j])) for i in others[others >= j - _FOLLOW]]
        others = others[others < j - _FOLLOW]
        if len(others):
            nearest = others[distance[others].argmin()]
            again.append((nearest, j, _seen_through(scans[nearest], scans[j])))
    first, second, share = np.array([one for one in following if one[2] is not None]).reshape(-1, 3).T
    best = 0.0, 0
    for j in second[(second - first == 1) & (share > CONTRADICTS)]:  # At once, not little by little.
        across = share[(first < j) & (second >= j)]
        if len(across) >= 2 * LEAST_PAIRS:
            best = max(best, (float(np.quantile(across, 0.25)), int(j)))
    if best[0] > CONTRADICTS:
        has_times = scans[-1].stamp != scans[0].stamp
        return Contradiction(best[0], scans[best[1]].stamp - log.begin if has_times else math.nan)
    shares = [one[2] for one in again if one[2] is not None]
    if len(shares) < LEAST_PAIRS or np.median(shares) <= CONTRADICTS:
        return None
    return Contradiction(float(np.median(shares)), math.nan)


class _View:
    """What a scan sees: its end points by their angles, and the ones that lie on surfaces."""

    def __init__(self, scan: SensorScan) -> None:
        self.pose, self.stamp = scan.pose, scan.stamp
        far, angle = np.hypot(*scan.points.T), np.arctan2(scan.points[:, 1], scan.points[:, 0])
        order = np.argsort(angle)
        self._far, self._angle = far[order], angle[order]
        gaps = np.hypot(*np.diff(scan.points, axis=0).T) < _ON_SURFACE
        self._on_surfaces = scan.points[1:-1][gaps[1:] & gaps[:-1]]

    def counts(self, other: _View) -> Floats:
        """(2,) end points of another scan in what this one sees free, and on what it sees."""
        if len(self._angle) < 2:
            return np.zeros(2)
        x, y = placed(between(self.pose, other.pose), other._on_surfaces).T
        far, angle = np.hypot(x, y), np.arctan2(y, x)
        after = np.searchsorted(self._angle, angle).clip(1, len(self._angle) - 1)
        low, high = self._angle[after - 1], self._angle[after]
        is_between = (low <= angle) & (angle <= high) & (high - low < _DENSE)
        margin = _MARGIN + _GROWS * far
        beyond = np.stack([self._far[after - 1], self._far[after]]) - far
        free = (beyond > margin).all(axis=0)
        on = ~free & (beyond > -margin).any(axis=0)
        return np.array([np.count_nonzero(which & is_between) for which in (free, on)], dtype=np.float64)


def _seen_through(one: _View, other: _View) -> float | None:
    """Share of what two scans see of surfaces that is in what the other sees free; None of too few points."""
    counts = one.counts(other) + other.counts(one)
    return counts[0] / counts.sum() if counts.sum() >= _FEWEST else None
