# SPDX-License-Identifier: BSD-3-Clause
"""What may be wrong with a robot's setup, how well each explains what was seen, and what is said of it.

Strategy: each is fitted by itself to the errors of all pairs. They are Student's t, with the covariances of
the matches and what poses err anyway. The likeliest counts if it explains the errors far better than none,
hardly worse in any part of the log, and if it puts surfaces apart that are seen twice.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ndtree._errors import Text, key
from ndtree.alignment.planar import Floats, wrapped

#: How much likelier errors must be, in logarithms: by chance one right log in 10,000 gains 11 with three
#: values, and twice as much as scans are in several pairs. And which share of that may be lost in a part of
#: the log.
GAIN, NOWHERE_LESS, PARTS = 20.0, 0.1, 4
WRONG = 8  # One match in this many may be wrong.
BOTH = 10.0  # Of two things at once, how much likelier they must be than one.
CLEAR = 3.0  # How much likelier than another one, so that a wrong cause is named in 1 of 20 cases.
#: How far apart two views of a surface then lie [m], the diagonal of a usual smallest cell: at AWAY from
#: scans that are NEARER than that to each other [m], in all but a few pairs of them at most.
APART, AWAY, NEARER, _MOST = 0.07, 5.0, 3.0, 0.98
LEAST_PAIRS = 12
FREEDOM = 2.0  # Of Student's t: some matches are wrong.
_MEDIAN = {1: 0.455, 3: 2.37, 6: 5.35}  # Of the squared length of 1, 3 or 6 standard normal numbers.
_ROUNDS = 30
_SCALES, _LEAST_SCALE = ("scale", "turns"), 0.2  # Nearer to 0, nothing was seen to move.

#: Positions in mm, cm or inches, and points: what positions are to be multiplied by to fit, and the names.
UNITS = {0.001: "mm", 0.01: "cm", 0.0254: "inches", 1000.0: "mm", 100.0: "cm", 1 / 0.0254: "inches"}
_DEGREE = math.radians(1.0)

_MISREAD = {
    "moved": (
        "points were in the frame of the map already",
        f"expected them in the sensor's frame, or of a folder {key('points_in')} map",
    ),
    "inverted": (
        "poses were inverted",
        "expected the pose of the robot in the map, not that of the map as the robot sees it",
    ),
    "signs": (
        "turns of poses had the other sign",
        "expected turns to the left to be positive, seen from above",
    ),
    "axes": ("poses were those of a camera, whose z axis looks ahead", "expected those of a body with z up"),
    "degrees": ("yaws of poses were in degrees", f"expected radians: multiply them by {_DEGREE:.6f}"),
    "wxyz": ("quaternions were written as w, x, y, z", "expected x, y, z, w"),
}


def unfit(sensor: str) -> str:
    """How doubts of poses begin, of one of several sensors by its name."""
    return "poses do not fit the scans" + (f" of {sensor}" if sensor else "")


@dataclass(frozen=True)
class SetupError:
    """What is wrong all along a log, from `ndtree.tuning.setup.setup_error`.

    `kind`: "yaw", "place" or both of the "mount", its "tilt", "clock", "scale" of distances between poses,
        "turns", "mirrored", points that were "moved" into the map before, or poses that are "inverted", have
        the other "signs" of turns, are in the "axes" of a camera, have quaternions in the order "wxyz", yaws
        in "degrees", or another "unit".
    `values`: To be added: [rad], along the sensor's x axis and to the left of that, seen from above [m], roll
        and pitch [rad], [s], a fraction, or what positions are to be
        multiplied by for the unit of points; none of misread poses.
    `apart`: How far apart two views of a surface 5 m away would lie at most [m]; None of misread poses.
    """

    kind: str
    values: tuple[float, ...]
    apart: float | None
    sensor: str = ""  # Of several the one that tells.
    others: tuple[SetupError, ...] = ()  # What explains nearly as much.

    def __str__(self) -> str:
        """What was found and what helps, in one line."""
        words = [one._words() for one in (self, *self.others)]
        found, helps = (", or ".join(dict.fromkeys(part)) for part in zip(*words))
        if self.apart is not None:
            found += f" (walls 5 m away would be up to {min(self.apart, 10.0):.2g} m double)"
        return Text(f"{unfit(self.sensor)}. It is as if {found}: {helps}")

    def _words(self) -> tuple[str, str]:
        if self.kind in _MISREAD:
            return _MISREAD[self.kind]
        if self.kind == "mirrored":
            return "the sensor saw turns the other way round", (
                "it may hang upside down, or upright where its mount says upside down (of a bag: "
                f"{key('mount')}, a roll of 180deg or of 0), its beams come in the other order, or angles of "
                "poses have the other sign"
            )
        value = self.values[0]
        if self.kind == "unit":
            factor = f"{min(value, 1 / value):.4g}"
            if value > 1:
                return f"points were in {UNITS[value]}", f"expected metres: multiply them by {factor}"
            return f"positions of poses were in {UNITS[value]}", (
                f"expected metres: multiply them by {factor} (of t x y z qx qy qz qw: "
                f"awk '{{for (i = 2; i < 5; i++) $i *= {factor}}} 1' POSES > METRES)"
            )
        more = "more" if value > 0 else "less"
        mount = f"check the sensor's place on the robot (of a bag: /tf, {key('mount')})"
        if self.kind in ("yaw", "mount"):
            side = "left" if value > 0 else "right"
            words = f"the sensor looked {math.degrees(abs(value)):.0f} degrees further to the {side}"
            return words + (f" and sat {_moved(*self.values[1:])}" if self.kind == "mount" else ""), mount
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


def said_of(kind: str, values: Floats, beside: Floats) -> SetupError | None:
    """What is said of the likeliest thing.

    `beside` (n, d): How far it moves scans beside each other that see the same, as errors of `fits_of`.
    """
    if not len(beside):
        return None
    apart = float(np.quantile(_size(beside), _MOST))
    if apart < APART:
        return None
    if kind == "yaw":
        values = np.array([math.atan2(values[0], 1.0 + values[1])])
    return SetupError(kind, tuple(map(float, values)), apart)


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


def likeliest(errors: Floats, fits: Fits) -> list[str]:
    """Which explains whitened errors best, then others that do nearly as well; none if none does.

    That nothing moved is none: other rings on the ground look the same. Values are of about 1 before
    anything is known, as in `_fitted`: along a bend, a sensor that sits a radius beside its place sees what a
    scale does.
    """
    fits = {kind: fit for kind, fit in fits.items() if kind not in _SCALES or fit[0][0] > _LEAST_SCALE - 1.0}
    likely = {
        kind: likelihood(left) - 0.5 * float(values @ values) - BOTH * (kind == "mount")
        for kind, (values, left) in fits.items()
    }
    best, *others = sorted(likely, key=lambda kind: -likely[kind])
    if not is_gain(errors, fits[best][1]):
        return []
    near = [kind for kind in others if likely[kind] >= likely[best] - CLEAR]
    return [best, *(kind for kind in near if "mount" not in (kind, best))]


def is_gain(errors: Floats, left: Floats) -> bool:
    """Whether what is left of errors is far likelier, and hardly less likely in any part of the log.

    It is likelier without the most telling pairs, too: a few matches are wrong.
    """
    each = likelihoods(left) - likelihoods(errors)
    gain = float(each.sum())
    parts = [float(part.sum()) for part in np.array_split(each, PARTS)]
    most = np.sort(each)[: len(each) - len(each) // WRONG]
    return gain >= GAIN and min(parts) >= -NOWHERE_LESS * gain and float(most.sum()) >= BOTH


def are_degrees(told: Floats, seen: Floats, others: Sequence[Floats], sigma: Floats) -> bool | None:
    """Whether turns (n,) that were told are those of degrees that were read as radians [rad]; None if unsure.

    `others`: Errors (n, 3) of turns as other readings have them.

    Whole turns of the degrees are lost, so that they tell all but multiples of 6 degrees: what fits hardly
    better than 3 degrees aside fits by chance. Turns that are less than this fit many readings.
    """
    turned = np.abs(seen) > math.pi * _DEGREE

    def likely(aside: float, which: Any = slice(None)) -> float:
        off = wrapped((seen - aside) / _DEGREE - told) * _DEGREE / sigma
        return likelihood(off[which, None])

    aside = math.pi * _DEGREE
    beside = [likelihood(np.linalg.norm(one, axis=1, keepdims=True) / sigma[:, None]) for one in others]
    if likely(0.0) < max(likely(aside), *beside) + GAIN:
        return False
    gain = likely(0.0, turned) - likely(aside, turned)
    return True if gain >= max(CLEAR, np.count_nonzero(turned)) else None


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
    for weights in (weights_of((errors**2).sum(axis=1), errors.shape[1]), np.ones(len(errors))):
        for _ in range(_ROUNDS):
            normal = np.einsum("n,nik,nil->kl", weights, slopes, slopes) + np.eye(slopes.shape[2])
            values = np.linalg.solve(normal, np.einsum("n,nik,ni->k", weights, slopes, errors))
            left = errors - slopes @ values
            weights = weights_of((left**2).sum(axis=1), errors.shape[1])
        found.append((values, likelihood(left)))
    return max(found, key=lambda one: one[1])[0]


def weights_of(squared: Floats, freedoms: int) -> Floats:
    weights: Floats = (FREEDOM + freedoms) / (FREEDOM + squared / spread_of(squared, freedoms))
    return weights


def spread_of(squared: Floats, freedoms: int, least: float = 1.0) -> float:
    """How much larger squared errors are than covariances say; by default, at least as large."""
    return max(least, float(np.median(squared)) / _MEDIAN[freedoms])


def likelihood(errors: Floats) -> float:
    """The logarithm for whitened errors (n, d), without constants."""
    return float(likelihoods(errors).sum())


def likelihoods(errors: Floats) -> Floats:
    """(n,) of each pair."""
    freedoms = errors.shape[1]
    squared = (errors**2).sum(axis=1)
    spread = spread_of(squared, freedoms)
    terms: Floats = (FREEDOM + freedoms) * np.log1p(squared / spread / FREEDOM)
    return -0.5 * (terms + freedoms * math.log(spread))
