# SPDX-License-Identifier: BSD-3-Clause
"""Whether a lidar or a planar laser is mounted, timed and scaled, and its poses are read, as its log says.

Strategy: scans near each other on the way are matched. If one thing is wrong all along, what the match says
of the sensor's motion differs from what the poses say in a way that depends on the motion. In the frame of a
robot on which the sensor sits as it is told to sit at first, with the told motion (R, t), the error is

- (((1 + k) Rot(-a) - 1) t, 0) of a mount turned by a, with distances 1 + k times as large;
- ((R - 1) m, 0) of a mount moved by m; with it, a small turn is (-a J t, 0), J v = (-v_y, v_x, 0);
- (-d x t, (R - 1) d) of a mount that is tilted by d;
- what the told motion changes by in s seconds, of poses taken s seconds too early;
- (0, k phi) of turns phi that are 1 + k times as large.

Noise of the poses must not look like an error: motions are far larger, few pairs share a scan, and a clock
must be far likelier than one that goes wrong the other way. Poses that are read wrongly are wrong all along,
too: where scans fit better as poses are read otherwise, pairs are matched from all these readings, and the
best counts if it is far likelier than the told one. Where nothing is seen twice, nothing is told: a robot
that only drives straight on shows neither a moved mount nor a mirrored laser, and one that always drives
alike no wrong clock.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from ndtree.alignment.patches import turn_of, turned_by
from ndtree.alignment.planar import Floats, yaw_of
from ndtree.alignment.surfaces import FITS, Cloud, unit_of
from ndtree.logs.poses.pose import about_axes, matrices_of, quaternions_of
from ndtree.tuning.motions import (
    errors_of,
    has_moved,
    motions_of,
    moved_by,
    pose_noise,
    rigid,
    vector_of,
)
from ndtree.tuning.setup_error import (
    BOTH,
    GAIN,
    LEAST_PAIRS,
    NEARER,
    UNITS,
    SetupError,
    are_degrees,
    fits_of,
    is_gain,
    likeliest,
    likelihood,
    said_of,
)

_FOLLOWS = 1.5  # Usual steps: a cloud that comes no later is the next.
_MOST_PAIRS, _MOST_NEAR = 48, 16  # For the time that they take.
#: Between clouds of a pair, least and most way [m] and turn [rad]: their motion is much larger than what
#: poses and matches err, and they see the same.
_LEAST_MOTION, _FAR, _MOST_TURN = (0.4, 0.25), 4.0, 0.95
_FARTHEST = 6.0  # Most of the way to the next, if that is farther [m].
_FRESH = (0.1, 0.06)  # From one to the next, so that a cloud is in few pairs [m, rad].
#: Of points in the frame of a sensor up to 1 % are hidden, at edges; moved into the map, 6 to 45 %.
_HIDDEN = 0.03
_AS_WELL = 0.02  # A match fits no better.
_SAME = 0.03  # Motions that differ by less lead to one match [m, rad].
#: What may be wrong, and its columns of `Drive.slopes`.
_KINDS = {
    "yaw": [0, 1], "scale": [1], "place": [2, 3], "clock": [4], "turns": [5], "mount": [0, 2, 3],
    "tilt": [6, 7],
}  # fmt: skip
_ROUNDS = 4  # Of what is not small.
_LATEST = 0.6  # Of a clock [s]; one that is later leads from one end of a drive to the other.
_TRIED = {"clock": [np.array([0.05 * one]) for one in range(-8, 9)], "tilt": []}  # [s]
#: Axes of a camera, z forward and x to the right, of one whose x is forward and z up.
_CAMERA = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
_MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])


def _wxyz(pose: Floats) -> Floats:
    result = pose.copy()
    result[:3, :3] = matrices_of(quaternions_of(pose[None, :3, :3])[:, [1, 2, 3, 0]])[0]
    return result


def _other_signs(pose: Floats) -> Floats:
    result = pose.copy()
    result[:3, :3] = pose[:3, :3].T
    return result


def _aside(motions: Floats, angle: float) -> Floats:
    turn = rigid(turned_by(np.array([0.0, 0.0, angle])))
    result: Floats = turn.T @ motions @ turn
    return result


def _times(motions: Floats, scale: float) -> Floats:
    result = motions.copy()
    result[:, :3, 3] *= scale
    return result


#: Other ways to read the pose of a sensor.
_READINGS: dict[str, Callable[[Floats], Floats]] = {
    "inverted": lambda pose: np.asarray(np.linalg.inv(pose), dtype=np.float64),
    "signs": _other_signs,
    "wxyz": _wxyz,
    "axes": lambda pose: _CAMERA.T @ pose @ _CAMERA,
}
#: Motions of a robot whose sensor looks aside or back: they only say where to search.
ASIDE: dict[str, Callable[[Floats], Floats]] = {
    str(angle): partial(_aside, angle=angle) for angle in (math.pi / 2, math.pi, -math.pi / 2)
}
#: Ways of other lengths, likewise, of planar lasers: beside railings, patterns of rings fit, too.
_LENGTHS: dict[str, Callable[[Floats], Floats]] = {
    f"times {scale}": partial(_times, scale=scale) for scale in (0.8, 0.9, 1.1, 1.2)
}
_UNITS = {f"times {scale}": scale for scale in UNITS}
#: Ways in other units, or none; and no motion at all, from where turns are found that no pose tells.
_MEASURES: dict[str, Callable[[Floats], Floats]] = {
    **{kind: partial(_times, scale=scale) for kind, scale in {"times 0.0": 0.0, **_UNITS}.items()},
    "degrees": lambda motions: np.tile(np.eye(4), (len(motions), 1, 1)),
}
#: Of these, those next to none: rings on the ground look the same as if nothing had moved.
_STILL = ("times 0.0", *(kind for kind, scale in _UNITS.items() if scale < 1))
#: A turn to the next cloud that no match finds [rad], and how many of them tell that they are misread.
_LOST, _FEW = 0.35, 4
#: What else a robot's motion may be.
_MOTIONS = {"mirrored": lambda motions: _MIRROR @ motions @ _MIRROR, **ASIDE, **_MEASURES}


def setup_error(runs: Sequence[Sequence[Cloud]]) -> SetupError | None:
    """Find what is wrong with mount, clock, scale or poses of a log all along.

    `runs`: Clouds that follow each other.
    Returns: None where nothing is, or too little tells.
    """
    log = Drive([[one for one in run if one.is_turned] for run in runs])
    if log.are_moved():
        return SetupError("moved", (), None)
    misread: list[SetupError] = []
    pairs, is_far = log.pairs()
    readings = log.readings(pairs)
    few = slice(None, None, max(1, len(pairs) // _MOST_NEAR))
    turned = [float(np.linalg.norm(turn_of(one[:3, :3]))) > _LOST for one in readings[""][~is_far]]
    unlikely = {
        *(_STILL if np.count_nonzero(is_far) >= LEAST_PAIRS else ()),
        *(["degrees"] if sum(turned) < _FEW else ()),
    }
    agree = {
        kind: log.agreement(pairs[few], motions[few])
        for kind, motions in readings.items()
        if kind not in unlikely
    }
    kinds = [kind for kind in agree if agree[kind] >= agree[""]]
    if len(kinds) == 1:
        use = is_far if is_far.any() else np.isin(np.arange(len(pairs)), np.arange(len(pairs))[few])
        pairs, is_far = pairs[use], is_far[use]
        readings = {kind: motions[use] for kind, motions in readings.items()}
    at, seen, covariances = log.matched(pairs, [readings[kind] for kind in kinds])
    whitening = log.whitening(covariances, readings[""][at])
    if len(at) >= LEAST_PAIRS:
        left = {
            kind: np.einsum("nij,nj->ni", whitening, log.errors(seen, readings[kind][at]))
            for kind in ("", *ASIDE, *_LENGTHS, *_READINGS, "mirrored", "times 0.0", *_UNITS, "degrees")
            if kind in (*kinds, "times 0.0", *_UNITS)  # Of ways next to none, told ones fit as well.
        }
        if "degrees" in kinds:
            others = [errors_of(seen, readings[kind][at])[:, 3:] for kind in left]
            of_z = [
                np.array([turn_of(one)[2] for one in some[:, :3, :3]]) for some in (readings[""][at], seen)
            ]
            may_be = are_degrees(*of_z, others, 1 / np.linalg.norm(whitening[:, :, -1], axis=1))
            if may_be is not False:
                return SetupError("degrees", (), None) if may_be else None
        likely = {kind: likelihood(one) for kind, one in left.items()}
        # None moves beyond what it sees between scans.
        reach = max(float(one.ranges.max(initial=0.0)) for one in log.clouds)
        if reach < float(np.median(np.linalg.norm(readings[""][:, :3, 3], axis=1))):
            del likely["times 0.0"]
        # Straight on, several read alike.
        alike = [kind for kind in likely if likely[kind] > max(likely.values()) - BOTH]
        best, is_told = alike[0], partial(is_gain, left[""])
        misread = [
            SetupError(kind, (), None)
            for kind in alike
            if kind in (*_READINGS, "mirrored") and is_told(left[kind])
        ]
        if best in _UNITS and is_told(left[best]):
            return SetupError("unit", (_UNITS[best],), None)
        if misread and best == misread[0].kind:
            return replace(misread[0], others=tuple(misread[1:]))
    far = is_far[at]
    if np.count_nonzero(far) < LEAST_PAIRS or log.unit != 1.0:
        return None
    causes = _causes(log, pairs[at[far]], seen[far], whitening[far])
    return replace(causes[0], others=(*causes[1:], *misread)) if causes else None


def _causes(log: Drive, pairs: Floats, seen: Floats, whitening: Floats) -> list[SetupError]:
    """What explains errors that depend on the motion, the likeliest first; none if nothing does."""
    told = log.motions(pairs)
    raw = log.slopes(pairs, told)
    errors = log.errors(seen, told)
    columns = {kind: one for kind, one in _KINDS.items() if kind != "tilt" or not log.is_planar}
    fits = fits_of(errors, raw, whitening, columns)
    whitened = np.einsum("nij,nj->ni", whitening, errors)
    fits["yaw"] = _turned(fits["yaw"][0], whitened, whitening @ raw)
    for kind in {"clock", "tilt"} & set(fits):
        fits[kind] = _again(log, pairs, seen, whitening, kind, fits[kind][0])
    if not _is_clock(log, pairs, seen, whitening, *fits["clock"]):
        del fits["clock"]
    found = likeliest(whitened, fits)
    if not found or ("clock" in found and not log.has_times):
        return []
    first, second = np.triu_indices(len(log.poses), 1)
    beside = np.linalg.norm(log.poses[first, :3, 3] - log.poses[second, :3, 3], axis=1) < NEARER
    around = np.stack((first[beside], second[beside]), axis=1)
    slopes = log.slopes(around, log.motions(around))
    said = [said_of(kind, fits[kind][0], slopes[:, :, _KINDS[kind]] @ fits[kind][0]) for kind in found]
    return [one for one in said if one is not None]


def _turned(way: Floats, errors: Floats, slopes: Floats) -> tuple[Floats, Floats]:
    """As of `fits_of`, the mount whose turn is that of a way: a large one makes it shorter along, too."""
    angle = math.atan2(way[0], 1.0 + way[1])
    values = np.array([math.sin(angle), math.cos(angle) - 1.0])
    return values, errors - slopes[:, :, :2] @ values


def _is_clock(log: Drive, pairs: Floats, seen: Floats, whitening: Floats, by: Floats, left: Floats) -> bool:
    """Whether a clock is likelier than any that goes wrong the other way.

    Poses of other times have other noise, which may be less by chance, on either side alike.
    """
    if abs(by[0]) > _LATEST:
        return False
    others = [
        likelihood(np.einsum("nij,nj->ni", whitening, log.errors(seen, log.motions(pairs, "clock", one))))
        for one in _TRIED["clock"]
        if one[0] * by[0] < 0
    ]
    return likelihood(left) >= max(others, default=-math.inf) + GAIN


def _again(
    log: Drive, pairs: Floats, seen: Floats, whitening: Floats, kind: str, values: Floats
) -> tuple[Floats, Floats]:
    """As of `fits_of`, of a kind whose errors are not proportional to it, near some values."""

    def left_of(values: Floats) -> Floats:
        errors = log.errors(seen, log.motions(pairs, kind, values))
        return np.einsum("nij,nj->ni", whitening, errors)

    values = max((values, *_TRIED[kind]), key=lambda one: likelihood(left_of(one)))
    left = left_of(values)
    for _ in range(_ROUNDS):
        told = log.motions(pairs, kind, values)
        slopes = log.slopes(pairs, told)
        change = fits_of(log.errors(seen, told), slopes, whitening, {kind: _KINDS[kind]})[kind][0]
        if kind == "tilt":
            up = (_tilted(values) @ turned_by(np.append(change, 0.0)))[2]
            new = np.array([math.atan2(up[1], up[2]), -math.asin(np.clip(up[0], -1.0, 1.0))])
        else:
            new = values + change
        left_now = left_of(new)
        if likelihood(left_now) < likelihood(left) + 1.0:
            break
        values, left = new, left_now
    return values, left


def _tilted(values: Floats) -> Floats:
    """The rotation of a roll and a pitch."""
    about_x, about_y, _ = about_axes(float(values[0]), float(values[1]), 0.0)
    rotation: Floats = about_y @ about_x
    return rotation


class Drive:
    """The clouds that can be matched, and how their poses say that they lie to each other."""

    def __init__(self, runs: Sequence[Sequence[Cloud]]) -> None:
        #: Whether scans have times; else their numbers stand for them.
        stamps = np.array([one.stamp for run in runs if len(run) > 1 for one in run])
        self.has_times = bool((np.diff(stamps) > 0).all())
        runs = _joined(runs) if self.has_times else _numbered(runs)
        #: What clouds and ways are multiplied by.
        self.unit = unit_of([one for run in runs for one in run[1:-1]])
        if self.unit != 1.0:
            runs = [[one.times(self.unit) for one in run] for run in runs]
        clouds = [one for run in runs for one in run[1:-1]]
        self.clouds = _fresh(clouds)
        if len(self.clouds) < LEAST_PAIRS:  # It stands, or the way is in far too large a unit.
            self.clouds = clouds[:: max(1, len(clouds) // (2 * LEAST_PAIRS))]
        self.is_planar = any(one.scan.dim == 2 for one in self.clouds)
        #: Columns of motions and their errors that are seen.
        self.freedoms = [0, 1, 5] if self.is_planar else list(range(6))
        # How the sensor is told to sit, on the whole, as seen from where it looks.
        rotations = np.array([one.pose[:3, :3] for one in self.clouds]).reshape(-1, 3, 3)
        headings = [_heading(one, rotations[0]) for one in rotations]
        level = np.array([turned_by(np.array([0.0, 0.0, one])) for one in headings]).reshape(-1, 3, 3)
        u, _, v = np.linalg.svd(np.einsum("nji,njk->ik", level, rotations))
        #: From the sensor's frame into the robot's.
        self.seat = rigid(u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ v))]) @ v)
        self.poses = np.array([one.pose @ self.seat.T for one in self.clouds]).reshape(-1, 4, 4)
        moving = [run for run in runs if len(run) > 1]
        stamps = np.array([one.stamp for run in moving for one in run])
        self.velocities = np.zeros((len(self.clouds), 6))
        #: Poses by the scans before and behind alone, whose noise is not that of a pose itself.
        self.by_others = self.poses
        if moving:
            moves = [[self._velocity(a, b) for a, b in zip(run, run[1:])] for run in moving]
            usual = [[one[0], *(0.5 * (a + b) for a, b in zip(one, one[1:])), one[-1]] for one in moves]
            poses = np.array([one.pose @ self.seat.T for run in moving for one in run])
            #: Poses, velocities and times of all clouds.
            self.trail = poses, np.array([one for run in usual for one in run]), stamps
            at = np.searchsorted(stamps, [one.stamp for one in self.clouds])
            self.velocities = self.trail[1][at].reshape(-1, 6)
            self.by_others = np.array([self._by_others(i) for i in at]).reshape(-1, 4, 4)

    def _velocity(self, one: Cloud, other: Cloud) -> Floats:
        motion = self.seat @ np.linalg.inv(one.pose) @ other.pose @ self.seat.T
        return vector_of(motion) / (other.stamp - one.stamp)

    def _by_others(self, at: int) -> Floats:
        poses, _, stamps = self.trail
        before, behind = at - 1, at + 1
        part = (stamps[at] - stamps[before]) / (stamps[behind] - stamps[before])
        result: Floats = poses[before] @ moved_by(
            part * vector_of(np.linalg.inv(poses[before]) @ poses[behind])
        )
        return result

    def motions(self, pairs: Floats, kind: str = "", values: Floats | None = None) -> Floats:
        """(n, 4, 4) of the robot by its poses, of a sensor that is tilted or late by some values."""
        poses = self.poses
        if kind == "tilt" and values is not None:
            poses = poses @ rigid(_tilted(values))
        if kind == "clock" and values is not None:
            times = np.array([one.stamp for one in self.clouds]) + values
            at = np.abs(times[:, None] - self.trail[2]).argmin(axis=1)
            by = (times - self.trail[2][at])[:, None] * self.trail[1][at]
            poses = self.trail[0][at] @ np.array([moved_by(one) for one in by])
        return motions_of(poses, pairs)

    def readings(self, pairs: Floats) -> dict[str, Floats]:
        """Motions (n, 4, 4) of the robot as they are told, and as other readings have them."""
        told = self.motions(pairs)
        readings = {"": told}
        for kind, read in _READINGS.items():
            if kind in (("wxyz", "axes") if self.is_planar else ("signs",)):
                continue
            poses = np.array([read(one.pose) for one in self.clouds]).reshape(-1, 4, 4)
            readings[kind] = self.seat @ motions_of(poses, pairs) @ self.seat.T
        motions = {**_MOTIONS, **_LENGTHS} if self.is_planar else _MOTIONS
        return {**readings, **{kind: read(told) for kind, read in motions.items()}}

    def pairs(self) -> tuple[Floats, Floats]:
        """(n, 2) pairs that are matched, and whether each is one of `_far`; others are next to each other."""
        number, far = len(self.poses), self._far()
        near = [(i, i + k) for i in range(number) for k in (1, 2) if i + k < number]
        far, near = self._some(far, _MOST_PAIRS), self._some(near, _MOST_NEAR if far else _MOST_PAIRS)
        pairs = sorted({*far, *near})
        is_far = [one in far for one in pairs]
        return np.array(pairs, dtype=int).reshape(-1, 2), np.array(is_far, dtype=bool)

    def _some(self, pairs: list[tuple[int, int]], most: int) -> list[tuple[int, int]]:
        """Of pairs that many, half of them where it turns, where mounts show; all else shows everywhere."""
        turns = self.poses[:, :3, :3]
        turned = sorted(pairs, key=lambda pair: np.vdot(turns[pair[0]], turns[pair[1]]))
        return sorted({*turned[: most // 2], *pairs[:: max(1, math.ceil(2 * len(pairs) / most))]})

    def _far(self) -> list[tuple[int, int]]:
        """Of each cloud the next whose motion is much larger than what poses err, and a far one.

        That is in few other pairs. The very next may be farther: then it is all that there is.
        """
        found, used = [], [0] * len(self.poses)
        for i in range(len(self.poses)):
            way = turn = 0.0
            ones: list[int] = []
            for k in range(i + 1, len(self.poses)):
                step = vector_of(np.linalg.inv(self.poses[k - 1]) @ self.poses[k])
                way, turn = way + float(np.linalg.norm(step[:3])), turn + float(np.linalg.norm(step[3:]))
                if turn > _MOST_TURN or way > (_FAR if ones else _FARTHEST):
                    break
                if has_moved(self.poses[i], self.poses[k], _LEAST_MOTION):
                    ones.append(k)
            if ones:
                far = min(reversed(ones[len(ones) // 2 :]), key=lambda k: used[k])
                used[far] += 1
                found += [(i, k) for k in sorted({ones[0], far})]
        return found

    def are_moved(self) -> bool:
        """Whether points hide others as seen from their frame's origin, but not from where poses are."""
        some = self.clouds[:: max(1, len(self.clouds) // _MOST_NEAR)] if not self.is_planar else []
        return sum(one.hidden_less() for one in some) > _HIDDEN * len(some)

    def agreement(self, pairs: Floats, motions: Floats) -> float:
        """How much of the clouds lies on each other, with these motions of the robot."""
        return sum(
            self.clouds[i].agreement(self.clouds[k], motion)
            for (i, k), motion in zip(pairs, self._of_sensor(motions))
        )

    def matched(self, pairs: Floats, starts: list[Floats]) -> tuple[Floats, Floats, Floats]:
        """Which pairs fit each other well somewhere, (n, 4, 4) how, and (n, 6, 6) the covariance.

        `starts`: Motions of pairs, at which matching starts; the best match counts.
        """
        found, seen, covariances = [], [], []
        turn = np.kron(np.eye(2), self.seat[:3, :3])
        starts = [self._of_sensor(motions) for motions in starts]
        for i, (one, two) in enumerate(pairs):
            fits, best, covariance = FITS, None, np.eye(6)
            for number, motions in enumerate(starts):
                if any(np.abs(motions[i] - before[i]).max() < _SAME for before in starts[:number]):
                    continue
                match, sure = self.clouds[one].matched(self.clouds[two], motions[i])
                fit = self.clouds[one].agreement(self.clouds[two], match)
                if fit > fits + (_AS_WELL if best is not None else 0.0):
                    fits, best, covariance = fit, match, sure
            if best is not None:
                found.append(i)
                seen.append(self.seat @ best @ self.seat.T)
                covariances.append(turn @ covariance @ turn.T)
        return (
            np.array(found, dtype=int),
            np.array(seen).reshape(-1, 4, 4),
            np.array(covariances).reshape(-1, 6, 6),
        )

    def _of_sensor(self, motions: Floats) -> Floats:
        result: Floats = self.seat.T @ motions @ self.seat
        return result

    def slopes(self, pairs: Floats, told: Floats) -> Floats:
        """(n, 6, 8) how errors of motions (n, 4, 4) grow with each thing that may be wrong.

        What is proportional to the way or the turn goes by those of other poses (an instrumental variable):
        along a corridor only the way across is seen, whose told part is noise, and that is in the error, too,
        the other way; on a level floor, so is the tilt.
        """
        place, rotation = told[:, :3, 3], told[:, :3, :3]
        others = motions_of(self.by_others, pairs)
        way = others[:, :3, 3]
        turn = np.array([turn_of(one) for one in rotation]).reshape(-1, 3)
        slopes = np.zeros((len(told), 6, 8))
        far = np.where(np.linalg.norm(place, axis=1) > _LEAST_MOTION[0], 1.0, 0.0)[:, None]
        slopes[:, :2, 0] = far * np.column_stack((way[:, 1], -way[:, 0]))
        slopes[:, :3, 1] = far * way
        still = others[:, :3, :3] - np.eye(3)
        slopes[:, :3, 2:4] = still[:, :, :2]
        one, two = (self.velocities[pairs[:, k]] for k in (0, 1))
        slopes[:, :3, 4] = np.einsum("nij,nj->ni", rotation, two[:, :3]) - one[:, :3]
        slopes[:, :3, 4] -= np.cross(one[:, 3:], place)
        slopes[:, 3:, 4] = np.einsum("nij,nj->ni", rotation, two[:, 3:]) - one[:, 3:]
        turns = np.linalg.norm(turn, axis=1) > _LEAST_MOTION[1]  # Others are noise.
        slopes[:, 3:, 5] = np.where(turns[:, None], turn, 0.0)
        slopes[:, :3, 6:8] = np.cross(place[:, None], np.eye(3)[:2]).transpose(0, 2, 1)
        slopes[:, 3:, 6:8] = still[:, :, :2]
        return slopes[:, self.freedoms]

    def errors(self, seen: Floats, told: Floats) -> Floats:
        """(n, d) what is seen minus what is told."""
        return errors_of(seen, told)[:, self.freedoms]

    def whitening(self, covariances: Floats, told: Floats) -> Floats:
        """(n, d, d) that make errors standard normal, by those of matches (n, 6, 6) and what poses err."""
        own = (covariances + pose_noise(told))[:, self.freedoms][:, :, self.freedoms]
        result: Floats = np.linalg.inv(np.linalg.cholesky(own))
        return result


def _joined(runs: Sequence[Sequence[Cloud]]) -> list[list[Cloud]]:
    """Runs that follow each other as their clouds do become one."""
    joined: list[list[Cloud]] = []
    step = np.median([b.stamp - a.stamp for run in runs for a, b in zip(run, run[1:])] or [0.0])
    for run in runs:
        if joined and joined[-1] and run and 0.0 < run[0].stamp - joined[-1][-1].stamp < _FOLLOWS * step:
            joined[-1] += run
        else:
            joined.append(list(run))
    return joined


def _numbered(runs: Sequence[Sequence[Cloud]]) -> list[list[Cloud]]:
    """Runs of clouds without times as if ten came a second, with gaps between the runs."""
    first = np.cumsum([0, *(len(run) + 1 for run in runs)])
    return [[one.at(0.1 * float(i + k)) for k, one in enumerate(run)] for i, run in zip(first, runs)]


def _fresh(clouds: list[Cloud]) -> list[Cloud]:
    """Clouds between which the robot moves, so that each is in few pairs."""
    found = clouds[:1]
    for one in clouds:
        if has_moved(found[-1].pose, one.pose, _FRESH):
            found.append(one)
    return found


def _heading(rotation: Floats, first: Floats) -> float:
    """By how a sensor is turned from a first rotation, whatever looks up in that."""
    since = rotation @ first.T
    turn = math.atan2(since[1, 0] - since[0, 1], since[0, 0] + since[1, 1])
    return yaw_of(first) + turn
