# SPDX-License-Identifier: BSD-3-Clause
"""Messages of sensors that measure ranges, to beams in the sensor's own frame."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from ndtree.logs.core import silence
from ndtree.logs.core.arrays import Points
from ndtree.logs.ros.messages.beams import (
    BEYOND,
    LONGEST_SWEEP,
    OTHER_NUMBER,
    SENSELESS,
    UNLIMITED,
    Beams,
    Floats,
)  # fmt: skip

#: A laser that turns this far [rad] looks all around.
FULL_TURN = math.radians(350)
#: More turns in one message are angles in degrees.
_MOST_TURNS = 4
#: Ranges by which drivers miscount their own, and the share of them that does not matter.
_MISCOUNTED, _OTHER_SHARE = 2, 0.01
#: Of the largest range: ranges beyond it that differ less are one value, which says that nothing was hit.
_ONE_VALUE = 0.1


class NoiseAtLimit:
    """Whether the ranges of a topic's messages have noise where nothing was hit, by those so far.

    Simulators add it to range_max: about as many readings are a little below as at it and above, or those
    become +inf, or there is no other half. Some drivers have a largest reading of their own below range_max,
    which comes more often than those just below it.
    """

    def __init__(self) -> None:
        self._limit, self._there, self._beyond = 0.0, 0, 0  # Readings at it, and +inf.
        self._below, self._has_shorter = np.empty(0), False
        self.reach = 0.0  # How far it reaches to both sides of range_max [m].

    def add(self, ranges: Points, limit: float) -> float:
        """Look at the next message's ranges, up to a largest one [m]; how far noise reaches."""
        if not 0 < limit < math.inf:
            return 0.0
        if limit != self._limit:
            self._limit, self._there, self._beyond = limit, 0, 0
            self._below, self.reach = np.empty(0), 0.0
        if self._there < silence.MOST_NOISY:
            apart = np.float64(np.float32(limit)) - ranges[np.isfinite(ranges)].astype(np.float64)
            reach, few = silence.NOISE_REACH * limit, silence.LEAST_NOISY // 2
            self._has_shorter |= bool((apart > reach).any())
            apart = apart[np.abs(apart) <= reach]
            self._there += int(np.count_nonzero(apart <= 0))
            self._beyond += int(np.count_nonzero(np.isposinf(ranges)))
            self._below = np.concatenate([self._below, apart[apart > 0]])[-silence.MOST_NOISY :]
            self.reach = (
                silence.noise_below(self._below, self._there)
                or silence.noise_below(self._below, self._there + self._beyond)
                or self._largest_below()
                or (self._there < few and silence.noise_below_alone(self._below, reach))
                or 0.0
            )
        return self.reach

    def _largest_below(self) -> float:
        """How far below the limit the largest reading is, if it means that nothing was hit; else 0 [m]."""
        if self._there or not self._has_shorter or len(self._below) < silence.LEAST_NOISY:
            return 0.0
        nearest = float(self._below.min())
        at = int(np.count_nonzero(self._below == nearest))
        beside = int(np.count_nonzero(self._below <= nearest + silence.NEAR * self._limit)) - at
        return nearest if at >= silence.LEAST_NOISY and at > beside else 0.0


def laser_beams(
    message: Any,
    no_return_range: float | None = None,
    zero_is_silent: bool = False,
    noise: NoiseAtLimit | None = None,
) -> Beams:
    """Beams of a LaserScan by the rules of REP 117.

    A range within [range_min, range_max] is a surface. +inf is no return: free up to range_max, and where
    that is no length above range_min, up to `no_return_range` [m] if it is given. NaN, -inf (too close to be
    measured) and other ranges are invalid. Several beams of a message at exactly range_max did not return
    either: a driver cut them off there. Nor did readings around range_max that are noise there, by `noise`.
    With `zero_is_silent`, 0 counts as +inf.

    A beam's time is that of the message and its number times time_increment. Of a laser that looks all
    around and has no time_increment, but a scan_time, the beams may be spread over that: it is a guess, for
    simulators say so, too, and measure at once.
    """
    ranges = np.asarray(message.ranges)
    zeros = ranges == 0
    if zero_is_silent:
        ranges = np.where(zeros, np.float32(np.inf), ranges)
    reach = 0.0 if noise is None else noise.add(ranges, float(message.range_max))
    if reach:
        ranges = np.where(np.abs(ranges - message.range_max) <= reach, np.float32(np.inf), ranges)
    beams = _planar_beams(message, ranges, no_return_range)
    return replace(beams, zeros=int(np.count_nonzero(zeros)))


def multi_echo_beams(message: Any, no_return_range: float | None = None) -> Beams:
    """Beams of a MultiEchoLaserScan, of each its nearest echo that is valid as in `laser_beams`.

    `message` is what `ndtree.logs.ros.messages.own` decodes. A beam with no valid echo did not return
    if one of its echoes is +inf.
    """
    echoes, numbers = message.echoes, message.numbers
    (least, most), _ = _limits(message.range_min, message.range_max, "range_max")
    valid = (echoes >= least) & (echoes <= most) & np.isfinite(echoes)
    nearest = np.full(message.beams, np.nan, dtype=np.float32)
    nearest[numbers[np.isposinf(echoes)]] = np.inf
    nearest[numbers[valid]] = np.inf
    np.minimum.at(nearest, numbers[valid], echoes[valid])
    return _planar_beams(message, nearest, no_return_range)


def range_beams(message: Any, no_return_range: float | None = None) -> Beams:
    """The beam of a Range, along x in the middle of its cone: ranges as of a LaserScan."""
    limits, said = (float(message.min_range), float(message.max_range)), ""
    if not limits[0] == limits[1] > 0:  # As of sensors that only tell whether something is nearer than that.
        limits, said = _limits(*limits, "max_range")
    ranges = np.array([message.range], dtype=np.float32)
    beams = _measured(ranges, limits, np.array([[1.0, 0, 0]]), None, no_return_range, least_cut_off=1)
    return replace(beams, odd={**beams.odd, UNLIMITED: said})


def _planar_beams(message: Any, ranges: Points, no_return_range: float | None) -> Beams:
    n = len(ranges)
    turn = float(message.angle_increment)
    if n > 1 and not (math.isfinite(turn) and turn != 0):
        raise ValueError(f"angle_increment = {turn:g} rad of {n} ranges: must be finite and not 0")
    if n > 1 and abs(turn) * n > _MOST_TURNS * math.tau:
        turns = abs(turn) * n / math.tau
        raise ValueError(f"angle_increment = {turn:g} rad of {n} ranges: {turns:.3g} turns, expected radians")
    ways = _directions(float(message.angle_min), turn, n)
    limits, said = _limits(message.range_min, message.range_max, "range_max")
    beams = _measured(ranges, limits, ways, _times(message, n), no_return_range)
    step = float(message.time_increment)
    odd = {**beams.odd, UNLIMITED: said, OTHER_NUMBER: _another_number(message, n)}
    if beams.times is None and step and n > 1:
        odd[SENSELESS] = f"time_increment = {step:g} s of {n} beams"
    return replace(beams, is_guess=beams.times is not None and step == 0, odd=odd)


def _another_number(message: Any, n: int) -> str:
    """What the message's angles are, if not for as many ranges as it has; drivers count one more or less."""
    turn, span = float(message.angle_increment), float(message.angle_max) - float(message.angle_min)
    if n < 2 or not math.isfinite(span) or span == 0:
        return ""
    expected = round(span / turn) + 1
    if abs(expected - n) <= max(_MISCOUNTED, _OTHER_SHARE * n):
        return ""
    return f"{n} ranges, {message.angle_min:.4g} to {message.angle_max:.4g} rad by {turn:.4g} rad"


def _limits(nearest: float, farthest: float, name: str) -> tuple[tuple[float, float], str]:
    """Between which ranges [m] a surface is; what is wrong with the largest where it counts as not given.

    Drivers that know none say 0, or NaN: it would make all beams invalid.
    """
    least = float(nearest) if nearest > 0 else 0.0
    if farthest > least:
        return (float(nearest), float(farthest)), ""
    return (least, math.inf), f"{name} = {farthest:g} m, expected more than {least:g} m"


def _measured(
    ranges: Points,
    limits: tuple[float, float],
    ways: Floats,
    times: Floats | None,
    no_return_range: float | None,
    least_cut_off: int = silence.LEAST_CUT_OFF,
) -> Beams:
    nearest, farthest = limits
    silent = np.isposinf(ranges)
    cut_off = ranges == np.float32(farthest)
    if np.count_nonzero(cut_off) >= least_cut_off:  # What is measured does not come twice to the last bit.
        silent |= cut_off & np.isfinite(ranges)
    returned = (ranges >= nearest) & (ranges <= farthest) & np.isfinite(ranges) & ~silent
    said, count = "", np.count_nonzero(returned)
    beyond = ranges[np.isfinite(ranges) & (ranges > farthest) & ~silent]
    if len(beyond) > count and (not count or np.ptp(beyond) > _ONE_VALUE * farthest):
        said = f"{beyond.min():,.1f} to {beyond.max():,.1f} m, expected up to {farthest:g} m"
    length = np.where(returned, ranges, np.nan).astype(np.float64)
    limit = farthest if 0 < farthest < np.inf else no_return_range
    endless = 0
    if limit is not None:
        length[silent] = limit
    else:
        endless = int(np.count_nonzero(silent))
    return Beams(length[:, None] * ways, returned, times, endless, odd={BEYOND: said})


def _times(message: Any, n: int) -> Floats | None:
    """When the beams were measured since the stamp [s]; None where all at once, or where it is unknown."""
    step = float(message.time_increment)
    if step == 0 and abs(message.angle_increment) * n >= FULL_TURN:
        step = float(message.scan_time) / max(n, 1)
    if not 0 < abs(step) * n <= LONGEST_SWEEP:
        return None
    return step * np.arange(n)


@lru_cache(maxsize=8)
def _directions(angle_min: float, angle_increment: float, count: int) -> Floats:
    angles = angle_min + angle_increment * np.arange(count)
    return np.stack([np.cos(angles), np.sin(angles), np.zeros(count)], axis=1)
