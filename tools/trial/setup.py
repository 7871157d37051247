# SPDX-License-Identifier: BSD-3-Clause
"""Judge of what is said of a robot that is set up wrongly: its mount, its clock, its units, its frames."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from trial import bag
from trial.maps import Truth
from trial.outcome import Case, Outcome
from trial.robots import Recording, laser, planar, poses_along, record
from trial.scene import Floats

_CELL = 0.05
_STEP = 0.02  # Of the poses that are told [s].

#: What may be said of a fault; any other cause leads astray.
_SAID = {
    "late": {"clock"},
    "turned": {"yaw", "mount"},
    "moved": {"place", "mount"},
    "mirrored": {"mirrored"},
    "backwards": {"signs", "mirrored"},
    "scaled": {"scale"},
    "begins_at_0": set(),
    "millimetres": {"unit"},
    "degrees": {"degrees"},
}

Told = Callable[[Floats], Floats]


def _told(true: Told, fault: str, rng: np.random.Generator, first: float) -> Told:
    """Poses (n, 3) at times, as a robot with a fault tells them. `first`: Time of an early scan [s]."""
    size = rng.choice([-1, 1]) * rng.uniform(0.5, 1.0)
    side = rng.uniform(-0.3, 0.3, 2)

    def moved(times: Floats) -> Floats:
        poses = true(times)
        c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        return poses + np.c_[c * side[0] - s * side[1], s * side[0] + c * side[1], 0 * c]

    noise = rng.normal(0, rng.uniform([0.01, 0.01, 0.004], [0.03, 0.03, 0.01]), (80, 3))

    def noisy(times: Floats) -> Floats:
        return true(times) + noise[np.rint(10 * times).astype(int).clip(0, 79)]

    told: dict[str, Told] = {
        "noisy": noisy,
        "late": lambda times: true(times + 0.3 * size),
        "turned": lambda times: true(times) + np.array([0, 0, 0.2 * size]),
        "moved": moved,
        "backwards": lambda times: true(times) * [1, 1, -1],
        "millimetres": lambda times: true(times) * [1000, 1000, 1],
        "degrees": lambda times: true(times) * [1, 1, 180 / np.pi],
        "begins_at_0": lambda times: np.where((times < first)[:, None], 0.0, true(times)),
    }
    return told.get(fault, true)


def setup_trial(case: Case) -> tuple[Recording, Outcome]:
    """Whether the map of a bag is said to be doubtful where surfaces lie beside their places in it."""
    rng, outcome = case.rng, Outcome()
    sensor = laser(rng, beams=int(rng.choice([180, 360, 720])))
    r = record(case.world.scene, sensor, poses_along(case.world, rng, 80, "drives"), rng)
    poses = planar(r.true)
    poses[:, 2] = np.unwrap(poses[:, 2])

    def true(times: Floats) -> Floats:
        return np.c_[[np.interp(times, r.stamps, column) for column in poses.T]].T

    told = _told(true, case.fault, rng, float(r.stamps[rng.integers(1, 6)]) - 0.05)
    times = np.arange(-_STEP, r.stamps[-1] + 2 * _STEP, _STEP)
    transforms = [(float(t), float(t) - 0.01, pose) for t, pose in zip(times, told(times))]
    readings = r.ranges
    if case.fault == "scaled":
        readings = readings * rng.choice([0.9, 0.95, 1.05, 1.1])
    hung = bool(rng.random() < 0.3)
    if hung != (case.fault == "mirrored"):
        readings = readings[:, ::-1]
    m, chosen = bag.mapped(r, readings, outcome, transforms, hung=hung)
    if m is None:
        return r, outcome
    truth = Truth(case.world, r, _CELL, rng)
    leaves = m.leaves(states=["occupied"])
    size = np.asarray(leaves.size)
    centers = np.asarray(leaves.lower) + size[:, None] / 2
    away = _aligned(centers, truth.ends) > truth.margin + 0.7 * (size - _CELL)
    # A straight drive is as in a mirror, backwards as turned. Noisy poses make walls as rough without a
    # cause that is to be named.
    is_straight = np.ptp(poses[:, 2]) <= 0.5
    hides = case.fault == "noisy" or (case.fault == "mirrored" and is_straight)
    if len(size) and not hides:
        outcome.expect("displaced walls", 100 * float(np.average(away, weights=size**2)))
    outcome.drawn.update({"map": m, "displaced walls": centers[away]})
    outcome.words = [one for one in outcome.words if "had no pose" not in one]  # At the log's ends.
    outcome.may_doubt = case.fault in _SAID
    said = chosen.get("setup")
    may_say = _SAID.get(case.fault, set())
    if case.fault in ("backwards", "degrees") and is_straight:
        may_say = may_say | _SAID["turned"]
    kinds = {one["kind"] for one in (said, *said["others"])} if said else set()
    if case.fault in _SAID and kinds and not kinds & may_say:
        outcome.faults.append(f"said to be {' or '.join(sorted(kinds))}")
        outcome.words = []
    return r, outcome


def _aligned(points: Floats, others: Floats) -> Floats:
    """(n,) distance of points to the nearest others, moved and turned as a whole to where they lie nearest.

    A map that is elsewhere as a whole is right: that only shows where poses are asked of others.
    """
    cells = np.unique(np.rint(others / 0.04).astype(int), axis=0) * 0.04
    squares = (cells**2).sum(1)
    best = np.full(len(points), np.inf)
    for _ in range(12):
        nearest = (squares - 2 * points @ cells.T).argmin(1)
        found = np.linalg.norm(points - cells[nearest], axis=1)
        best = min(best, found, key=np.median)
        use = found <= max(np.quantile(found, 0.8), 1e-9) if len(found) else np.zeros(0, bool)
        if np.count_nonzero(use) < 3:
            break
        at, to = points[use], cells[nearest[use]]
        u, _, v = np.linalg.svd((at - at.mean(0)).T @ (to - to.mean(0)))
        turn = u @ np.diag([1.0, np.linalg.det(u @ v)]) @ v
        points = (points - at.mean(0)) @ turn + to.mean(0)
    return best
