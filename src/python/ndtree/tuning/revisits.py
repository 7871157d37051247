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
from ndtree._native._core import Matcher
from ndtree.alignment.planar import Floats, pose_of, seen_from, wrapped
from ndtree.alignment.sensor_scans import ends_to_match, pose_in_log, spread_evenly
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
_MOST_RANGE = 15.0
_POINTS, _FEWEST = 200, 40  # Of a scan that is matched.
_CELL = 0.1  # Of the grid of poses [m].
_WINDOW = (1.0, 1.0, 0.2)  # [m, m, rad]; farther ones are not found.
_SCORE = 0.5
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
            if np.linalg.norm(places[k] - places[earlier]) < _NEAR and abs(way[k] - way[earlier]) < 2 * _NEAR
        ]
        seen = np.concatenate([ends_of(scan) for k in beside for scan in runs[k]])
        error = moved(seen, runs[later][0], _WINDOW, _CELL)
        if error is not None:
            errors.append(error)
    if len(errors) < LEAST_PLACES or np.median(errors) < DRIFT:
        return None
    return Drift(float(np.median(errors)), len(errors))


def is_of_one_place(run: Sequence[Scan]) -> bool:
    """Whether scans are in 2-D, each from one place."""
    return all(scan.dim == 2 and scan.origin.ndim == 1 and np.isfinite(scan.origin).all() for scan in run)


def ends_of(scan: Scan) -> Floats:
    """End points [m]."""
    ends = scan.endpoints.astype(np.float64)
    result: Floats = ends[ends_to_match(scan, np.linalg.norm(ends - scan.origin, axis=1), _MOST_RANGE)]
    return result


def moved(surfaces: Floats, scan: Scan, window: tuple[float, float, float], cell: float) -> float | None:
    """How far a scan has to be moved to fit surfaces [m], by a grid with cells [m]; None if nothing tells."""
    pose = pose_in_log(scan)
    points = spread_evenly(seen_from(pose, ends_of(scan)), _POINTS)
    if min(len(points), len(surfaces)) < _FEWEST:
        return None
    match = Matcher(surfaces, cell_size=cell).match(points, pose, window=window)
    if match.score < _SCORE or not match.is_unique:
        return None
    error = (pose_of(np.asarray(match.pose)) - pose)[:2]
    variances, axes = np.linalg.eigh(np.asarray(match.covariance)[:2, :2])
    is_known = variances < _KNOWN**2
    return float(np.linalg.norm((axes.T @ error)[is_known])) if is_known.any() else None
