# SPDX-License-Identifier: BSD-3-Clause
"""How true a map of a simulated world is, by what that world really holds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndtree._native._core import OccupancyMap
from ndtree.base.scan import Scan
from ndtree.logs.formats.simulated import SimulatedLog

Floats = NDArray[np.float64]

SAMPLES = 100_000
NEAR_SURFACE = 0.1  # What counts as near before a surface, and twice what counts as just inside [m].
THINNEST = 0.06  # Solids that are nowhere wider across the beam are thin [m].
STEP_INSIDE = 0.005  # Behind a surface, where it is felt how wide the solid is [m].
GRAZING = math.sin(math.radians(15))  # Of the steepest angle between floor and beam that grazes.
FOUND_WITHIN = 0.05  # Of a true surface point: an occupied cell finds it [m].


class ExactTruth:
    """Points of a simulated world that its sensor really saw, held-out scans included, and what is there.

    "free" lies anywhere before the first surface along random beams, "near" in the last 0.1 m before it, and
    "inside" in the first 0.05 m behind it. "thin" are true surface points of things that are at most 0.06 m
    wide, as table legs and poles, and "floor" those of level ground that beams graze at less than 15 degrees.

    `log`: The log that was mapped.
    `scans`: Its scans.
    `max_range`: Beams that are longer are left out [m].
    """

    def __init__(self, log: SimulatedLog, scans: Sequence[Scan], max_range: float) -> None:
        generator = np.random.default_rng(0)
        returned = [scan for scan in scans if len(scan)]
        per_scan = -(-SAMPLES // max(len(returned), 1))
        starts, ways = [np.empty((0, log.dim))], [np.empty((0, log.dim))]
        for scan in returned:
            start, way, _ = scan.returned_beams(max_range)
            if len(start):
                drawn = generator.choice(len(start), per_scan)
                starts.append(start[drawn])
                ways.append(way[drawn])
        start, way = np.concatenate(starts), np.concatenate(ways)
        distance = np.asarray(log.distance(start, way, max_range=math.inf))
        seen = np.isfinite(distance) & (distance > NEAR_SURFACE)
        start, way, distance = start[seen], way[seen], distance[seen]

        def at(along: Floats) -> Floats:
            return start + along[:, None] * way

        free = at(distance * generator.uniform(0.0, 1.0, len(distance)))
        near = at(distance - generator.uniform(0.0, NEAR_SURFACE, len(distance)))
        inside = at(distance + generator.uniform(0.0, NEAR_SURFACE / 2, len(distance)))
        self._samples = {
            "free": free[~log.contains(free)],
            "near": near[~log.contains(near)],
            "inside": inside[log.contains(inside)],
        }
        surface, felt = at(distance), at(distance + STEP_INSIDE)
        self._surfaces = {"thin": surface[_is_thin(log, felt, way)]}
        if log.dim == 3:
            self._surfaces["floor"] = surface[_is_grazed_floor(log, surface, way)]

    def of(self, target: OccupancyMap) -> dict[str, Any]:
        """Shares of the samples by what a map calls them, of surfaces by whether it finds them, and "auc".

        The area under the ROC curve is the probability that the map thinks a point of "inside" more likely
        occupied than one of "free", ties counting half.
        """
        result: dict[str, Any] = {}
        for name, points in self._samples.items():
            states = np.asarray(target.state(points))
            n = len(points)
            result[name] = {
                state: float(np.count_nonzero(states == value)) / n if n else None
                for state, value in (("free", 0), ("occupied", 1), ("unknown", -1))
            }
            result[name]["samples"] = n
        for name, points in self._surfaces.items():
            n = len(points)
            found = int(np.count_nonzero(target.occupied_within(points, FOUND_WITHIN))) if n else 0
            result[name] = {"found": found / n if n else None, "samples": n}
        inside, free = (target.probability(self._samples[name]) for name in ("inside", "free"))
        result["auc"] = area_under_roc(inside, free)
        return result


def area_under_roc(positive: NDArray[np.floating], negative: NDArray[np.floating]) -> float | None:
    """Probability that a positive scores higher than a negative, ties counting half (Mann and Whitney)."""
    if not len(positive) or not len(negative):
        return None
    order = np.sort(negative)
    below = np.searchsorted(order, positive, side="left")
    up_to = np.searchsorted(order, positive, side="right")
    return float((below + up_to).mean() / (2 * len(order)))


def _is_thin(log: SimulatedLog, felt: Floats, way: Floats) -> NDArray[np.bool_]:
    """Whether the solid around points just behind its surface is narrow, along some direction across."""
    thin = np.zeros(len(felt), dtype=bool)
    for across in _across(way):
        inside = np.ones((2, len(felt)), dtype=bool)
        reach = np.zeros(len(felt), dtype=int)
        steps = round(THINNEST / STEP_INSIDE)
        for step in range(1, steps + 1):
            for side, sign in enumerate((1, -1)):
                inside[side] &= np.asarray(log.contains(felt + sign * step * STEP_INSIDE * across))
                reach += inside[side]
        thin |= reach < steps
    return thin & np.asarray(log.contains(felt))


def _across(way: Floats) -> list[Floats]:
    """Unit directions across beams: in 2-D one, in 3-D a level one and one across both."""
    if way.shape[1] == 2:
        return [np.stack([-way[:, 1], way[:, 0]], axis=1)]
    level = np.stack([-way[:, 1], way[:, 0], np.zeros(len(way))], axis=1)
    upright = np.linalg.norm(level, axis=1) < 1e-6
    level[upright] = (1.0, 0.0, 0.0)
    level /= np.linalg.norm(level, axis=1, keepdims=True)
    return [level, np.cross(way, level)]


def _is_grazed_floor(log: SimulatedLog, surface: Floats, way: Floats) -> NDArray[np.bool_]:
    """Whether beams end at a small angle on something level: solid below, free above, and so all around."""
    floor = (way[:, 2] < 0) & (way[:, 2] > -GRAZING)
    for dx, dy in ((0.0, 0.0), (0.1, 0.0), (-0.1, 0.0), (0.0, 0.1), (0.0, -0.1)):
        floor &= np.asarray(log.contains(surface + np.array([dx, dy, -STEP_INSIDE])))
        floor &= ~np.asarray(log.contains(surface + np.array([dx, dy, STEP_INSIDE])))
    return floor
