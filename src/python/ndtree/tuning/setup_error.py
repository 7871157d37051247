# SPDX-License-Identifier: BSD-3-Clause
"""Whether a planar laser is mounted, timed and scaled as its log says.

Strategy: scans near each other on the way are matched. If one thing is wrong all along, what the match
says of the sensor's motion differs from what the poses say in a way that depends on the motion. With the told
motion (t, phi) and the sensor's own velocities at both ends, the error is

- (((1 + k) Rot(-a) - I) t, 0) of a mount turned by a, with distances 1 + k times as large;
- ((Rot(phi) - I) m, 0) of a mount moved by m; with it, a small turn is (-a J t, 0), J v = (-v_y, v_x);
- what the told motion changes by in s seconds, of poses taken s seconds too early, to first order;
- (0, k phi) of turns 1 + k times as large.

Each is fitted by itself; errors are Student's t, with the covariances of the matches and what poses err
anyway. Noise of the poses must not look like an error: motions are far larger, velocities are those of other
scans, and few pairs share a scan. The likeliest one counts if it explains the errors far better than none,
hardly worse in any part of the log, by more than matches err alike, and if it puts surfaces apart that are
seen twice.
Where nothing is seen twice, nothing is told: a robot that only drives straight on shows neither a moved mount
nor a mirrored laser, and one that always drives alike no wrong clock.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ndtree._errors import Text, key
from ndtree.alignment.planar import Floats, between, composed, wrapped
from ndtree.alignment.sensor_scans import SensorScan
from ndtree.tuning.pairs import LEAST_MOTION, Pair, Pairs, matched

#: How much likelier errors must be (in logarithms): pairs share scans. And which share of that they may be
#: less likely in a part of the log.
GAIN, NOWHERE_LESS, PARTS = 30.0, 0.1, 4
#: How much of the errors it must explain in a quarter of the pairs [m], an angle at AWAY: matches err alike
#: by up to half of their cells.
SHOWN = 0.025
#: How far apart two views of a surface then lie [m], the diagonal of a usual smallest cell: at AWAY from
#: scans that are NEARER than that to each other [m], in all but a few pairs of them at most.
APART, AWAY, NEARER, _MOST = 0.07, 5.0, 3.0, 0.98
LEAST_PAIRS = 12
POSES = np.array([0.02, 0.02, 0.008])  # What poses err, each by itself [m, m, rad].
_FREEDOM = 2.0  # Of Student's t: some matches are wrong.
_MEDIAN = {3: 2.37, 6: 5.35}  # Of the squared length of 3 or 6 standard normal numbers.
_ROUNDS = 30
_SECONDS = 1e-3  # For a difference quotient.
_TURNED = 0.05  # A turn that tells a mirrored scan from one that is not [rad].
_ANGLE = math.radians(1.5)  # Of a mount that is turned; else only the scale is wrong.
_LEAST_SCALE = 0.2  # Nearer to 0, nothing was seen to move.
_ALIKE = 0.045  # Of the way: matches in corridors with recesses err alike by up to 0.038 of it.
#: What may be wrong, and its columns of `_slopes`.
KINDS = {"way": [0, 1], "place": [2, 3], "clock": [4], "turns": [5], "mount": [0, 2, 3]}
BOTH = 10.0  # How much likelier a mount that is turned and moved must be than any one thing.


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
        "turns", "mirrored", or poses in space that are "inverted", in the "axes" of a camera, or have
        quaternions in the order "wxyz".
    `values`: To be added: [rad], along the sensor's x axis and to the left of that, seen from above [m], roll
        and pitch [rad], [s], or a fraction; none of the last four.
    `apart`: How far apart two views of a surface 5 m away would lie at most [m]; None of the last four.
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
                f"turn its mount by {roll:.1f}deg about the robot's x axis, then by {pitch:.1f}deg about its "
                f"y axis: roll and pitch of a level one (of a bag: in /tf, or {key('mount')})"
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
    if _is_mirrored(log):
        return SetupError("mirrored", (), None)
    far = [pair for pair in log.far if pair.is_matched]
    if len(far) < LEAST_PAIRS:
        return None
    own = {run: _velocity(log.runs[run]) for pair in far for run in (pair.run, pair.other)}
    has_times = all(np.isfinite(one).all() for one in own.values())
    raw = _slopes(
        np.array([pair.told for pair in far]).reshape(-1, 3),
        np.nan_to_num([(own[pair.run], own[pair.other]) for pair in far]).reshape(-1, 2, 3),
    )
    covariances = np.array([pair.covariance for pair in far]).reshape(-1, 3, 3) + 2 * np.diag(POSES**2)
    whitening = np.linalg.inv(np.linalg.cholesky(covariances))
    errors = np.array([pair.error for pair in far]).reshape(-1, 3)
    # Without times, a late clock would be taken for a mount that is moved.
    kinds = {kind: at for kind, at in KINDS.items() if has_times or kind in ("way", "turns")}
    fits = fits_of(errors, raw, whitening, kinds)
    kind = likeliest(np.einsum("nij,nj->ni", whitening, errors), fits)
    if kind is None:
        return None
    values = fits[kind][0]
    beside = _beside(log, {pair.run: own[pair.run] for pair in far})
    return said_of(kind, values, raw[:, :, KINDS[kind]] @ values, beside[:, :, KINDS[kind]] @ values, _ALIKE)


def said_of(
    kind: str, values: Floats, moved: Floats, beside: Floats, least_scale: float = 0.0
) -> SetupError | None:
    """What is said of the likeliest thing, by how far it moves pairs and what is beside each other.

    Both (n, d), see `fits_of`. `least_scale`: By how much scales differ, or they are alike.
    """
    if not len(beside):
        return None
    apart = float(np.quantile(_size(beside), _MOST))
    if np.quantile(_size(moved), 0.75) < SHOWN or apart < APART:
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
    return SetupError("scale", (scale - 1.0,), apart) if abs(scale - 1.0) > least_scale else None


Fits = dict[str, tuple[Floats, Floats]]  # Of kinds: their values, and what is left of whitened errors.


def fits_of(errors: Floats, raw: Floats, whitening: Floats, kinds: dict[str, list[int]]) -> Fits:
    """What each kind explains best of errors (n, d): a place [m], and an angle or turn in space [rad].

    `raw` (n, d, k): How errors grow with each thing.
    `kinds`: Their columns.
    """
    errors = np.einsum("nij,nj->ni", whitening, errors)
    slopes = np.einsum("nij,njk->nik", whitening, raw)
    values = {kind: _fitted(errors, slopes[:, :, at]) for kind, at in kinds.items()}
    return {kind: (values[kind], errors - slopes[:, :, at] @ values[kind]) for kind, at in kinds.items()}


def likeliest(errors: Floats, fits: Fits) -> str | None:
    """Which explains whitened errors best; None if none does."""
    several = ("mount", "way") if "yaw" in fits else ("mount",)
    kind = max(fits, key=lambda one: likelihood(fits[one][1]) - (BOTH if one in several else 0.0))
    return kind if is_gain(errors, fits[kind][1]) else None


def is_gain(errors: Floats, left: Floats) -> bool:
    """Whether what is left of errors is far likelier, and hardly less likely in any part of the log."""
    parts = np.array_split(np.arange(len(errors)), PARTS)
    gains = [likelihood(left[part]) - likelihood(errors[part]) for part in parts]
    gain = likelihood(left) - likelihood(errors)
    return gain >= GAIN and min(gains) >= -NOWHERE_LESS * gain


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
    """(n,) how far errors (n, d) move a surface [m]."""
    places = 2 if errors.shape[1] == 3 else 3
    size: Floats = np.linalg.norm(errors[:, :places], axis=1)
    return size + AWAY * np.linalg.norm(errors[:, places:], axis=1)


def _fitted(errors: Floats, slopes: Floats) -> Floats:
    """The likeliest values.

    By weighting again and again: from no error on, and from all pairs alike on, since the few in which an
    error shows look like wrong matches at first. Values are of about 1 before anything is known.
    """
    found = []
    for weights in (_weights((errors**2).sum(axis=1), errors.shape[1]), np.ones(len(errors))):
        for _ in range(_ROUNDS):
            normal = np.einsum("n,nik,nil->kl", weights, slopes, slopes) + np.eye(slopes.shape[2])
            values = np.linalg.solve(normal, np.einsum("n,nik,ni->k", weights, slopes, errors))
            left = errors - slopes @ values
            weights = _weights((left**2).sum(axis=1), errors.shape[1])
        found.append((values, likelihood(left)))
    return max(found, key=lambda one: one[1])[0]


def _weights(squared: Floats, freedoms: int) -> Floats:
    weights: Floats = (_FREEDOM + freedoms) / (_FREEDOM + squared / _spread(squared, freedoms))
    return weights


def _spread(squared: Floats, freedoms: int) -> float:
    """How much larger squared errors are than covariances say; at least as large."""
    return max(1.0, float(np.median(squared)) / _MEDIAN[freedoms])


def likelihood(errors: Floats) -> float:
    """The logarithm for whitened errors (n, d), without constants."""
    freedoms = errors.shape[1]
    squared = (errors**2).sum(axis=1)
    spread = _spread(squared, freedoms)
    terms = np.log1p(squared / spread / _FREEDOM).sum()
    return -0.5 * (_FREEDOM + freedoms) * float(terms) - 0.5 * freedoms * len(errors) * math.log(spread)


def _beside(log: Pairs, own: dict[int, Floats]) -> Floats:
    """`_slopes` of scans beside each other that see the same, on one visit or several.

    `own`: Velocities of runs.
    """
    poses = np.array([log.runs[run][1].pose for run in own])
    first, second = np.triu_indices(len(poses), 1)
    near = np.hypot(*(poses[first, :2] - poses[second, :2]).T) < NEARER
    first, second = first[near], second[near]
    velocities = np.nan_to_num(np.array(list(own.values())))
    return _slopes(
        between(poses[first], poses[second]), np.stack((velocities[first], velocities[second]), axis=1)
    )


def _is_mirrored(log: Pairs) -> bool:
    """Whether turns are seen the other way round: scans in a mirror fit far more often than as they are."""
    turned = _turned(log)
    turning = sum(map(_turns_alike, turned))
    if len(turned) < LEAST_PAIRS or 2 * turning > len(turned):
        return False
    flip = np.array([1.0, -1.0])
    runs = [[replace(one, points=one.points * flip, free=one.free * flip) for one in run] for run in log.runs]
    mirrored = matched(runs, log.begin)
    return sum(map(_turns_alike, _turned(mirrored))) >= 2 * turning + LEAST_PAIRS


def _turned(log: Pairs) -> list[Pair]:
    return [pair for pair in (*log.near, *log.far) if pair.is_near and abs(pair.told[2]) > _TURNED]


def _turns_alike(pair: Pair) -> bool:
    """Whether the sensor turned as the poses did, about."""
    return pair.is_matched and abs(pair.error[2]) < 0.5 * abs(pair.told[2])
