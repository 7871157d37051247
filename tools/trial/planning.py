# SPDX-License-Identifier: BSD-3-Clause
"""Judge of paths: what a robot that drives them would meet, and ways that are said not to be there."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

import ndtree
from trial.maps import Truth, count_in, distance_to, mapped, recorded
from trial.outcome import Case, Outcome
from trial.robots import Recording
from trial.scene import Floats

_GOALS = 6
_OFTEN = 5  # Beams that end in a cell with which it is no chance.


def plan_trial(case: Case) -> tuple[Recording, Outcome]:
    """Paths of a ball in the map of exact poses, with default options but cells and noise."""
    r, cell, last = recorded(case)
    truth, outcome = Truth(case.world, r, cell, case.rng), Outcome()
    m, half = (mapped(part, cell, is_fixed=case.is_fixed) for part in (r, r.kept(np.arange(len(r) // 2))))
    radius = float(case.rng.uniform(0.5, 4.0)) * cell
    body = ndtree.Sphere(radius)
    met = truth.ends[count_in(truth.ends, truth.ends, cell) >= _OFTEN]
    follows = ndtree.Planner(half, body)
    outcome.drawn["map"] = m
    deepest, unseen, longest, told_none, other = 0.0, 0, 1.0, 0, 0.0
    for goal, known in _goals(truth, radius, 0 if last is None else last):
        start = truth.origins[0 if known is None else known[0]]
        outcome.figures["known ways"] = outcome.figures.get("known ways", 0) + (known is not None)
        try:
            path = m.plan(start, goal, body=body)
        except ValueError:  # The body collides at the start or the goal.
            told_none += known is not None
            continue
        if not path:
            told_none += known is not None
            continue
        points = _dense(path.points, 0.5 * cell)
        clearance = distance_to(points, met).min() - radius
        outcome.figures["paths"] = outcome.figures.get("paths", 0) + 1
        deepest = max(deepest, (path.clearance - clearance - 3 * r.sensor.sigma) / cell)
        hidden = truth.is_hidden(points) & truth.is_clear(points)
        unseen += int(hidden.any())
        outcome.drawn["through hidden"] = points[hidden]
        if known is not None:
            longest = max(longest, path.length / known[1])
        follows.update(m)
        again = follows.plan(start, goal)
        other = max(other, abs(again.length - path.length)) if again else np.inf
    outcome.expect("told clearance", deepest)
    outcome.expect("through hidden", unseen)
    outcome.expect("longer than a known way", 100 * (longest - 1.0))
    outcome.expect("no way", told_none)
    outcome.expect("other after a change", other)
    return r, outcome


def _goals(truth: Truth, radius: float, last: int) -> Iterator[tuple[Floats, tuple[int, float] | None]]:
    """Places, and if the robot went there itself through what it saw: from which scan, how far."""
    scans = range(last, len(truth.recording))
    origins = truth.origins
    to = len(origins) - 1
    for first in (0, to // 2, to - 3):
        way = origins[first:]
        length = float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum())
        if length > truth.cell and _is_seen(truth, way, radius, scans):
            yield origins[to], (first, length)
            break
    points = truth.centers(truth.points(200))
    seen = points[truth.is_clear(points) & (truth.passing(points, scans) >= 3)]
    for goal in seen[:_GOALS]:
        yield goal, None


def _is_seen(truth: Truth, way: Floats, radius: float, scans: range) -> bool:
    """Whether three scans passed all cells that a ball may touch on a way, and no beam ended near."""
    reach = radius + 1.8 * truth.cell
    steps = np.arange(-np.ceil(reach / truth.cell), np.ceil(reach / truth.cell) + 1) * truth.cell
    ball = np.stack(np.meshgrid(*[steps] * truth.dim, indexing="ij"), -1).reshape(-1, truth.dim)
    ball = ball[np.linalg.norm(ball, axis=1) < reach]
    centers = truth.centers((_dense(way, truth.cell)[:, None] + ball).reshape(-1, truth.dim))
    centers = np.unique(centers, axis=0)
    return bool(truth.is_clear(centers).all() and (truth.passing(centers, scans) >= 3).all())


def _dense(points: Floats, step: float) -> Floats:
    """Along straight lines between points."""
    parts = [points[:1]]
    for one, other in zip(points[:-1], points[1:]):
        count = int(np.ceil(np.linalg.norm(other - one) / step))
        parts.append(one + np.linspace(0, 1, count + 1)[1:, None] * (other - one))
    return np.concatenate(parts)
