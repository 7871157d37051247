# SPDX-License-Identifier: BSD-3-Clause
"""Judges of poses: aligned logs, matched scans, localized robots."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import ndtree
from ndtree.alignment import Alignment, align_in_space
from ndtree.alignment.aligning import moves
from ndtree.alignment.online import OnlineAlignment
from ndtree.alignment.patches import turned_by
from ndtree.alignment.result import FoundPoses
from ndtree.live.localizing import Localizer
from trial import faults
from trial.maps import mapped
from trial.outcome import Case, Outcome, limit
from trial.robots import Recording, Sensor, laser, planar, poses_along, record, rings
from trial.worlds import chamber, room

_MATCHES = 10  # In one trial: 30 normalized errors.
_BEST = 1e-3  # No smaller standard deviation is taken in earnest [m].
_POINTS = 500  # Of a cloud that are matched, about.
_UPRIGHT = 2 * [1e-4]  # Variances of roll and pitch [rad²].


def align_trial(case: Case) -> tuple[Recording, Outcome]:
    """Poses of a log whose odometry has a fault."""
    return _aligned(case, ndtree.align if case.dim == 2 else align_in_space)


def slam_trial(case: Case) -> tuple[Recording, Outcome]:
    """The same, of scans that come one by one."""
    return _aligned(case, _one_by_one)


def _one_by_one(log: Any) -> Alignment:
    online = OnlineAlignment(odometry=moves(log))
    for scan in log:
        online.add(scan)
    return online.finish()


def _aligned(case: Case, find: Callable[[Any], FoundPoses]) -> tuple[Recording, Outcome]:
    world, fault, rng = case.world, case.fault, case.rng
    if case.dim == 2:
        sensor = laser(rng, beams=int(rng.choice([90, 180, 360])))
        scans, motion = int(rng.integers(70, 110)), str(rng.choice(["drives", "drives", "pushed"]))
    else:
        sensor, scans, motion = rings(rng, int(rng.choice([16, 32]))), int(rng.integers(60, 90)), "drives"
    true = poses_along(world, rng, scans, motion)
    r = getattr(faults, fault)(record(world.scene, sensor, true, rng), rng)
    outcome = Outcome()
    with tempfile.TemporaryDirectory() as folder:
        log = ndtree.read(r.save(Path(folder) / "log.npz"))
        try:
            found = find(log)
        except ValueError as error:
            outcome.refused = str(error)
            return r, outcome
    truth = r.true[:, : case.dim, 3]
    off = np.linalg.norm(found.places - truth, axis=1)  # The first pose is told as it is.
    way = np.linalg.norm(np.diff(truth, axis=0), axis=1).sum()
    # Of ground on which little else stands, few rings tell little.
    outcome.words, outcome.may_doubt = list(found.doubts), not world.is_tellable or world.is_bare
    outcome.figures["way"] = round(float(way), 2)
    outcome.expect("poses", off.max(), "m off", max(limit("poses"), 0.01 * way))
    outcome.drawn["true"] = truth[:, :2]
    outcome.drawn["found"] = found.places[:, :2]
    outcome.drawn["told"] = planar(r.told)[:, :2]
    return r, outcome


def _in_a_row(values: np.ndarray) -> np.ndarray:
    """How many have been true up to each."""
    count = np.cumsum(values)
    return count - np.maximum.accumulate(np.where(values, 0, count))


def match_trial(case: Case) -> tuple[Recording, Outcome]:
    """Scans matched with a map of exact poses, from guesses that are off; errors against what is told."""
    cell = float(case.rng.choice([0.025, 0.05, 0.1]))
    sensor = laser(case.rng)
    if case.dim == 3:
        cell, sensor = 2.0 * cell, rings(case.rng, int(case.rng.choice([16, 32])))
    r, m, off, told = matched(case, sensor, cell)
    outcome = Outcome()
    if len(off) < _MATCHES // 2:
        outcome.refused = "too few scans see anything"
        return r, outcome
    outcome.figures["error"] = round(float(np.sqrt(np.mean(np.square(off[:, :-1])))), 4)
    outcome.figures["told"] = round(float(np.sqrt(np.mean(np.square(told[:, :-1])))), 4)
    outcome.expect("normalized error", np.sqrt(np.mean((off / told) ** 2)))
    outcome.drawn["map"] = m
    return r, outcome


def matched(
    case: Case, sensor: Sensor, cell: float
) -> tuple[Recording, ndtree.OccupancyMap, np.ndarray, np.ndarray]:
    """What a map is of, the map, and of each match (n, dim + 1): errors of place and yaw, and those told."""
    world, rng, d = case.world, case.rng, case.dim
    half = np.repeat(_GUESSES[case.fault], (d, 1))
    r = record(world.scene, sensor, poses_along(world, rng, 40, "drives"), rng)
    m = mapped(r, cell, is_fixed=case.is_fixed)
    matcher, off, told = m.matcher(), [], []
    # What is along a smooth wall is odometry's to say; in space, gravity says roll and pitch.
    variances = np.insert(half**2 / 3, 3, _UPRIGHT if d == 3 else [])
    for i in rng.choice(len(r), _MATCHES, replace=False):
        true = r.true[i]
        fresh = record(world.scene, sensor, r.true[i : i + 1], rng)
        by = rng.uniform(-1, 1, d + 1) * half
        points = fresh.points(0)
        if len(points) < 10:
            continue
        guess = true.copy()
        guess[:d, 3] += by[:d]
        guess[:3, :3] = turned_by(np.array([0.0, 0.0, by[d]])) @ guess[:3, :3]
        found = matcher.match(
            points[:: -(-len(points) // _POINTS)] if d == 3 else points,
            guess if d == 3 else planar(guess[None])[0],
            window=tuple(2 * half),
            information=np.diag(1.0 / variances),
        )
        turn = np.arctan2(found.pose[1, 0], found.pose[0, 0]) - np.arctan2(true[1, 0], true[0, 0])
        off.append([*(found.pose[:d, d] - true[:d, 3]), np.angle(np.exp(1j * turn))])
        sigma = np.sqrt(np.diag(found.covariance))[[*range(d), -1]]
        told.append(sigma.clip([_BEST] * d + [_BEST / 10]))
    return r, m, np.array(off).reshape(-1, d + 1), np.array(told).reshape(-1, d + 1)


#: Half the width of what guesses are off by: place on each axis and yaw [m, rad].
_GUESSES = {"near": (0.1, 0.05), "far": (0.3, 0.15)}


def localize_trial(case: Case) -> tuple[Recording, Outcome]:
    """A robot tracked in a map of exact poses: where it says to be, while it does not say that it is lost."""
    world, fault, rng = case.world, case.fault, case.rng
    cell, sensor, outcome = 0.05, laser(rng, beams=int(rng.choice([180, 360]))), Outcome()
    if case.dim == 3:
        cell, sensor = 0.1, rings(rng, int(rng.choice([16, 32])))
    r = record(world.scene, sensor, poses_along(world, rng, 60, "drives"), rng)
    m = mapped(r.kept(np.arange(0, 60, case.dim - 1)), cell, is_fixed=case.is_fixed)
    scene, true = world.scene, r.true
    if fault == "other_building":
        other = (room if case.dim == 2 else chamber)(rng).placed(rng, cell)
        scene, true = other.scene, poses_along(other, rng, 60, "drives")
    if fault == "carried":
        true = np.concatenate([true[:15], np.tile(true[-1:], (45, 1, 1))])
    again = record(scene, sensor, true, rng)
    if fault in ("drift", "jump", "scale", "stall"):
        again = getattr(faults, fault)(again, rng)
    if fault == "carried":
        again.told = np.concatenate([true[:15], np.tile(true[14:15], (45, 1, 1))])
    outcome.may_doubt = not world.is_tellable
    first = planar(again.true)[0]
    it = Localizer(m, None if fault in ("other_building", "no_guess") else first)
    off, told, lost = [], [], []
    truth, d = planar(again.true), case.dim
    odometry = planar(again.told) if d == 2 else again.told
    for i in range(len(again)):
        points = again.points(i)
        here = it.track(points, odometry[i], float(again.stamps[i]))
        error, variance = here.pose[:d, d] - again.true[i, :d, 3], here.covariance
        off.append([np.hypot(*error[:2]), *np.abs(error[2:])])  # A height has a deviation of its own.
        told.append(np.sqrt([np.linalg.eigvalsh(variance[:2, :2]).max(), *np.diag(variance)[2:d]]))
        lost.append(here.is_lost)
    sure = ~np.array(lost)
    beyond = (np.array(off) - np.maximum(limit("told place"), 3 * np.array(told))).max(axis=1)
    long = _in_a_row(sure & (beyond > 0)) > limit("told in a row")
    if fault == "other_building":
        outcome.figures["found"] = int(sure.sum())
        if sure.any():
            outcome.faults.append(f"found in {sure.sum()} of {len(sure)} scans, in another building")
    elif sure.any():
        outcome.figures["off"] = round(float(np.array(off)[sure].max()), 3)
        if long.any():
            at = int(np.where(long, beyond, -np.inf).argmax())
            by, sigma = np.round(off[at], 2), np.round(told[at], 3)
            outcome.faults.append(f"{by} m off in scan {at}, told sigma {sigma} m")
    if not outcome.faults and np.mean(lost) > 0.5:
        outcome.words = [f"lost in {sum(lost)} of {len(lost)} scans"]
        if fault == "other_building":
            outcome.words = []
    outcome.drawn["map"] = m
    outcome.drawn["true"] = truth
    return again, outcome
