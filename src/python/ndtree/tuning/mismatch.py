# SPDX-License-Identifier: BSD-3-Clause
"""Whether a lidar, a depth camera or a planar laser moved as its poses say, whatever the cause if it did not.

Strategy: pairs of clouds are matched from where their poses have them. They do not fit where the match is far
off, for what matches and poses err, or where none is found and one cloud lies much in what the other saw
through. Asked are clouds that follow each other, those before and after the step that fits worst, and those
from where the sensor returns.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ndtree._errors import Text, key
from ndtree.alignment.planar import Floats
from ndtree.alignment.surfaces import FITS, Cloud
from ndtree.base.words import number_of, percent
from ndtree.tuning.motions import errors_of, motions_of, pose_noise
from ndtree.tuning.setup_error import unfit

#: Squared error over variances of a pair that does not fit: of six freedoms, by chance one in a thousand. Of
#: logs with good poses nine pairs of ten have at most 5, of wrong ones hundreds.
_OFF = 22.5
#: By how much more of two planar scans meets elsewhere than as told, farther than poses err, where they do
#: not fit although nothing tells some direction: of good poses in at most one pair of 20. Rings on the ground
#: meet best as if nothing had moved.
_MORE = 0.1
#: Of what a cloud sees, how much lies in what the other saw free, where none fits. With crowds it is less.
_THROUGH = 0.1
#: Pairs that do not fit, at least, and their share of all known ones: what moves changes some places.
_LEAST, _SOME = 3, {"steps": 0.1, "returns": 0.5}
_MOST = 24  # Pairs of a kind, for the time that they take.
_ACROSS = 3  # Clouds before and after a step.
_ALL = 0.75  # Of pairs, where what is wrong is wrong in all of them.
_FOLLOWS = 1.5  # Usual steps in time: what comes no later is next.
_RETURNED, _WAY = 1.5, 6.0  # Distance of poses at a place where the sensor returns after a way [m].

Fits = dict[tuple[int, int], "bool | None"]  # Of pairs of clouds; None where nothing tells.


@dataclass(frozen=True)
class Mismatch:
    """Where poses do not fit clouds, from `mismatch`.

    `kind`: "steps" between clouds that follow each other, one "jump", or "returns" to a place.
    `wrong`, `pairs`: How many pairs do not fit, and of how many.
    `since`: Time of the first that does not [s], from the log's first scan on; nan where scans have no times.
    `sensor`: Of several the one that tells.
    """

    kind: str
    wrong: int
    pairs: int
    since: float
    sensor: str = ""

    def __str__(self) -> str:
        """What was found and what helps, in one line."""
        when = f"{self.since:.1f} s" if math.isfinite(self.since) else "some scan"
        helps = f"use {key('align')} or the poses of a SLAM system"
        found = unfit(self.sensor)
        if self.kind == "returns":
            where = f"{self.wrong} of {number_of(self.pairs, 'place')} where the robot returns"
            return Text(f"{found}: surfaces appear twice at {where}; {helps}")
        if self.kind == "jump":
            return Text(
                f"{found}: what is seen from {when} on lies elsewhere than what was seen "
                f"just before it. Did poses jump, or was the robot carried? Stop before it with "
                f"{key('stop')}, or use {key('align')}"
            )
        share = percent(self.wrong / self.pairs)
        first = f"first at {when}, and " if math.isfinite(self.since) else ""
        return Text(
            f"{found}: the robot did not move as they say, {first}in "
            f"{share} of the steps looked at; check the order of scans and poses, their clocks, and whether "
            f"wheels slip, or {helps}"
        )


def mismatch(runs: Sequence[Sequence[Cloud]]) -> Mismatch | None:
    """Find whether poses of a log fit what is seen.

    `runs`: Clouds that follow each other.
    Returns: None where they do, or too little tells.
    """
    log = _Pairs(runs)
    return (
        log.told("steps", log.do_fit(_some(log.steps()), may_stand=True))
        or log.jump()
        or log.told("returns", log.do_fit(_some(log.returns())))
    )


def _some(pairs: list[tuple[int, int]]) -> list[tuple[int, int]]:
    return pairs[:: max(1, math.ceil(len(pairs) / _MOST))]


class _Pairs:
    """Clouds of a log in their order, and whether two of them fit each other where their poses are."""

    def __init__(self, runs: Sequence[Sequence[Cloud]]) -> None:
        self._clouds = [one for run in runs for one in run]
        self._poses = np.array([one.pose for one in self._clouds]).reshape(-1, 4, 4)
        self._views: dict[int, _View] = {}
        self._elsewhere: set[tuple[int, int]] = set()  # Pairs that meet better elsewhere.
        behind = np.cumsum([len(run) for run in runs if run], dtype=int).tolist()
        #: First and last cloud of each run.
        self._runs = [(first, end - 1) for first, end in zip([0, *behind], behind)]

    def steps(self) -> list[tuple[int, int]]:
        """Of each run the first and the last cloud."""
        return [run for run in self._runs if run[0] < run[1]]

    def since(self, cloud: int) -> float:
        """Time of a cloud."""
        stamps = [one.stamp for one in self._clouds]
        return stamps[cloud] - stamps[0] if stamps[-1] != stamps[0] else math.nan

    def do_fit(self, pairs: Iterable[tuple[int, int]], may_stand: bool = False) -> Fits:
        """Whether each pair fits.

        `may_stand`: Where none fits as told, one may be found from where the sensor has not moved.
        """
        return {pair: self._fits(*pair, may_stand) for pair in pairs}

    def _fits(self, first: int, second: int, may_stand: bool) -> bool | None:
        one, other = self._clouds[first], self._clouds[second]
        told = motions_of(self._poses, np.array([[first, second]]))
        as_told = one.agreement(other, told[0])
        best, off, noise = max(FITS, as_told), None, pose_noise(told)[0]
        for start in (told[0], np.eye(4))[: 1 + (may_stand and as_told <= FITS)]:
            seen, covariance = one.matched(other, start)
            fit = one.agreement(other, seen)
            if fit >= best:
                error = errors_of(seen[None], told)[0]
                best, off = fit, float(error @ np.linalg.solve(covariance + noise, error))
                is_far = error @ np.linalg.solve(noise, error) > _OFF
                if one.scan.dim == 2 and is_far and as_told > FITS and fit > as_told + _MORE:
                    self._elsewhere.add((first, second))
        if off is not None:
            return off < _OFF
        if as_told > FITS:
            return True
        share = self._view(first).through(self._view(second))
        return None if share is None else share <= _THROUGH

    def _view(self, cloud: int) -> _View:
        if cloud not in self._views:
            self._views[cloud] = _View(self._clouds[cloud])
        return self._views[cloud]

    def told(self, kind: str, fits: Fits) -> Mismatch | None:
        """The mismatch, if too many pairs do not fit."""
        wrong = [pair for pair, does in fits.items() if does is False]
        known = sum(does is not None for does in fits.values())
        elsewhere = self._elsewhere & set(fits)
        if len(elsewhere) >= _ALL * known:
            wrong = sorted({*wrong, *elsewhere})
        if len(wrong) < max(_LEAST, _SOME[kind] * known):
            return None
        return Mismatch(kind, len(wrong), known, self.since(wrong[0][1]))

    def jump(self) -> Mismatch | None:
        """A step from which on clouds do not fit those before, while these or those fit each other.

        Looked at is the worst step beside which clouds can be compared.
        """
        ends = self._ends()
        for worst in self._worst_first(ends):
            beside = ends[max(0, worst - _ACROSS) : worst + _ACROSS]
            near = list(range(beside[0], beside[-1] + 1))
            at = near[self._worst_first(near)[0]]
            before, after = range(max(0, at - _ACROSS), at), range(at, min(len(self._clouds), at + _ACROSS))
            pairs = [(i, k) for i in before for k in after]
            across = list(self.do_fit(pairs, may_stand=self._follows(at)).values())
            known = sum(fits is not None for fits in across)
            if known < _LEAST:
                continue
            wrong = across.count(False)
            is_one = [all(self.do_fit(zip(some, some[1:])).values()) for some in (before, after)]
            is_told = wrong >= max(_LEAST, _ALL * known) and any(is_one)
            return Mismatch("jump", wrong, known, self.since(at)) if is_told else None
        return None

    def _follows(self, cloud: int) -> bool:
        """Whether a cloud comes at once after the one before, so that the sensor has hardly moved."""
        if any(first < cloud <= last for first, last in self._runs):
            return True
        stamps = np.array([one.stamp for one in self._clouds])
        steps = [(stamps[last] - stamps[first]) / (last - first) for first, last in self.steps()]
        usual = np.median(steps or [0.0])
        return bool(0.0 <= stamps[cloud] - stamps[cloud - 1] < _FOLLOWS * usual)

    def _ends(self) -> list[int]:
        return sorted({end for run in self._runs for end in run})

    def _worst_first(self, clouds: list[int]) -> list[int]:
        """The places, in a list of clouds, of those behind a step, the one that fits worst first."""
        pairs = np.array([(i, i + 1) for i in range(len(clouds) - 1)], dtype=int).reshape(-1, 2)
        fit = [
            self._clouds[one].agreement(self._clouds[other], step)
            for one, other, step in zip(clouds, clouds[1:], motions_of(self._poses[clouds], pairs))
        ]
        return [int(i) + 1 for i in np.argsort(fit, kind="stable")]

    def returns(self) -> list[tuple[int, int]]:
        """Of the ends of runs, the nearest one that is a way before each."""
        ends = self._ends()
        places = self._poses[ends, :3, 3]
        way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1))])
        found = []
        for later in range(1, len(places)):
            distance = np.linalg.norm(places[:later] - places[later], axis=1)
            distance[way[later] - way[:later] < _WAY] = math.inf
            if distance.min() < _RETURNED:
                found.append((ends[int(distance.argmin())], ends[later]))
        return found


#: Of a view: its cells [rad], how far poses and ranges may err, and by how much more for each metre [m].
_CELL, _MARGIN, _GROWS = math.radians(3.0), 0.2, 0.03
_BESIDE = 0.3  # What is thinner than beams are apart is seen past [m].
_FEWEST = 20  # Surfaces that can be compared.
_UP, _AROUND = 62, 120


class _View:
    """What a cloud sees in the map's axes, in cells by direction, and its flat patches."""

    def __init__(self, cloud: Cloud) -> None:
        self._place = cloud.pose[:3, 3]
        points = cloud.points @ cloud.pose[:3, :3].T
        ranges = np.linalg.norm(points, axis=1)
        cells = _cells_of(points, ranges)
        low, high = np.full(_UP * _AROUND, np.inf), np.full(_UP * _AROUND, -np.inf)
        np.minimum.at(low, cells, ranges)
        np.maximum.at(high, cells, ranges)
        self._is_seen = np.isfinite(low)
        self._surfaces = _surfaces(cloud) @ cloud.pose[:3, :3].T
        self._low, self._high = _spread(low, np.minimum), _spread(high, np.maximum)

    def through(self, other: _View) -> float | None:
        """Share of the surfaces of two views that is in what the other saw free; None of too few."""
        free, known = np.add(self._counts(other), other._counts(self))
        return float(free / known) if known >= _FEWEST else None

    def _counts(self, other: _View) -> tuple[int, int]:
        """Of another's surfaces, how many lie in free space, and how many of them or on what is seen."""
        points = other._surfaces + other._place - self._place
        ranges = np.linalg.norm(points, axis=1)
        cells = _cells_of(points, ranges)
        margin = _MARGIN + _GROWS * ranges
        free = self._is_seen[cells] & (self._low[cells] - ranges > margin)
        on = self._is_seen[cells] & ~free & (ranges < self._high[cells] + margin)
        return int(free.sum()), int(free.sum() + on.sum())


def _surfaces(cloud: Cloud) -> Floats:
    """(n, 3) patches, or of a planar laser end points beside others on both sides: it has few patches."""
    if cloud.scan.dim == 3:
        return cloud.patches.mean
    beside = np.linalg.norm(np.diff(cloud.points, axis=0), axis=1) < _BESIDE
    return cloud.points[1:-1][beside[1:] & beside[:-1]]


def _cells_of(points: Floats, ranges: Floats) -> NDArray[np.int64]:
    up = np.arcsin((points[:, 2] / ranges.clip(1e-9)).clip(-1.0, 1.0))
    around = np.arctan2(points[:, 1], points[:, 0])
    cells: NDArray[np.int64] = np.rint(up / _CELL).astype(np.int64) + _UP // 2
    return cells * _AROUND + np.rint(around / _CELL).astype(np.int64) % _AROUND


def _spread(values: Floats, most: np.ufunc) -> Floats:
    """Of each cell the most of it and its neighbours."""
    image = values.reshape(_UP, _AROUND)
    image = most.reduce([np.roll(image, by, axis=1) for by in (-1, 0, 1)])
    image = np.vstack((image[:1], image, image[-1:]))
    result: Floats = most.reduce([image[:-2], image[1:-1], image[2:]]).ravel()
    return result
