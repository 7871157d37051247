# SPDX-License-Identifier: BSD-3-Clause
"""Whether a planar laser is mounted, timed and scaled as its log says.

Strategy: scans near each other on the way are matched. If one thing is wrong all along, what the match
says of the sensor's motion differs from what the poses say in a way that depends on the motion. With the told
motion (t, phi), the sensor's own velocities at both ends, and Jv = (-v_y, v_x), the error is, to first order,

- of a mount turned by a: (-a J t, 0); of one moved by m: ((Rot(phi) - I) m, 0);
- of poses taken s seconds too early: what the told motion changes by in s seconds;
- of a scale 1 + k of distances, or of turns: (k t, 0), (0, k phi).

Each is fitted by itself; errors are Student's t, with the covariances of the matches and what poses err
anyway. The likeliest one counts if it explains the errors far better than none, and if it puts surfaces apart
that are seen twice. Where nothing is seen twice, nothing is told: a robot that only drives straight on shows
neither a moved mount nor a mirrored laser, and one that always drives alike no wrong clock.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ndtree._errors import Text, key
from ndtree.alignment.planar import Floats, between, composed, wrapped
from ndtree.tuning.pairs import Pair, Pairs, matched

#: How much likelier errors must be (in logarithms): a scan is in up to four pairs, so by e^7 each for itself.
GAIN = 30.0
#: How far apart two views of a surface then lie [m], the diagonal of a usual smallest cell: at _AWAY from
#: scans that are _BESIDE from each other [m], in all but a few pairs of them at most.
APART, _AWAY, _BESIDE, _MOST = 0.07, 5.0, 3.0, 0.98
_LEAST_PAIRS = 12
_POSES = np.array([0.01, 0.01, 0.004])  # What poses of a SLAM system err, about [m, m, rad].
_FREEDOM = 2.0  # Of Student's t: some matches are wrong.
_MEDIAN = 2.37  # Of the squared length of three standard normal numbers.
_ROUNDS = 30
_STEP = 1e-3  # [s]
_TURNED = 0.05  # A turn that tells a mirrored scan from one that is not [rad].
#: What may be wrong, and its columns of `_slopes`.
_KINDS = {"yaw": [0], "place": [1, 2], "clock": [3], "scale": [4], "turns": [5]}


@dataclass(frozen=True)
class SetupError:
    """What is wrong all along a log, from `setup_error`.

    `kind`: "yaw" or "place" of the mount, "clock", "scale" of distances between poses, "turns" or "mirrored".
    `values`: To be added: [rad], x and y in the sensor's frame [m], [s], or a share; none if mirrored.
    `apart`: How far apart two views of a surface lie at most [m]; None of a mirrored laser.
    """

    kind: str
    values: tuple[float, ...]
    apart: float | None

    def __str__(self) -> str:
        """What was found and what helps, in one line."""
        found, helps = self._words()
        if self.apart is not None:
            found += f"; surfaces appear twice, up to {self.apart:.1g} m apart"
        return Text(f"poses do not fit the scans: {found}; {helps}")

    def _words(self) -> tuple[str, str]:
        if self.kind == "mirrored":
            return "the laser sees turns the other way round", (
                f"it may hang upside down ({key('mount')} with a roll of 180deg), or its beams come in the "
                "other order, or angles of poses have the other sign"
            )
        value = self.values[0]
        more = "more" if value > 0 else "less"
        mount = f"check the sensor's place on the robot, {key('mount')} sets it"
        if self.kind == "yaw":
            side = "left" if value > 0 else "right"
            return (
                f"the laser looks about {math.degrees(abs(value)):.0f} degrees further to the {side}",
                mount,
            )
        if self.kind == "place":
            x, y = self.values
            return f"the laser sits about {x:.2f}, {y:.2f} m (x, y in its own frame) from its place", mount
        if self.kind == "clock":
            when = "after" if value > 0 else "before"
            helps = f"check the clocks, {key('time_offset')} {value:.2f} adds that to the times of scans"
            return f"those of about {abs(value):.2f} s {when} a scan's time do", helps
        if self.kind == "scale":
            helps = "check the units, and the calibration of the odometry"
            return f"by the laser, the way is about {100 * abs(value):.0f} % {more}", helps
        helps = f"use {key('align')} or the poses of a SLAM system"
        return f"by the laser, turns are about {100 * abs(value):.0f} % {more}", helps


def setup_error(log: Pairs) -> SetupError | None:
    """Find what is wrong with mount, clock or scale of a 2-D log all along.

    Returns: None where nothing is, too little tells, or scans have no headings.
    """
    if not all(scan.has_heading for run in log.runs for scan in run):
        return None
    if _is_mirrored(log):
        return SetupError("mirrored", (), None)
    near = [pair for pair in log.pairs if pair.is_near and pair.is_matched]
    if len(near) < _LEAST_PAIRS:
        return None
    slopes = _slopes(np.array([pair.told for pair in near]), np.array([pair.velocities for pair in near]))
    covariances = np.array([pair.covariance for pair in near]) + np.diag(_POSES**2)
    whitening = np.linalg.inv(np.linalg.cholesky(covariances))
    errors = np.einsum("nij,nj->ni", whitening, np.array([pair.error for pair in near]))
    slopes = np.einsum("nij,njk->nik", whitening, slopes)
    none = _likelihood(errors)
    fits = {kind: _fitted(errors, slopes[:, :, columns]) for kind, columns in _KINDS.items()}
    kind = max(fits, key=lambda one: fits[one][1])
    values, likelihood = fits[kind]
    if likelihood - none < GAIN:
        return None
    apart = _apart(log, kind, values)
    return SetupError(kind, tuple(map(float, values)), apart) if apart >= APART else None


def _slopes(told: Floats, velocities: Floats) -> Floats:
    """(n, 3, 6) how errors of motions (n, 3) grow with each thing that may be wrong; velocities (n, 2, 3)."""
    x, y, turn = told.T
    slopes = np.zeros((len(told), 3, 6))
    slopes[:, :2, 0] = np.column_stack((y, -x))
    c, s = np.cos(turn), np.sin(turn)
    slopes[:, :2, 1:3] = np.stack((np.stack((c - 1, -s), -1), np.stack((s, c - 1), -1)), axis=1)
    later = composed(between(_STEP * velocities[:, 0], told), _STEP * velocities[:, 1])
    slopes[:, :, 3] = np.column_stack((later[:, :2] - told[:, :2], wrapped(later[:, 2] - turn))) / _STEP
    slopes[:, :2, 4] = told[:, :2]
    slopes[:, 2, 5] = turn
    return slopes


def _fitted(errors: Floats, slopes: Floats) -> tuple[Floats, float]:
    """The likeliest values, and how likely the errors are with them.

    By weighting again and again: from no error on, and from all pairs alike on, since the few in which an
    error shows look like wrong matches at first. Values are of about 1 before anything is known.
    """
    found = []
    for weights in (None, np.ones(len(errors))):
        values = np.zeros(slopes.shape[2])
        for _ in range(_ROUNDS):
            if weights is None:
                squared = ((errors - slopes @ values) ** 2).sum(axis=1)
                weights = (_FREEDOM + 3) / (_FREEDOM + squared / _spread(squared))
            normal = np.einsum("n,nik,nil->kl", weights, slopes, slopes) + np.eye(len(values))
            values = np.linalg.solve(normal, np.einsum("n,nik,ni->k", weights, slopes, errors))
            weights = None
        found.append((_likelihood(errors - slopes @ values), values))
    likelihood, values = max(found, key=lambda one: one[0])
    return values, likelihood


def _spread(squared: Floats) -> float:
    """How much larger squared errors are than covariances say; at least as large."""
    return max(1.0, float(np.median(squared)) / _MEDIAN)


def _likelihood(errors: Floats) -> float:
    """The logarithm, without constants."""
    squared = (errors**2).sum(axis=1)
    spread = _spread(squared)
    terms = np.log1p(squared / spread / _FREEDOM).sum()
    return -0.5 * (_FREEDOM + 3) * float(terms) - 1.5 * len(errors) * math.log(spread)


def _apart(log: Pairs, kind: str, values: Floats) -> float:
    """See `SetupError.apart`: of scans beside each other that see the same, on one visit or several."""
    own = {pair.run: pair.velocities[0] for pair in log.pairs}
    runs = np.array(sorted(own))
    poses = np.array([log.runs[run][0].pose for run in runs])
    first, second = np.triu_indices(len(poses), 1)
    beside = np.hypot(*(poses[first, :2] - poses[second, :2]).T) < _BESIDE
    first, second = first[beside], second[beside]
    if not len(first):
        return 0.0
    velocities = np.array([own[run] for run in runs])
    slopes = _slopes(
        between(poses[first], poses[second]), np.stack((velocities[first], velocities[second]), axis=1)
    )
    moved = slopes[:, :, _KINDS[kind]] @ values
    return float(np.quantile(np.hypot(moved[:, 0], moved[:, 1]) + _AWAY * np.abs(moved[:, 2]), _MOST))


def _is_mirrored(log: Pairs) -> bool:
    """Whether turns are seen the other way round: far more often they fit scans that are seen in a mirror."""
    turned = [pair for pair in log.pairs if pair.is_near and abs(pair.told[2]) > _TURNED]
    fitting = sum(map(_turns_alike, turned))
    if len(turned) < _LEAST_PAIRS or 2 * fitting > len(turned):
        return False
    flip = np.array([1.0, -1.0])
    runs = [
        [replace(scan, points=scan.points * flip, free=scan.free * flip) for scan in run] for run in log.runs
    ]
    mirrored = [pair for pair in matched(runs).pairs if pair.is_near and abs(pair.told[2]) > _TURNED]
    return sum(map(_turns_alike, mirrored)) > 2 * fitting + _LEAST_PAIRS


def _turns_alike(pair: Pair) -> bool:
    """Whether the sensor turned as the poses did, about."""
    return pair.is_matched and abs(pair.error[2]) < 0.5 * abs(pair.told[2])
