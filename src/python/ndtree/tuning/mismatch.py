# SPDX-License-Identifier: BSD-3-Clause
"""Whether a sensor in space moved as its poses say, whatever the cause if it did not.

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
from ndtree.base.words import number_of, percent
from ndtree.tuning.motions import errors_of, has_moved, motions_of, pose_noise
from ndtree.tuning.surfaces import FITS, Cloud

#: Squared error over variances of a pair that does not fit: of six freedoms, by chance one in a thousand. Of
#: logs with good poses nine pairs of ten have at most 5, of wrong ones hundreds.
_OFF = 22.5
#: Of what a cloud sees, how much lies in what the other saw free, where none fits. With crowds it is less.
_THROUGH = 0.1
_LEAST, _SOME = 3, 0.1  # Pairs that do not fit, at least, and of those that tell.
_MOST = 24  # Pairs of a kind, for the time that they take.
_ACROSS, _ALL = 3, 0.75  # Clouds before and after a step, and how many of their pairs do not fit, at least.
_STANDS = (0.1, 0.06)  # Less is no motion [m, rad].
_RETURNED, _WAY = 1.5, 6.0  # Distance of poses at a place where the sensor returns after a way [m].


Fits = dict[tuple[int, int], "bool | None"]  # Of pairs of clouds; None where nothing tells.


@dataclass(frozen=True)
class Mismatch:
    """Where poses do not fit clouds, from `mismatch`.

    `kind`: "steps" between clouds that follow each other, one "jump", or "returns" to a place.
    `wrong`, `pairs`: How many pairs do not fit, and of how many.
    `since`: Time of the first that does not [s], from the log's first scan on; nan where scans have no times.
    """

    kind: str
    wrong: int
    pairs: int
    since: float

    def __str__(self) -> str:
        """What was found and what helps, in one line."""
        when = f"{self.since:.1f} s" if math.isfinite(self.since) else "some scan"
        helps = f"use {key('align')} or the poses of a SLAM system"
        if self.kind == "returns":
            where = f"{self.wrong} of {number_of(self.pairs, 'place')} where the robot returns"
            return Text(f"poses do not fit the scans: surfaces appear twice at {where}; {helps}")
        if self.kind == "jump":
            return Text(
                f"poses do not fit the scans: what is seen from {when} on lies elsewhere than what was seen "
                f"just before it. Did poses jump, or was the robot carried? Stop before it with "
                f"{key('stop')}, or use {key('align')}"
            )
        share = percent(self.wrong / self.pairs)
        return Text(
            f"poses do not fit the scans: the robot did not move as they say, first at {when}, and in "
            f"{share} of the steps looked at; check the order of scans and poses and their clocks, or {helps}"
        )


def mismatch(runs: Sequence[Sequence[Cloud]]) -> Mismatch | None:
    """Find whether poses of a 3-D log fit its clouds.

    `runs`: Clouds that follow each other.
    Returns: None where they do, or too little tells.
    """
    ends = [run[:1] + run[1:][-1:] for run in map(list, runs)]
    first = np.cumsum([0, *map(len, ends)]).tolist()
    follows = [(at, at + 1) for at, run in zip(first, ends) if len(run) == 2]
    log = _Pairs([one for run in ends for one in run])
    return (
        log.told("steps", log.do_fit(_some(follows), may_stand=True))
        or log.jump()
        or log.told("returns", log.do_fit(_some(log.returns())))
    )


def _stands(motion: Floats) -> bool:
    """Whether a sensor has hardly moved: then its pattern of rings fits beside any railing."""
    return not has_moved(np.eye(4), motion, _STANDS)


def _some(pairs: list[tuple[int, int]]) -> list[tuple[int, int]]:
    return pairs[:: max(1, math.ceil(len(pairs) / _MOST))]


class _Pairs:
    """Clouds of a log in their order, and whether two of them fit each other where their poses are."""

    def __init__(self, clouds: list[Cloud]) -> None:
        self._clouds = clouds
        self._poses = np.array([one.pose for one in clouds]).reshape(-1, 4, 4)
        self._views: dict[int, _View] = {}

    def since(self, cloud: int) -> float:
        """Time of a cloud."""
        stamps = [one.stamp for one in self._clouds]
        return stamps[cloud] - stamps[0] if stamps[-1] != stamps[0] else math.nan

    def do_fit(self, pairs: Iterable[tuple[int, int]], may_stand: bool = False) -> Fits:
        """Whether each pair fits.

        `may_stand`: A match may also be found from where the sensor has not moved.
        """
        return {pair: self._fits(*pair, may_stand) for pair in pairs}

    def _fits(self, first: int, second: int, may_stand: bool) -> bool | None:
        one, other = self._clouds[first], self._clouds[second]
        told = motions_of(self._poses, np.array([[first, second]]))
        as_told = one.agreement(other, told[0])
        best, off = max(FITS, as_told), None
        for start in (told[0], np.eye(4))[: 1 + may_stand]:
            seen, covariance = one.matched(other, start)
            fit = one.agreement(other, seen)
            if fit >= best and not (as_told > FITS and _stands(seen)):
                error = errors_of(seen[None], told)[0]
                best, off = fit, float(error @ np.linalg.solve(covariance + pose_noise(told)[0], error))
        if off is not None:
            return off < _OFF
        if as_told > FITS:
            return True
        share = self._view(first).through(self._view(second))
        return False if share is not None and share > _THROUGH else None

    def _view(self, cloud: int) -> _View:
        if cloud not in self._views:
            self._views[cloud] = _View(self._clouds[cloud])
        return self._views[cloud]

    def told(self, kind: str, fits: Fits) -> Mismatch | None:
        """What is said of pairs of which too many do not fit."""
        wrong = [pair for pair, does in fits.items() if does is False]
        known = sum(does is not None for does in fits.values())
        if len(wrong) < max(_LEAST, _SOME * known):
            return None
        return Mismatch(kind, len(wrong), known, self.since(wrong[0][1]))

    def jump(self) -> Mismatch | None:
        """A step from which on clouds do not fit those before, while these and those fit each other."""
        number = len(self._clouds)
        steps = motions_of(
            self._poses, np.array([(i, i + 1) for i in range(number - 1)], dtype=int).reshape(-1, 2)
        )
        fit = [self._clouds[i].agreement(self._clouds[i + 1], step) for i, step in enumerate(steps)]
        if not fit:
            return None
        at = int(np.argmin(fit)) + 1
        before, after = range(max(0, at - _ACROSS), at), range(at, min(number, at + _ACROSS))
        across = list(self.do_fit([(i, k) for i in before for k in after]).values())
        beside = self.do_fit([*zip(before, before[1:]), *zip(after, after[1:])]).values()
        known = sum(fits is not None for fits in across)
        wrong = across.count(False)
        if known < 2 * _LEAST or wrong < _ALL * known or not all(beside):
            return None
        return Mismatch("jump", wrong, known, self.since(at))

    def returns(self) -> list[tuple[int, int]]:
        """Of each cloud the nearest one that is a way before it."""
        places = self._poses[:, :3, 3]
        way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1))])
        found = []
        for later in range(1, len(places)):
            distance = np.linalg.norm(places[:later] - places[later], axis=1)
            distance[way[later] - way[:later] < _WAY] = math.inf
            if distance.min() < _RETURNED:
                found.append((int(distance.argmin()), later))
        return found


#: Of a view: its cells [rad], how far poses and ranges may err, and by how much more for each metre [m].
_CELL, _MARGIN, _GROWS = math.radians(3.0), 0.2, 0.03
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
        self._surfaces = cloud.patches.mean @ cloud.pose[:3, :3].T
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
