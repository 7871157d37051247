# SPDX-License-Identifier: BSD-3-Clause
"""Whether a laser or lidar is mounted, timed and scaled as its log says.

Strategy: scans near each other on the way are matched. If one thing is wrong all along, what the match
says of the sensor's motion differs from what the poses say in a way that depends on the motion. With the told
motion (t, phi) and the sensor's own velocities at both ends, the error is

- (((1 + k) Rot(-a) - I) t, 0) of a mount turned by a, with distances 1 + k times as large;
- ((Rot(phi) - I) m, 0) of a mount moved by m; with it, a small turn is (-a J t, 0), J v = (-v_y, v_x);
- what the told motion changes by in s seconds, of poses taken s seconds too early, to first order;
- (0, k phi) of turns 1 + k times as large.

Of clouds of a lidar, slices are matched, and the ground that two of them share is compared: it is tilted and
steps if the sensor is tilted on its robot.

Each is fitted by itself; errors are Student's t, with the covariances of the matches and what poses err
anyway. Noise of the poses must not look like an error: motions are far larger, velocities are those of other
scans, and few pairs share a scan. The likeliest one counts if it explains the errors far better than none, no
part of the log worse, by more than matches err alike, and if it puts surfaces apart that are seen twice.
Where nothing is seen twice, nothing is told: a robot that only drives straight on shows neither a moved mount
nor a mirrored laser, and one that always drives alike no wrong clock.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ndtree._errors import Text, key
from ndtree.alignment.planar import Floats, between, composed, wrapped
from ndtree.alignment.sensor_scans import SensorScan
from ndtree.evaluation.pose_tilt import Columns, plane_between
from ndtree.logs.poses.pose import about_axes, matrices_of, quaternions_of
from ndtree.tuning.pairs import LEAST_MOTION, Pair, Pairs, far_of, matched, sliced
from ndtree.tuning.slices import Cloud

#: How much likelier errors must be (in logarithms): pairs share scans. And at least, in each part of a log.
GAIN, NOWHERE_LESS, PARTS = 30.0, -2.0, 4
#: How much of the errors it must explain in a quarter of the pairs [m], an angle at _AWAY: matches err alike
#: by up to half of their cells.
SHOWN = 0.025
#: How far apart two views of a surface then lie [m], the diagonal of a usual smallest cell: at _AWAY from
#: scans that are _NEARER than that to each other [m], in all but a few pairs of them at most.
APART, _AWAY, _NEARER, _MOST = 0.07, 5.0, 3.0, 0.98
_LEAST_PAIRS = 12
_POSES = np.array([0.02, 0.02, 0.008])  # What poses err, each by itself [m, m, rad].
_FREEDOM = 2.0  # Of Student's t: some matches are wrong.
_MEDIAN = 2.37  # Of the squared length of three standard normal numbers.
_ROUNDS = 30
_SECONDS = 1e-3  # For a difference quotient.
_TURNED = 0.05  # A turn that tells a mirrored scan from one that is not [rad].
_ANGLE = math.radians(1.5)  # Of a mount that is turned; else only the scale is wrong.
_LEAST_SCALE = 0.3  # Nearer to 0, nothing was seen to move.
_ALIKE = 0.045  # Of the way: matches in corridors with recesses err alike by up to 0.038 of it.
#: What may be wrong, and its columns of `_slopes`.
_KINDS = {"way": [0, 1], "place": [2, 3], "clock": [4], "turns": [5], "mount": [0, 2, 3]}
_TILTS = np.array([0.0123, 0.0123, 0.03])  # What poses of a pair tilt and rise anyway [rad, rad, m].
#: Axes of a camera, z forward and x to the right, of one whose x is forward and z up.
_CAMERA = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
#: How far a sensor may look aside or back of where it is told to look, beyond what matches search [rad].
_ASIDE = {"left": math.pi / 2, "back": math.pi, "right": -math.pi / 2}


def _aside(one: Cloud, angle: float) -> Cloud:
    c, s = math.cos(angle), math.sin(angle)
    return replace(one, rotation=one.rotation @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]))


#: Other ways to read the poses of a log in space.
_READINGS: dict[str, Callable[[Cloud], Cloud]] = {
    "inverted": lambda one: replace(one, rotation=one.rotation.T, position=-one.rotation.T @ one.position),
    "wxyz": lambda one: replace(
        one, rotation=matrices_of(quaternions_of(one.rotation[None])[:, [1, 2, 3, 0]])[0]
    ),
    "axes": lambda one: replace(
        one, rotation=_CAMERA.T @ one.rotation @ _CAMERA, position=_CAMERA.T @ one.position
    ),
    "upside": lambda one: replace(one, rotation=one.rotation @ np.diag([1.0, -1.0, -1.0])),
    **{kind: partial(_aside, angle=angle) for kind, angle in _ASIDE.items()},
}  # fmt: skip
_BOTH = 10.0  # How much likelier a mount that is turned and moved must be than any one thing.


_MISREAD = {
    "inverted": (
        "poses were inverted",
        "expected the pose of the robot in the map, not that of the map as the robot sees it",
    ),
    "axes": ("poses were those of a camera, whose z axis looks ahead", "expected those of a body with z up"),
    "wxyz": ("quaternions were written as w, x, y, z", "expected x, y, z, w"),
}


@dataclass(frozen=True)
class SetupError:
    """What is wrong all along a log, from `setup_error`.

    `kind`: "yaw", "place" or both of the "mount", its "tilt", "clock", "scale" of distances between poses,
        "turns", "mirrored", the other side "upside", or poses in space that are "inverted", in the "axes" of
        a camera, or have quaternions in the order "wxyz".
    `values`: To be added: [rad], along the sensor's x axis and to the left of that, seen from above [m], roll
        and pitch [rad], [s], or a fraction; none of the last five.
    `apart`: How far apart two views of a surface 5 m away would lie at most [m]; None of the last five, and
        of a sensor in space that looks aside or back.
    """

    kind: str
    values: tuple[float, ...]
    apart: float | None

    def __str__(self) -> str:
        """What was found and what helps, in one line."""
        found, helps = self._words()
        if self.apart is not None:
            found += f" (walls 5 m away would be up to {min(self.apart, 10.0):.2g} m double)"
        return Text(f"poses do not fit the scans. It is as if {found}: {helps}")

    def _words(self) -> tuple[str, str]:
        if self.kind in _MISREAD:
            return _MISREAD[self.kind]
        if self.kind == "upside":
            return "the sensor were mounted the other way up", (
                f"add 180deg to its roll if it hangs upside down (of a bag: in /tf, or {key('mount')})"
            )
        if self.kind == "mirrored":
            return "the sensor saw turns the other way round", (
                f"it may hang upside down (of a bag: {key('mount')} with a roll of 180deg), its beams come "
                "in the other order, or angles of poses have the other sign"
            )
        value = self.values[0]
        more = "more" if value > 0 else "less"
        mount = f"check the sensor's place on the robot (of a bag: /tf, {key('mount')})"
        if self.kind == "yaw":
            side = "left" if value > 0 else "right"
            return f"the sensor looked {math.degrees(abs(value)):.0f} degrees further to the {side}", mount
        if self.kind == "mount":
            angle, x, y = self.values
            words = f"the sensor looked {math.degrees(angle):.0f} degrees further to the left and sat"
            return f"{words} {_moved(x, y)}", mount
        if self.kind == "tilt":
            roll, pitch = map(math.degrees, self.values)
            return "the sensor were tilted on the robot", (
                f"add {roll:.1f}deg to its roll and {pitch:.1f}deg to its pitch (of a bag: in /tf, or "
                f"{key('mount')})"
            )
        if self.kind == "place":
            return f"the sensor sat {_moved(*self.values)}", mount
        if self.kind == "clock":
            helps = f"check clocks and the order of beams (of a bag: add {value:.2f} to {key('time_offset')})"
            when = "after" if value > 0 else "before"
            return f"scans were measured {abs(value):.2f} s {when} their time", helps
        if self.kind == "scale":
            helps = "check the units of ranges, and the calibration of the odometry"
            return f"the way was {100 * abs(value):.0f} % {more} than the poses say", helps
        helps = f"use {key('align')} or the poses of a SLAM system"
        return f"turns were {100 * abs(value):.0f} % {more} than the poses say", helps


def _moved(x: float, y: float) -> str:
    return f"{x:.2f}, {y:.2f} m from its place (along its x axis and to the left of that, seen from above)"


def setup_error(log: Pairs) -> SetupError | None:
    """Find what is wrong with mount, clock or scale of a log all along.

    Returns: None where nothing is, too little tells, or scans have no headings.
    """
    if not all(scan.has_heading for run in log.runs for scan in run):
        return None
    misread = _misread(log)
    if misread in _ASIDE:
        return SetupError("yaw", (_ASIDE[misread],), None)
    if misread is not None:
        return SetupError(misread, (), None)
    far = [pair for pair in log.far if pair.is_matched]
    own = {run: _velocity(log.runs[run]) for pair in far for run in (pair.run, pair.other)}
    has_times = all(np.isfinite(one).all() for one in own.values())
    raw = _slopes(
        np.array([pair.told for pair in far]).reshape(-1, 3),
        np.nan_to_num([(own[pair.run], own[pair.other]) for pair in far]).reshape(-1, 2, 3),
    )
    covariances = np.array([pair.covariance for pair in far]).reshape(-1, 3, 3) + 2 * np.diag(_POSES**2)
    whitening = np.linalg.inv(np.linalg.cholesky(covariances))
    errors = np.array([pair.error for pair in far]).reshape(-1, 3)
    # Without times, a late clock would be taken for a mount that is moved.
    kinds = {kind: at for kind, at in _KINDS.items() if has_times or kind in ("way", "turns")}
    found = _likeliest(errors, raw, whitening, kinds)
    tilt, gain = _tilt(log)
    if tilt is not None and (found is None or gain > found[2]):
        return tilt
    if found is None:
        return None
    kind, values, _ = found
    apart = _apart(log, {pair.run: own[pair.run] for pair in far}, kind, values)
    if np.quantile(_size(raw[:, :, _KINDS[kind]] @ values), 0.75) < SHOWN or apart < APART:
        return None
    if kind == "turns" and 1.0 + values[0] < _LEAST_SCALE:
        return None
    if kind != "way":
        return SetupError(kind, tuple(map(float, values)), apart)
    angle, scale = math.atan2(values[0], 1.0 + values[1]), math.hypot(values[0], 1.0 + values[1])
    if scale < _LEAST_SCALE:
        return None
    if abs(angle) > max(_ANGLE, abs(scale - 1.0)):
        return SetupError("yaw", (angle,), apart)
    return SetupError("scale", (scale - 1.0,), apart) if abs(scale - 1.0) > _ALIKE else None


def _likeliest(
    errors: Floats, raw: Floats, whitening: Floats, kinds: dict[str, list[int]]
) -> tuple[str, Floats, float] | None:
    """What explains errors (n, 3) best, its values, and how much likelier they are with it; None if nothing.

    `raw` (n, 3, k): How errors grow with each thing.
    `kinds`: Their columns.
    """
    if len(errors) < _LEAST_PAIRS:
        return None
    errors = np.einsum("nij,nj->ni", whitening, errors)
    slopes = np.einsum("nij,njk->nik", whitening, raw)
    fits = {kind: _fitted(errors, slopes[:, :, kinds[kind]]) for kind in kinds}
    kind = max(fits, key=lambda one: fits[one][1] - (_BOTH if one == "mount" else 0.0))
    values, likelihood = fits[kind]
    gain = likelihood - _likelihood(errors)
    left = errors - slopes[:, :, kinds[kind]] @ values
    parts = np.array_split(np.arange(len(errors)), PARTS)
    if gain < GAIN or any(
        _likelihood(left[part]) - _likelihood(errors[part]) < NOWHERE_LESS for part in parts
    ):
        return None
    return kind, values, gain


def _tilt(log: Pairs) -> tuple[SetupError | None, float]:
    """A sensor in space that is tilted on its robot, by ground that scans share; and how much likelier it is.

    A cloud whose ground rises by d along the robot's axes has it at R(yaw) d in the map: between two it is
    tilted by the difference of that, and at the place of the second rises by -R(yaw) d t.
    """
    far = log.far if log.clouds else []
    seen = {run: log.clouds[run][1] for pair in far for run in (pair.run, pair.other)}
    level = {run: about_axes(0.0, 0.0, log.runs[run][1].pose[2])[2] for run in seen}
    # How the sensor is told to sit, on the whole, as seen from where it looks.
    u, _, v = np.linalg.svd(sum((level[run].T @ one.rotation for run, one in seen.items()), np.zeros((3, 3))))
    told, roll, pitch, gain = u @ v, 0.0, 0.0, 0.0
    for _ in range(_ROUNDS):  # The ground of a large tilt is seen in part, and tells too little of it.
        turn = told.T @ _leaning(roll, pitch) @ told
        turned = {run: replace(one, rotation=one.rotation @ turn) for run, one in seen.items()}
        errors, raw = _unlike_grounds(log, far, {run: one.ground() for run, one in turned.items()})
        whitening = np.tile(np.diag(1 / _TILTS), (len(errors), 1, 1))
        found = _likeliest(errors, raw, whitening, {"tilt": [0, 1]})
        if found is None:
            break
        along, across = found[1]
        up = (_leaning(-across, along) @ _leaning(roll, pitch))[2]
        roll, pitch = math.atan2(up[1], up[2]), -math.asin(up[0])
        gain, slopes = gain or found[2], raw
    if not gain:
        return None, 0.0
    moved = slopes @ [pitch, -roll]
    sizes = _AWAY * np.hypot(moved[:, 0], moved[:, 1]) + np.abs(moved[:, 2])
    apart = float(np.quantile(sizes, _MOST))
    if np.quantile(sizes, 0.75) < SHOWN or apart < APART:
        return None, 0.0
    return SetupError("tilt", (roll, pitch), apart), gain


def _leaning(roll: float, pitch: float) -> Floats:
    about_x, about_y, _ = about_axes(roll, pitch, 0.0)
    leaning: Floats = about_y @ about_x
    return leaning


def _unlike_grounds(log: Pairs, far: list[Pair], grounds: dict[int, Columns]) -> tuple[Floats, Floats]:
    """Of pairs, (n, 3) how the second ground tilts and rises, and (n, 3, 2) how that grows with a tilt."""
    errors, raw = [], []
    for pair in far:
        first, second = (log.runs[run][1].pose for run in (pair.run, pair.other))
        plane = plane_between(grounds[pair.run], grounds[pair.other], second[:2])
        if plane is None:
            continue
        before, after = (about_axes(0.0, 0.0, pose[2])[2][:2, :2] for pose in (first, second))
        errors.append(plane)
        raw.append(np.vstack((after - before, -(second[:2] - first[:2]) @ before)))
    return np.array(errors).reshape(-1, 3), np.array(raw).reshape(-1, 3, 2)


def _velocity(run: list[SensorScan]) -> Floats:
    """Of the sensor at the second scan of a run, in its own frame [m/s, m/s, rad/s]; nan where nothing tells.

    By the scans before and behind: noise of the second one's pose is not in it.
    """
    if not run[0].stamp < run[1].stamp < run[2].stamp:
        return np.full(3, np.nan)
    move = between(run[0].pose, run[2].pose)
    c, s = np.cos(0.5 * move[2]), np.sin(0.5 * move[2])  # Into the frame of the scan in between.
    velocity: Floats = np.array([c * move[0] + s * move[1], c * move[1] - s * move[0], move[2]])
    return velocity / (run[2].stamp - run[0].stamp)


def _slopes(told: Floats, velocities: Floats) -> Floats:
    """(n, 3, 6) how errors of motions (n, 3) grow with each thing that may be wrong; velocities (n, 2, 3)."""
    x, y, turn = told.T
    slopes = np.zeros((len(told), 3, 6))
    far = np.where(np.hypot(x, y) > LEAST_MOTION[0], 1.0, 0.0)[:, None]
    slopes[:, :2, 0] = far * np.column_stack((y, -x))
    slopes[:, :2, 1] = far * told[:, :2]
    c, s = np.cos(turn), np.sin(turn)
    slopes[:, :2, 2:4] = np.stack((np.stack((c - 1, -s), -1), np.stack((s, c - 1), -1)), axis=1)
    later = composed(between(_SECONDS * velocities[:, 0], told), _SECONDS * velocities[:, 1])
    slopes[:, :, 4] = np.column_stack((later[:, :2] - told[:, :2], wrapped(later[:, 2] - turn))) / _SECONDS
    slopes[:, 2, 5] = np.where(np.abs(turn) > LEAST_MOTION[1], turn, 0.0)  # Others are noise.
    return slopes


def _size(errors: Floats) -> Floats:
    """(n,) how far errors (n, 3) move a surface [m]."""
    size: Floats = np.hypot(errors[:, 0], errors[:, 1]) + _AWAY * np.abs(errors[:, 2])
    return size


def _fitted(errors: Floats, slopes: Floats) -> tuple[Floats, float]:
    """The likeliest values, and how likely the errors are with them.

    By weighting again and again: from no error on, and from all pairs alike on, since the few in which an
    error shows look like wrong matches at first. Values are of about 1 before anything is known.
    """
    found = []
    for weights in (_weights((errors**2).sum(axis=1)), np.ones(len(errors))):
        for _ in range(_ROUNDS):
            normal = np.einsum("n,nik,nil->kl", weights, slopes, slopes) + np.eye(slopes.shape[2])
            values = np.linalg.solve(normal, np.einsum("n,nik,ni->k", weights, slopes, errors))
            left = errors - slopes @ values
            weights = _weights((left**2).sum(axis=1))
        found.append((_likelihood(left), values))
    likelihood, values = max(found, key=lambda one: one[0])
    return values, likelihood


def _weights(squared: Floats) -> Floats:
    weights: Floats = (_FREEDOM + 3) / (_FREEDOM + squared / _spread(squared))
    return weights


def _spread(squared: Floats) -> float:
    """How much larger squared errors are than covariances say; at least as large."""
    return max(1.0, float(np.median(squared)) / _MEDIAN)


def _likelihood(errors: Floats) -> float:
    """The logarithm, without constants."""
    squared = (errors**2).sum(axis=1)
    spread = _spread(squared)
    terms = np.log1p(squared / spread / _FREEDOM).sum()
    return -0.5 * (_FREEDOM + 3) * float(terms) - 1.5 * len(errors) * math.log(spread)


def _apart(log: Pairs, own: dict[int, Floats], kind: str, values: Floats) -> float:
    """See `SetupError.apart`: of scans beside each other that see the same, on one visit or several.

    `own`: Velocities of runs.
    """
    poses = np.array([log.runs[run][1].pose for run in own])
    first, second = np.triu_indices(len(poses), 1)
    beside = np.hypot(*(poses[first, :2] - poses[second, :2]).T) < _NEARER
    first, second = first[beside], second[beside]
    if not len(first):
        return 0.0
    velocities = np.nan_to_num(np.array(list(own.values())))
    slopes = _slopes(
        between(poses[first], poses[second]), np.stack((velocities[first], velocities[second]), axis=1)
    )
    return float(np.quantile(_size(slopes[:, :, _KINDS[kind]] @ values), _MOST))


def _misread(log: Pairs) -> str | None:
    """How scans or poses have to be read so that both move alike, far more often than as they are told.

    Turns are seen the other way round if they fit scans that are seen in a mirror.
    """
    turned = _turned(log)
    turning = sum(map(_turns_alike, turned))
    is_mirrored, mirrored = False, log
    if len(turned) >= _LEAST_PAIRS and 2 * turning <= len(turned):
        flip = np.array([1.0, -1.0])
        runs = [
            [replace(one, points=one.points * flip, free=one.free * flip) for one in run] for run in log.runs
        ]
        mirrored = far_of(runs, log.clouds) if log.clouds else matched(runs, log.begin)
        is_mirrored = sum(map(_turns_alike, _turned(mirrored))) >= 2 * turning + _LEAST_PAIRS
    fitting = sum(map(_moves_alike, log.far))
    fitted = sum(pair.is_matched for pair in log.far)
    speaks_against = (
        2 * fitting <= len(log.far) or 4 * (fitted - fitting) > fitted or 4 * _lost(log.runs) > len(log.runs)
    )
    if not (log.clouds and (speaks_against or is_mirrored)):
        return "mirrored" if is_mirrored else None
    others = {"mirrored": sum(map(_moves_alike, mirrored.far))} if is_mirrored else {"": 0}
    for kind, read in _READINGS.items():
        if kind == "upside" and is_mirrored:
            continue  # Between floor and ceiling both look alike, and the words for a mirror name both.
        clouds = [[read(one) for one in run] for run in log.clouds]
        slices = sliced(clouds)
        if 2 * _lost(slices) <= len(slices):
            others[kind] = sum(map(_moves_alike, far_of(slices, clouds).far))
    best = max(others, key=lambda kind: others[kind])
    return best if is_mirrored or others[best] >= fitting + _LEAST_PAIRS else None


def _lost(runs: list[list[SensorScan]]) -> int:
    """How many slices are empty, as no ground is seen."""
    return sum(len(run) > 1 and not len(run[1].points) for run in runs)


def _turned(log: Pairs) -> list[Pair]:
    return [pair for pair in (*log.near, *log.far) if pair.is_near and abs(pair.told[2]) > _TURNED]


def _turns_alike(pair: Pair) -> bool:
    """Whether the sensor turned as the poses did, about."""
    return pair.is_matched and abs(pair.error[2]) < 0.5 * abs(pair.told[2])


def _moves_alike(pair: Pair) -> bool:
    """Whether the sensor moved as the poses did, about."""
    turns = abs(pair.told[2]) <= _TURNED or _turns_alike(pair)
    return turns and pair.is_matched and np.hypot(*pair.error[:2]) < 0.5 * np.hypot(*pair.told[:2])
