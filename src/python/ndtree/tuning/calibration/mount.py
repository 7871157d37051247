# SPDX-License-Identifier: BSD-3-Clause
"""Where a sensor sits on its base, and how far its clock is off: by motions that it saw and its base made.

Strategy: scans near each other are matched. What the sensor moved, A, follows from what the base moved, B,
and the mount X as A = X^-1 B X (R. Y. Tsai and R. K. Lenz, "A new technique for fully autonomous and
efficient 3D robotics hand/eye calibration", IEEE Trans. Robotics and Automation 5, 1989). Next scans, whose
motions are small, are matched whatever X is, and say it roughly: equations are linear in x, y, and the sine
and cosine of yaw. Then farther ones are matched from there, and X and the clock fitted to their errors, which
are Student's t with the covariances of the matches and of what poses err; so it is known how sure each number
is.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ndtree._errors import Text
from ndtree.alignment.patches import turn_of, turned_by
from ndtree.alignment.planar import Floats, wrapped, yaw_of
from ndtree.alignment.surfaces import Cloud
from ndtree.base.progress import Progress, no_progress
from ndtree.evaluation.sampling import spread
from ndtree.logs.ros.rosbag import RosbagLog
from ndtree.tuning.motions import rigid
from ndtree.tuning.setup import ASIDE, Drive
from ndtree.tuning.setup_error import FREEDOM, LEAST_PAIRS, likelihoods, spread_of, weights_of

#: Of x and y [m], yaw [rad] and time [s]: what is known before, and how sure they must be to be told.
PRIOR = np.array([1.0, 1.0, math.pi, 0.5])
TOLD = np.array([0.1, 0.1, math.radians(3.0), 0.05])
_NAMES = ("x", "y", "yaw", "time")
_ROUNDS, _STILL = 3, np.array([0.005, 0.005, math.radians(0.1), 0.002])  # Of reading the log.
_STEPS, _SMALL = 5, 1e-3  # Of fitting, and of slopes.
_CLOCKS = (-0.3, -0.15, 0.0, 0.15, 0.3)  # That fitting starts with [s].
_PAIRS = 48  # Of next scans, for the time that they take.
_ROUGH = 0.05  # Of a rough fit, what motions err [m].
_PARTS = 8  # Of the drive: variances are as large as these differ.
_LEAST_SPREAD = 0.05  # Of squared errors to what was expected.
_TURNS = 0.3  # Of all turns together, from which on they say which way is up [rad].
_FLIP = np.diag([1.0, -1.0, -1.0, 1.0])  # A planar sensor may hang upside down.


@dataclass(frozen=True)
class Mounting:
    """What `find_mount` found: the mount in the plane, and what to add to the times of scans.

    `x`, `y`: [m]
    `others` (float, float, float): z [m], roll and pitch [rad], as they were given.
    `sigma` (float, float, float, float): Standard deviations of x and y [m], yaw [rad] and time [s]. What is
        less sure than `TOLD` is as it was given.
    """

    x: float
    y: float
    yaw: float  # [rad]
    others: tuple[float, float, float]
    time_offset: float  # [s]
    sigma: tuple[float, float, float, float]

    @property
    def flags(self) -> str:
        """As one would type them."""
        return f"--mount {self.mount} --time-offset {self.time_offset:.3f}"

    @property
    def mount(self) -> str:
        """As one would type it."""
        z, roll, pitch = self.others
        yaw = f"{math.degrees(self.yaw):.1f}deg"
        place = f"{self.x:.3f},{self.y:.3f}"
        if any(abs(value) > 1e-9 for value in self.others):
            return f"{place},{z:.3f},{math.degrees(roll):.1f}deg,{math.degrees(pitch):.1f}deg,{yaw}"
        return f"{place},{yaw}"

    @property
    def untold(self) -> list[str]:
        """What the drive does not tell, of x, y, yaw and time."""
        return [name for name, sigma, most in zip(_NAMES, self.sigma, TOLD) if sigma > most]

    def figures(self) -> dict[str, Any]:
        """All of it as plain numbers, ready for JSON."""
        return {**vars(self), "others": list(self.others), "sigma": list(self.sigma), "flags": self.flags,
                "untold": self.untold}  # fmt: skip

    def __str__(self) -> str:
        """In one line, and in a second one what is not told."""
        x, y, yaw, time = self.sigma
        sure = f"standard deviations {x:.3f} m, {y:.3f} m, {math.degrees(yaw):.1f} degrees, {time:.3f} s"
        said = f"scans fit each other best with {self.flags} ({sure})"
        untold = self.untold
        if untold:
            which = " and ".join(", ".join(untold).rsplit(", ", 1))
            said += f"\nnot sure of {which}, left as given: such a drive does not tell; drive more curves"
        return Text(said)


def find_mount(log: RosbagLog, *, progress: Progress | None = None) -> Mounting:
    """Find x, y and yaw of a mount, and the offset of the clock, by motions of the sensor and of its base.

    Yaw may be anything, and a planar sensor may hang upside down: without turns, only what looks along the
    way sees the same either way. The log is read up to three times, as the mount says where beams were during
    a scan.

    `log`: Opened with a ``mount``.
    `progress`: Called as ``progress(what, done, total)``.
    Raises ValueError if fewer than 12 pairs of scans fit each other.
    """
    sigma, unsure = np.zeros(4), 0.0
    for number in range(_ROUNDS):
        drive = _drive(log, progress or no_progress)
        by, flip = np.zeros(4), np.eye(4)
        if number == 0:
            by[:3], flip, unsure = _rough(drive)
        change, sigma = _found(log.path, drive, by, flip)
        sigma[2] = math.hypot(sigma[2], unsure)
        is_flipped = not np.array_equal(flip, np.eye(4))
        change = np.where(sigma <= TOLD, change, 0.0)
        found = _moved(log, change, is_flipped, sigma)
        options = replace(log.plan.options, mount=found.mount, time_offset=found.time_offset)
        log = RosbagLog(log.path, options, dim=log.dim)
        if not is_flipped and (np.abs(change) < _STILL).all():
            break
    return found


def _moved(log: RosbagLog, by: Floats, is_flipped: bool, sigma: Floats) -> Mounting:
    """The mount of a log, changed by x, y, yaw and time."""
    given = log.place.tree.fixed_parent(log.place.frame)[1]
    position, rotation = given.position.copy(), given.rotation
    position[:2] += turned_by(np.array([0.0, 0.0, yaw_of(rotation)]))[:2, :2] @ by[:2]
    rotation = turned_by(np.array([0.0, 0.0, by[2]])) @ (rotation @ _FLIP[:3, :3] if is_flipped else rotation)
    pitch = math.asin(min(max(-float(rotation[2, 0]), -1.0), 1.0))
    others = (float(position[2]), math.atan2(rotation[2, 1], rotation[2, 2]), pitch)
    offset = log.plan.options.time_offset + float(by[3])
    x, y = map(float, position[:2])
    of_x, of_y, of_yaw, of_time = map(float, sigma)
    return Mounting(x, y, yaw_of(rotation), others, offset, (of_x, of_y, of_yaw, of_time))


def _drive(log: RosbagLog, progress: Progress) -> Drive:
    scans = log.ruled(cut_off=None)
    runs, _, _ = spread(scans, lambda done: progress("looking at the log", done, len(log)), Cloud.of)
    return Drive([[one for one in run if one is not None] for run in runs])


def _found(path: str, drive: Drive, by: Floats, flip: Floats) -> tuple[Floats, Floats]:
    """What is to be added to x, y, yaw and time, near some values, and how sure that is."""
    pairs, _ = drive.pairs()
    matched, seen, covariances = drive.matched(pairs, [flip @ _of_sensor(drive.motions(pairs), by) @ flip])
    if len(matched) < LEAST_PAIRS:
        raise ValueError(
            f"{path}: {len(matched)} pairs of scans fit each other, expected at least {LEAST_PAIRS}: "
            "a drive past walls, with poses"
        )
    pairs, seen = pairs[matched], flip @ seen @ flip
    flips = np.kron(np.eye(2), flip[:3, :3])
    whitening = drive.whitening(flips @ covariances @ flips, drive.motions(pairs))

    def errors(by: Floats) -> Floats:
        told = _of_sensor(drive.motions(pairs, "clock", by[3:]), by)
        return np.einsum("nij,nj->ni", whitening, drive.errors(seen, told))

    stamps = np.array([one.stamp for one in drive.clouds])
    # Pairs share scans; and where poses drift, what one errs all do whose motions contain it.
    alike = 1.0 + np.ptp(stamps[pairs], axis=1).sum() / np.ptp(stamps)
    fits = [_fitted(errors, np.append(by[:3], clock), alike) for clock in _CLOCKS]
    each = [likelihoods(errors(one)) for one, _ in fits]
    best = max(range(len(fits)), key=lambda i: each[i].sum())
    (by, variance), all_, others = fits[best], 0.0, np.zeros(4)
    for (one, _), likely in zip(fits, each):
        off, less = one - by, likely - each[best]
        weight = math.exp(-0.5 * float(less.sum()) ** 2 / max(float(less @ less), 1e-12))
        all_, others = all_ + weight, others + weight * off**2
    return by, np.sqrt(variance + others / all_)


def _of_sensor(motions: Floats, by: Floats) -> Floats:
    """Motions (n, 4, 4) of a base as a sensor makes them that sits there."""
    mount = rigid(turned_by(np.array([0.0, 0.0, by[2]])))
    mount[:2, 3] = by[:2]
    result: Floats = np.linalg.inv(mount) @ motions @ mount
    return result


def _rough(drive: Drive) -> tuple[Floats, Floats, float]:
    """About x, y and yaw, by scans that are next to each other, and the flip of a sensor upside down.

    Last comes by how much yaw is another one if it hangs the other way, where turns do not tell [rad].
    """
    first = np.arange(len(drive.poses) - 1)[:: max(1, len(drive.poses) // _PAIRS)]
    pairs: Any = np.stack((first, first + 1), axis=1)
    told = drive.motions(pairs)
    matched, seen, _ = drive.matched(pairs, [told, *(read(told) for read in ASIDE.values())])
    told, flip = told[matched], np.eye(4)
    turns, others = (np.array([turn_of(one)[2] for one in some[:, :3, :3]]) for some in (told, seen))
    unsure = drive.is_planar and abs(float(turns @ others)) < _TURNS**2 / max(len(turns), 1)
    if drive.is_planar and not unsure and turns @ others < 0:
        flip = _FLIP
    moved = (flip @ seen @ flip)[:, :2, 3]
    rows = np.zeros((len(told), 2, 4))
    rows[:, :, :2] = np.eye(2) - told[:, :2, :2]
    rows[:, :, 2], rows[:, 0, 3], rows[:, 1, 3] = moved, -moved[:, 1], moved[:, 0]
    weights, values = np.ones(len(told)), np.zeros(4)
    for _ in range(_STEPS):
        normal = np.einsum("n,nik,nil->kl", weights, rows, rows) + np.diag([1.0, 1.0, 1e-3, 1e-3]) * _ROUGH**2
        values = np.linalg.solve(normal, np.einsum("n,nik,ni->k", weights, rows, told[:, :2, 3]))
        left = ((told[:, :2, 3] - rows @ values) ** 2).sum(axis=1)
        weights = 1.0 / (1.0 + left / _ROUGH**2)
    seen_way = weights @ (moved * np.sign(told[:, :1, 3]))
    aside = float(wrapped(2 * np.arctan2(*seen_way[::-1]))) if unsure else 0.0
    return np.array([*values[:2].clip(-1.0, 1.0), math.atan2(values[3], values[2])]), flip, aside


def _fitted(errors: Callable[[Floats], Floats], by: Floats, alike: float) -> tuple[Floats, Floats]:
    """The likeliest near some values, and the variance of each. `alike`: How many errors are one."""
    prior = by * [0.0, 0.0, 0.0, 1.0]
    for step in range(_STEPS):
        left = errors(by)
        slopes = np.stack([(errors(by + _SMALL * axis) - left) / _SMALL for axis in np.eye(4)], axis=-1)
        squared = (left**2).sum(axis=1)
        weights = weights_of(squared, left.shape[1])
        normal = np.einsum("n,nik,nil->kl", weights, slopes, slopes) + np.diag(PRIOR**-2)
        slope = np.einsum("n,nik,ni->k", weights, slopes, left) + (by - prior) * PRIOR**-2
        if step < _STEPS - 1:
            by = by - np.linalg.solve(normal, slope)
    spread = spread_of(squared, left.shape[1], _LEAST_SPREAD)
    likely = weights * FREEDOM / (FREEDOM + left.shape[1]) / spread
    normal = np.einsum("n,nik,nil->kl", likely, slopes, slopes) + np.diag(PRIOR**-2)
    inverse = np.linalg.inv(normal)
    pulls = np.einsum("n,nik,ni->nk", likely, slopes, left) @ inverse
    parts = np.array([part.sum(axis=0) for part in np.array_split(pulls, _PARTS)])
    variance: Floats = alike * np.maximum(np.diag(inverse), _PARTS / (_PARTS - 1) * (parts**2).sum(axis=0))
    return by, variance.clip(max=PRIOR**2)
