# SPDX-License-Identifier: BSD-3-Clause
"""Whether surfaces of a planar laser's log are double where the robot comes back.

Strategy: a scan of each run is matched with the scans of the nearest run that is much earlier on the way.
What it has to be moved is the drift of the poses between them. Only matches count that fit well and are
unique, and only along directions that the surroundings tell. Where the poses are good, they are some
centimetres.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ndtree._errors import Text, key
from ndtree._native._core import Match, Matcher
from ndtree.alignment.planar import Floats, placed, pose_of, wrapped
from ndtree.alignment.sensor_scans import SensorScan, pose_in_log, sensor_scan, spread_evenly
from ndtree.base.scan import Scan
from ndtree.base.words import number_of

#: A drift [m] from which surfaces are double, and of how many places that were found again.
DRIFT, LEAST_PLACES = 0.12, 3
_MOST_PLACES = 40  # That are looked at.
#: Nearer runs [m] show the same. They are another visit after a way of at least _WAY [m], and _TIMES their
#: distance.
_NEAR, _WAY, _TIMES = 3.0, 10.0, 4.0
_TURNED = 1.0  # Visits in other directions show other surfaces [rad].
#: Farther end points are left out [m].
MOST_RANGE = 15.0
_POINTS, _FEWEST = 200, 40  # Of a scan that is matched.
_CELL = 0.1  # Of the grid of poses [m].
_WINDOW = (1.0, 1.0, 0.2)  # [m, m, rad]; farther ones are not found.
_SCORE = 0.5
_AS_WELL = 0.9  # Of the best score: a pose that has it fits nearly as well.
_BESIDE = 1.5  # Of the usual angle between two beams: they are neighbours.
_IN_LINE = 0.03  # Off a line, end points are still on it [m].
_SPARSE = 0.2  # Farther apart than this, end points are lonely, and what lies between them is missed [m].
_STEP = 0.05  # Between places there [m].
_KNOWN = 0.15  # Standard deviation [m] of a direction that the surroundings tell.


@dataclass(frozen=True)
class Drift:
    """How far apart surfaces lie that were seen twice, from `drift`."""

    error: float  # Median of what scans have to be moved [m].
    places: int  # Where the robot came back, and the scans were found.

    def __str__(self) -> str:
        """What was found and what helps, in one line."""
        return Text(
            f"surfaces appear twice where the robot returns: its poses drift by about {self.error:.1g} m "
            f"(at {number_of(self.places, 'place')}); use {key('align')} or the poses of a SLAM system"
        )


def drift(runs: Sequence[Sequence[Scan]]) -> Drift | None:
    """Find how far poses of a 2-D log drift between visits of a place.

    `runs`: Consecutive scans in each, as from `ndtree.evaluation.sampling.spread`.
    Returns: None where surfaces lie on each other, or nothing can be told.
    """
    runs = [run for run in runs if run and is_of_one_place(run)]
    if len(runs) < 2:
        return None
    poses = np.array([pose_in_log(run[0]) for run in runs])
    places = poses[:, :2]
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1))])
    pairs = []
    for later in range(1, len(runs)):
        distance = np.linalg.norm(places[:later] - places[later], axis=1)
        is_visit = (distance < _NEAR) & (way[later] - way[:later] > np.maximum(_WAY, _TIMES * distance))
        is_visit &= np.abs(wrapped(poses[:later, 2] - poses[later, 2])) < _TURNED
        if is_visit.any():
            visits = np.flatnonzero(is_visit)
            pairs.append((int(visits[distance[visits].argmin()]), later))
    chosen = np.unique(np.linspace(0, len(pairs) - 1, min(len(pairs), _MOST_PLACES)).astype(int))
    errors = []
    for i in chosen:
        earlier, later = pairs[i]
        beside = [
            k
            for k in range(max(0, earlier - 1), min(later, earlier + 2))
            if np.linalg.norm(places[k] - places[earlier]) < _NEAR
        ]
        seen = [scan for k in beside for scan in runs[k]]
        error = moved(seen, runs[later][0], _WINDOW, _CELL)
        if error is not None:
            errors.append(error)
    if len(errors) < LEAST_PLACES or np.median(errors) < DRIFT:
        return None
    return Drift(float(np.median(errors)), len(errors))


def is_of_one_place(run: Sequence[Scan]) -> bool:
    """Whether scans are in 2-D, each from one place."""
    return all(
        scan.dim == 2 and not scan.points_only and scan.origin.ndim == 1 and np.isfinite(scan.origin).all()
        for scan in run
    )


def moved(seen: Sequence[Scan], scan: Scan, window: tuple[float, float, float], cell: float) -> float | None:
    """How far a scan has to be moved to fit what others saw [m], by a grid with cells [m].

    Where it fits nearly as well as it is, it has not to be moved. None if nothing tells.
    """
    one, *others = (sensor_scan(each, MOST_RANGE) for each in (scan, *seen))
    found = fitted(others, one, window, cell)
    return None if found is None else moved_by(one, *found)


def moved_by(scan: SensorScan, matcher: Matcher, points: Floats, match: Match) -> float | None:
    """What `moved` says of a scan, by what `fitted` found."""
    if matcher.score(points, scan.pose) >= _AS_WELL * match.score:
        return 0.0
    error = (pose_of(np.asarray(match.pose)) - scan.pose)[:2]
    variances, axes = np.linalg.eigh(np.asarray(match.covariance)[:2, :2])
    is_known = variances < _KNOWN**2
    return float(np.linalg.norm((axes.T @ error)[is_known])) if is_known.any() else None


def fitted(
    seen: Sequence[SensorScan], scan: SensorScan, window: tuple[float, float, float], cell: float
) -> tuple[Matcher, Floats, Match] | None:
    """How a scan fits what others saw: what it was matched with, its points, and the match.

    None if it does not fit well, or somewhere else as well.
    """
    points = spread_evenly(scan.points, _POINTS)
    if min(len(points), sum(len(one.points) for one in seen)) < _FEWEST:
        return None
    surfaces = np.concatenate([placed(one.pose, surface_of(one.points)) for one in seen])
    matcher = Matcher(surfaces, cell_size=cell)
    match = matcher.match(points, scan.pose, window=window)
    return (matcher, points, match) if match.score >= _SCORE and match.is_unique else None


def surface_of(points: Floats) -> Floats:
    """End points of one scan in its sensor's frame, in the order of the beams, and what lies between them.

    End points alone are a pattern of the sensor's own, which fits the next scan best where the sensor has not
    moved. Neighbouring beams whose end points lie in line with a third one's ended on one surface, which is
    there between them, too.
    """
    if len(points) < 3:
        return points
    sides = np.diff(points, axis=0)
    lengths = np.hypot(sides[:, 0], sides[:, 1])
    turns = np.abs(wrapped(np.diff(np.arctan2(points[:, 1], points[:, 0]))))
    is_beside = turns < _BESIDE * float(np.median(turns))
    along = sides / np.maximum(lengths, np.finfo(float).tiny)[:, None]
    normals = np.column_stack((-along[:, 1], along[:, 0]))
    is_one = np.zeros(len(sides), dtype=bool)
    off_before = np.abs((normals[1:] * sides[:-1]).sum(axis=1))
    off_after = np.abs((normals[:-1] * sides[1:]).sum(axis=1))
    is_one[1:] |= (off_before < _IN_LINE) & is_beside[:-1]
    is_one[:-1] |= (off_after < _IN_LINE) & is_beside[1:]
    counts = np.where(
        is_one & is_beside & (lengths > _SPARSE), np.ceil(lengths / _STEP).astype(np.int64) - 1, 0
    ).clip(0)
    first = np.repeat(np.arange(len(sides)), counts)
    steps = np.arange(1, len(first) + 1) - np.repeat(np.cumsum(counts) - counts, counts)
    between = points[first] + sides[first] * (steps / (counts[first] + 1))[:, None]
    return np.concatenate((points, between))
