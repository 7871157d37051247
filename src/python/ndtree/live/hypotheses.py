# SPDX-License-Identifier: BSD-3-Clause
"""Poses where a robot may be, and how its beams weigh them.

The likelihood of a scan is that of its beams: each is compared with where the map ends a ray from the same
pose. One that ends there is as expected; one that passes through what is occupied contradicts the pose most,
one that ends before it less, since people stand there; one that ends in unknown space says neither. A pose
outside of the map has all beams in unknown space, so that *the robot is not in this map* is a hypothesis like
the others.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ndtree._native._core import OccupancyMap

Floats = NDArray[np.float64]

#: Likelihood of a beam, relative to one that ends where it is expected: through what is occupied (glass,
#: and what left), before it (people, and what came), and in unknown space.
THROUGH, BEFORE, UNKNOWN = 0.02, 0.05, 0.5
#: Logarithm of the likelihood of a scan that is not in the map, for each piece of surface that it sees.
NOT_HERE = math.log(UNKNOWN)
#: Parts of a turn whose beams err alike.
SECTORS = 180
#: End points on one piece of surface of this size err alike, and count once [m].
PIECE = 0.2
#: Poses as far from each other are of different places [m, rad].
APART = 0.5, 0.35
#: How often, in a scan, odometry slips or a robot is carried; and what a normal distribution has beyond three
#: standard deviations.
SLIPS, CARRIED, BEYOND = math.exp(-7.5), math.exp(-9.0), 0.0027
#: Standard deviations of one pose that is found twice, from the grid's steps [m, rad].
SAME = 0.02, 0.015


@dataclass(frozen=True)
class Evidence:
    """What a scan says for a pose.

    `by_bearing` (SECTORS,) float64: Log-likelihood of the scan, as a sum over bearings in the sensor's frame.
    `pieces`: Of surface that it sees: as many beams are independent.
    `known`: Fraction of beams that the map ends on a surface.
    """

    by_bearing: Floats
    pieces: int
    known: float

    @property
    def mean(self) -> float:
        """Of the beams: 0 if all end as expected, NOT_HERE if it is not in the map."""
        return self.total / self.pieces if self.pieces else NOT_HERE

    @property
    def total(self) -> float:
        return float(self.by_bearing.sum())


def scan_evidence(m: OccupancyMap, noise: tuple[float, float], pose: Floats, ends: Floats) -> Evidence:
    """What end points (n, 2) in the sensor's frame say for a (3, 3) pose in a 2-D map; O(n) rays.

    `noise`: `range_sigma` and `range_sigma_quadratic` of the map.
    """
    # For all beams that a cell ends alike, its surface is anywhere in it, or just before it.
    deep = m.min_cell_size
    begin = 2.0 * deep  # The sensor's own cell may be unknown.
    ranges = np.hypot(ends[:, 0], ends[:, 1])
    ends, ranges = ends[ranges > begin], ranges[ranges > begin]
    if not len(ends):
        return Evidence(np.zeros(SECTORS), 0, 0.0)
    bearings = np.arctan2(ends[:, 1], ends[:, 0])
    order = np.argsort(bearings, kind="stable")
    ends, ranges, bearings = ends[order], ranges[order], bearings[order]
    ahead = ends / ranges[:, None] @ pose[:2, :2].T
    cast = m.cast_rays(pose[:2, 2] + begin * ahead, ahead, unknown="stop", details=True)
    first = np.where(np.isnan(cast.distance), np.inf, cast.distance + begin)
    last = np.where(cast.state == 1, first, np.inf)
    # Between a ray and those beside it, a surface may be anywhere.
    first = np.minimum(first, np.minimum(np.roll(first, 1), np.roll(first, -1)))
    is_known = np.isfinite(last)
    last = np.maximum(last, np.maximum(np.roll(last, 1), np.roll(last, -1)))
    before = np.maximum(first - ranges - 0.5 * deep, 0.0)
    through = np.maximum(ranges - last - deep, 0.0)
    sigma = np.hypot(0.5 * deep, noise[0] + noise[1] * np.square(ranges))
    near = np.exp(-0.5 * np.square(np.maximum(before, through) / sigma))
    least = np.where(before > 0.0, BEFORE, THROUGH)
    likely = least + (1.0 - least) * near
    likely = np.where(is_known, likely, np.minimum(likely, UNKNOWN))
    return evidence_by(ends, np.log(likely), is_known)


def evidence_by(ends: Floats, likely: Floats, is_known: NDArray[np.bool_]) -> Evidence:
    """By beams' end points (n, dim), log-likelihoods, and whether the map ends them on a surface."""
    if not len(ends):
        return Evidence(np.zeros(SECTORS), 0, 0.0)
    bearings = np.arctan2(ends[:, 1], ends[:, 0])
    sectors = np.floor((bearings + math.pi) * (SECTORS / (2.0 * math.pi))).astype(np.int64) % SECTORS
    pieces = pieces_of(ends)
    by_bearing = np.bincount(sectors, likely, SECTORS) * (pieces / len(ends))
    return Evidence(by_bearing, pieces, float(is_known.mean()))


def pieces_of(ends: Floats) -> int:
    """How many pieces of surface end points (n, dim) are on, seen from above."""
    x, y = np.floor(ends[:, :2] / PIECE).astype(np.int64).T
    return len(np.unique(x * 1_000_003 + y))


def motion_between(one: Floats, other: Floats) -> Floats:
    """(dim + 1,): along the map's axes and yaw, from one pose to another that is as upright."""
    turn = other[:2, :2] @ one[:2, :2].T
    return np.array([*(other - one)[:-1, -1], math.atan2(turn[1, 0], turn[0, 0])])


def lengths_of(motion: Floats) -> tuple[float, float]:
    """How far a motion goes [m], and turns [rad]."""
    return float(np.linalg.norm(motion[:-1])), abs(float(motion[-1]))


@dataclass(frozen=True)
class Prior:
    """Where a robot that was tracked may be: as odometry says; or it slipped, or was carried anywhere.

    `map_odometry`: Of the pose that odometry says, with
    `covariance`: of its freedoms in the map.
    `extent` (dim,) float64: Of the map [m].
    `scans`: In which it may have been carried unseen.
    """

    map_odometry: Floats
    covariance: Floats
    extent: Floats
    scans: int

    def of(self, other: Floats, at: Floats) -> float:
        """Logarithm for the place that another odometry's frame in the map is of, with odometry at a pose."""
        away = motion_between(self.map_odometry @ at, other @ at)
        told = math.exp(-0.5 * float(away @ np.linalg.solve(self.covariance, away)))
        slipped = SLIPS / _places(2.0 * np.abs(away[:-1]), 2.0 * abs(away[-1]))
        carried = CARRIED / _places(self.extent, 2.0 * math.pi)
        return math.log(told + self.scans * (slipped + carried))


def _places(extent: Floats, turn: float) -> float:
    """How many different places there are in a box of an extent [m] and a range of yaws [rad]."""
    return float(np.prod(np.maximum(extent / APART[0], 1.0))) * max(turn / APART[1], 1.0)


@dataclass
class Viewpoint:
    """Scans from about one place, which say the same: they count as one.

    `odometry`: Of the first of them.
    `ends`: Its end points.
    `pieces`: Of surface that it sees.
    """

    odometry: Floats
    ends: Floats
    pieces: int


@dataclass(eq=False)
class Hypothesis:
    """Where the robot may be.

    `map_odometry` (dim + 1, dim + 1) float64: The odometry's frame in the map.
    `covariance` (dim + 1, dim + 1) float64: Of x, y, z in space, and yaw of the sensor in the map at the
    last match.
    `matched`, optional: Odometry of that.
    `prior`: Logarithm, before all viewpoints.
    `failed`: Scans in a row that did not fit.
    `seen` list of (SECTORS,) float64: The mean evidence of the scans of each viewpoint, by bearing.
    `scans`: Of each viewpoint.
    `untold`: Scans in a row that told nothing of some way.
    `ways`: On how many axes.
    """

    map_odometry: Floats
    covariance: Floats
    matched: Floats | None = None
    prior: float = 0.0
    failed: int = 0
    seen: list[Floats] = field(default_factory=list)
    scans: list[int] = field(default_factory=list)
    untold: int = 0
    ways: int = 0

    @property
    def likely(self) -> float:
        """Log-likelihood of all viewpoints."""
        return float(np.sum(self.seen))

    @property
    def weight(self) -> float:
        """Logarithm of the posterior, but for a constant."""
        return self.prior + self.likely

    def see(self, evidence: Evidence, *, is_new: bool) -> None:
        """Take what a scan says, from a new viewpoint or the last one."""
        if is_new:
            self.seen.append(evidence.by_bearing)
            self.scans.append(1)
        else:
            self.scans[-1] += 1
            self.seen[-1] = self.seen[-1] + (evidence.by_bearing - self.seen[-1]) / self.scans[-1]

    def inherit(self, other: Hypothesis, prior: float) -> None:
        """Begin at another one before the last viewpoint, if that is likelier; by its logarithm `prior`."""
        if other.weight - float(other.seen[-1].sum()) + prior > self.weight:
            self.prior = other.prior + prior
            self.seen, self.scans = other.seen[:-1], other.scans[:-1]

    def slides(self, ways: int) -> None:
        """Note on how many axes a scan fits elsewhere, too."""
        self.ways = ways or self.ways
        self.untold = self.untold + 1 if ways else self.untold // 2

    def told_covariance(self, extent: Floats, covariance: Floats | None = None) -> Floats:
        """A covariance of the pose, that of the last match by default, and of what no scan would have told.

        Along ways of which scans tell nothing, odometry that slips or a robot that is carried goes unseen:
        then it may be anywhere in the map, `extent` [m] large. Three standard deviations hold as much
        of that as of a normal distribution.
        """
        unseen = -math.expm1(-self.untold * SLIPS)
        half = 0.5 * max(0.0, 1.0 - BEYOND / unseen) if self.untold else 0.0
        told = (self.covariance if covariance is None else covariance).copy()
        for way in np.linalg.eigh(self.covariance[:2, :2])[1].T[2 - self.ways :]:  # Where it is least sure.
            told[:2, :2] += (half * float(np.abs(way) @ extent[:2]) / 3.0) ** 2 * np.outer(way, way)
        return told

    def away(self, other: Hypothesis, at: Floats) -> Floats:
        """From this one's pose to another one's, with odometry at a pose: as `motion_between`."""
        return motion_between(self.map_odometry @ at, other.map_odometry @ at)

    def tells(self, other: Hypothesis, at: Floats, extent: Floats) -> bool:
        """Whether another one is within three standard deviations of what is told, or near, unfit."""
        away = self.away(other, at)
        way, turn = lengths_of(away)
        if other.failed and way < APART[0] and turn < APART[1]:
            return True
        return _is_within(away, self.told_covariance(extent) + other.covariance)

    def is_same(self, other: Hypothesis, at: Floats) -> bool:
        """Whether another one is within three standard deviations of the matches, at an odometry."""
        return _is_within(self.away(other, at), self.covariance + other.covariance)


def _is_within(away: Floats, covariance: Floats) -> bool:
    """Whether a pose that is away by a motion is within three standard deviations, and those of `SAME`."""
    both = covariance + np.diag(np.square([SAME[0]] * (len(away) - 1) + [SAME[1]]))
    return float(away @ np.linalg.solve(both, away)) < 9.0


def leads(hypotheses: Sequence[Hypothesis], pieces: Sequence[int]) -> Floats:
    """(n, n): logarithms of how much likelier each hypothesis is than each other one.

    Where a viewpoint's scans are likelier out of the map, something else was before the sensor: they count
    as out of the map, by the `pieces` of surface that the viewpoint sees. Because of glass, people and gaps
    in the map, evidence is not calibrated. A difference D of it counts in full only against a hypothesis. For
    it, where few bearings make all of it, chance may: with the sum V of its squares over bearings, it is no
    more than D^2 / 2V, by which a mean of D is likelier than one of 0.
    """
    seen = np.array([one.seen for one in hypotheses]).reshape(len(hypotheses), -1, SECTORS)
    least = np.minimum(NOT_HERE * np.array(pieces[: seen.shape[1]], dtype=np.float64), -1e-12)
    seen *= (least / np.minimum(seen.sum(axis=2), least))[:, :, None]
    seen = seen.reshape(len(hypotheses), -1)
    prior, total, products = np.array([one.prior for one in hypotheses]), seen.sum(axis=1), seen @ seen.T
    off = total[:, None] - total
    squares = np.diag(products)[:, None] + np.diag(products) - 2.0 * products
    off *= np.minimum(1.0, np.where(off > 0.0, 0.5 * off / np.maximum(squares, 1e-12), 1.0))
    found: Floats = prior[:, None] - prior + off
    return found
