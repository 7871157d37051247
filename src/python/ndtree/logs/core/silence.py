# SPDX-License-Identifier: BSD-3-Clause
"""Readings that measured nothing: padding, and those at the largest range of a log."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ndtree._native._core import points_within
from ndtree.base.scan import Scan
from ndtree.logs.core.arrays import Bools, Floats, Points

#: This many readings of one scan at the largest range of all are cut off there, not measured.
LEAST_CUT_OFF = 2
#: Of the largest range: readings so near below it are fewer than those at it.
NEAR = 0.01
#: Coordinates in files have at most this many decimals where they are rounded to be read by people.
_MOST_DECIMALS = 6
#: Points that are looked at for these.
_MOST_POINTS = 1000
#: Of the largest range: noise that reaches farther is none of a sensor.
NOISE_REACH = 0.1
#: Half of the values of a bell are nearer to its middle than this many standard deviations, and all but one
#: in 16,000 than that many.
_HALF, _ALL = 0.6745, 4.0
#: Fewer readings do not tell a bell from a surface that is there by chance.
LEAST_NOISY = 64
#: Kolmogorov's limit at 95 % for the square root of the readings times their distance from a bell's shares;
#: a distance of _BESIDE is left to surfaces that are there, too.
_KOLMOGOROV, _BESIDE = 1.36, 0.1
#: As many readings tell all there is to know.
MOST_NOISY = 20_000


def noise_below(below: Points, there: int) -> float:
    """How far noise reaches below a limit at which `there` readings are, its other half [m]; 0 if none does.

    `below` (ndarray, (n,)): Distances of other readings from the limit, up to `NOISE_REACH` of it [m].
    `there`: Readings at the limit, and above.
    """
    half = (there + 1) // 2
    if len(below) < max(half, LEAST_NOISY) or there < LEAST_NOISY // 2:
        return 0.0
    below = np.sort(below.astype(np.float64))
    noisy = below[below <= _ALL * float(below[half - 1]) / _HALF]
    if not max(half, LEAST_NOISY) <= len(noisy) <= 2 * there:
        return 0.0
    return _reach_of_half_a_bell(noisy, _BESIDE)


def noise_below_alone(below: Points, farthest: float) -> float:
    """How far noise reaches below a limit at which no readings are: they fell out, or were not let there.

    Half a bell from the limit on tells it from surfaces, of which there are the more the farther away.
    `farthest`: What `below` goes to [m].
    """
    below = np.sort(below.astype(np.float64))
    n, before = 8 * LEAST_NOISY, 0
    while before < n <= len(below):  # From its dense part on, until it ends.
        before = n
        reach = _ALL * float(below[n // 2]) / _HALF
        n = int(np.searchsorted(below, reach, side="right"))
    if n != before or 2 * reach > farthest:
        return 0.0
    return _reach_of_half_a_bell(below[:n], _BESIDE / 2)


def noise_around(below: Floats, farthest: float) -> tuple[float, float, bool]:
    """Where a peak at a largest range ends, its standard deviation [m], and whether it is a bell; else 0.

    Nothing is just below it. A surface that stays as far away makes one, too.
    `below` (ndarray, (n,)): Distances of readings from the largest of all [m], up to `farthest`.
    """
    below = np.sort(below)
    n, before = 2 * LEAST_NOISY, 0
    middle = sigma = 0.0
    while before != n <= len(below):  # From its upper end down, until it ends.
        before = n
        middle = float(np.median(below[:n]))
        sigma = float(np.median(np.abs(below[:n] - middle))) / _HALF
        if sigma < 10**-_MOST_DECIMALS:  # Most are in one step.
            sigma = float(below[:n].std())
        n, beyond = (int(np.searchsorted(below, middle + k * _ALL * sigma, side="right")) for k in (1, 2))
        n = max(beyond if beyond > (1 + _BESIDE) * n else n, before)
    if n == before and (sigma := float(below[:n].std())) > 0:
        middle = float(below[:n].mean())
        values, counts = np.unique(np.round(below[:n], _MOST_DECIMALS), return_counts=True)  # In whole steps.
        shares = [0.5 + 0.5 * math.erf(v) for v in ((values - middle) / (math.sqrt(2) * sigma)).tolist()]
        apart = np.abs(shares - (np.cumsum(counts) - counts / 2) / n).max()
        if apart < max(_KOLMOGOROV / math.sqrt(n), _BESIDE / 2):
            return middle + _ALL * sigma, sigma, True
    return (*_peak_of_any_shape(below, farthest), False)


def _peak_of_any_shape(below: Floats, farthest: float) -> tuple[float, float]:
    """Where a peak of sorted distances ends: twice as far are hardly more; and its deviation; else 0."""
    n, twice = (np.searchsorted(below, k * below, side="right") for k in (1, 2))
    ends = (n >= 2 * LEAST_NOISY) & (twice <= (1 + _BESIDE) * n)
    ends &= (below > 10**-_MOST_DECIMALS) & (2 * below <= farthest)
    if not ends.any():
        return 0.0, 0.0
    peak = below[: twice[ends.argmax()]]
    sigma = float(peak.std())
    return float(peak.mean()) + _ALL * sigma, sigma


def _reach_of_half_a_bell(noisy: Floats, beside: float) -> float:
    """How far sorted distances reach if they are half a bell [m], but for shares of `beside`; else 0."""
    n = len(noisy)
    sigma = float(noisy[n // 2]) / _HALF
    if not sigma > 0:
        return 0.0
    shares = np.array([math.erf(value) for value in (noisy / (math.sqrt(2) * sigma)).tolist()])
    apart = np.abs(shares - (np.arange(n) + 0.5) / n).max()
    return _ALL * sigma if apart < max(_KOLMOGOROV / math.sqrt(n), beside) else 0.0


@dataclass(frozen=True)
class CutOff:
    """Where the ranges of a log end."""

    at: float  # Their largest [m].
    tolerance: float  # What is as near to it is there: end points are rounded, or the limit has noise [m].

    def applied(self, scan: Scan) -> Scan:
        """The scan, in which readings there did not return if there are several."""
        there = ranges_of(scan) >= self.at - max(self.tolerance, float32_rounding(scan))
        if np.count_nonzero(there) < LEAST_CUT_OFF:
            return scan
        return replace(scan, returned=scan.did_return & ~there)


class CutOffSearch:
    """Looks for where the ranges of a log are cut off; they are not if all its readings are equal.

    `says_itself`: The log has a mark for beams that did not return: if it has any, it means all.
    `least_scans`: This many scans have several readings there: 1 where all scans are given, more of a sample.
    Attributes:
    `is_said`: The log has such marks: nothing is cut off, whatever else is added.
    """

    def __init__(self, *, says_itself: bool, least_scans: int = 1) -> None:
        self._says_itself, self._least_scans = says_itself, least_scans
        self._largest = self._tolerance = 0.0
        self._has_shorter = self.is_said = False
        self._cut = self._there = self._below = 0
        self._near = np.empty(0)  # Ranges that noise may have made of the largest.

    def add(self, scan: Scan) -> None:
        """Look at the next scan."""
        if self._says_itself and not scan.did_return.all():
            self.is_said = True
        if self.is_said:
            return
        ranges = ranges_of(scan)
        farthest = float(ranges.max(initial=-1.0))
        if farthest <= 0:
            return
        if farthest >= self._largest - self._tolerance:
            own = _rounding(scan)
            self._has_shorter |= 0 < self._largest < farthest - own
            if farthest > self._largest + own:
                self._cut = self._there = self._below = 0
            self._largest, self._tolerance = max(self._largest, farthest), own
            count = int(np.count_nonzero(ranges >= self._largest - own))
            if count >= LEAST_CUT_OFF:
                self._cut += 1
                self._there += count
                self._below += int(np.count_nonzero(ranges >= (1 - NEAR) * self._largest)) - count
        if len(self._near) < MOST_NOISY:
            near = np.concatenate([self._near, ranges])
            self._near = near[near >= (1 - NOISE_REACH) * self._largest]
        shorter = (ranges > 0) & (ranges < self._largest - self._tolerance)
        self._has_shorter = self._has_shorter or bool(shorter.any())

    def found(self) -> CutOff | None:
        """Where they are cut off by what was added; None if they are not."""
        if self.is_said or self._cut < self._least_scans or not self._has_shorter:
            return None
        below = self._largest - self._near
        is_there = below <= self._tolerance
        noise = noise_below(below[~is_there], int(np.count_nonzero(is_there)))
        if noise > 0:
            return CutOff(self._largest, max(noise, self._tolerance))
        return CutOff(self._largest, self._tolerance) if self._there > self._below else None


def ranges_of(scan: Scan) -> Floats:
    """Measured by the beams that returned: ranges, or a depth camera's depths [m]; -1 for the others."""
    way = scan.endpoints - scan.origin
    if scan.by_depth and scan.rotation is not None:
        ranges = way @ scan.rotation[:, 2]
    else:
        ranges = np.sqrt(np.einsum("ij,ij->i", way, way, dtype=np.float64))
    return np.where(scan.did_return & np.isfinite(ranges), ranges, -1.0)


def _rounding(scan: Scan) -> float:
    """By how much two equal ranges may differ, once they are end points [m]."""
    exact = float32_rounding(scan)
    known = scan.endpoints[np.isfinite(scan.endpoints).all(axis=1)][:_MOST_POINTS]
    for decimals in range(2, _MOST_DECIMALS + 1):
        if np.allclose(known, np.round(known, decimals), rtol=0, atol=exact):
            return exact + 2.0 * 10.0**-decimals
    return exact


def float32_rounding(scan: Scan) -> float:
    """By how much, if they were float32 once, as in most files [m]."""
    ends = scan.endpoints[scan.did_return]  # Others may be marked by any number.
    known = np.abs(ends[np.isfinite(ends)])
    largest = max(float(known.max(initial=0.0)), float(np.abs(scan.origin).max(initial=0.0)))
    return 4 * float(np.finfo(np.float32).eps) * largest


#: No sensor measures a surface that is nearer than this [m].
NEAREST = 1e-3


def without_padding(points: Points, origin: ArrayLike | None = None) -> Points:
    """The points with NaN instead of padding: what is nearer than 1 mm to its sensor measured nothing.

    Drivers fill their arrays with (0, 0, 0) where a beam did not return, often with a time of its own: from
    a sensor that moved meanwhile it would be a beam of some millimetres.

    `points` (ndarray of float, (n, dim)): End points, in any frame [m].
    `origin` (array_like, (dim,) or (n, dim)): The sensor, in the same frame [m]; left out, the points are in
        the sensor's own.
    Returns ndarray of float, (n, dim): `points` itself where there is no padding.
    """
    near = points_within(points, np.zeros(points.shape[1]) if origin is None else origin, NEAREST)
    if not len(near):
        return points
    points = points.copy()
    points[near] = np.nan
    return points


def without_zeros(points: Points) -> Points:
    """The points of a scan in a fixed frame with NaN for (0, 0, 0), where it is there more than once.

    A program that moves points to a fixed frame may leave padding as it was. What is measured does not come
    twice to the last bit.
    """
    zero: Bools = (points == 0).all(axis=1)
    if np.count_nonzero(zero) < 2:
        return points
    points = points.copy()
    points[zero] = np.nan
    return points
