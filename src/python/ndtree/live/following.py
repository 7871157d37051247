# SPDX-License-Identifier: BSD-3-Clause
"""A hypothesis moved on by odometry and a scan: prior, likelihood, posterior."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ndtree._native._core import pose_matrix
from ndtree.live.hypotheses import Evidence, Floats, Hypothesis, Prior, lengths_of, motion_between
from ndtree.live.surroundings import ALIKE, Surroundings

#: Standard deviations of a guess of where it is [m, rad].
GUESS = 0.3, 0.15
#: Window around the predicted pose, at least [m, rad]; else this number of its standard deviations, and at
#: most.
LEAST, SIGMAS, WIDEST = (0.15, 0.06), 3.0, (1.0, 0.5)
#: Standard deviations of odometry: at a standstill, by chance for a way of 1 m or a turn of 1 rad, where
#: they grow with its root [m, rad]; and as a share of what it moved since the last match.
STILL, WALK, SHARE = (0.005, 0.003), (0.06, 0.03), 0.1
#: A step this many times longer than the longest of the last STEPS_BEFORE, and this much [m], is a jump of
#: odometry: how far it went is open.
JUMP, JUMPS_BY, STEPS_BEFORE = 2.0, 0.2, 10
#: A pose of the window's grid is taken instead of the predicted one if its score is larger by this factor.
CLEARLY = 1.03
#: A scan says nothing of a way along which its modes spread by more than this [m].
SPREAD = 0.1
#: A scan that narrows a standard deviation of more than this [m] by this factor may fit elsewhere, too.
OPEN, NARROWS = 0.35, 0.2


class Follower:
    """Moves hypotheses with odometry, to where scans have them.

    Attributes:
    `before`, optional: Odometry of the last scan.
    `jumped`: How far odometry jumped since a scan fitted [m].
    """

    def __init__(self, around: Surroundings) -> None:
        self._around = around
        self.before: Floats | None = None
        self.jumped = 0.0
        self._steps: deque[float] = deque(maxlen=STEPS_BEFORE)  # Of odometry [m].

    def note(self, at: Floats) -> None:
        """Remember how far odometry moved, and whether it jumped."""
        if self.before is not None:
            step = lengths_of(motion_between(self.before, at))[0]
            if self._steps and step > JUMP * max(self._steps) + JUMPS_BY:
                self.jumped += step
            else:
                self._steps.append(step)
        self.before = at

    def follow(
        self, one: Hypothesis, ends: Floats, at: Floats, fits: Callable[[Evidence], bool]
    ) -> tuple[Any, Evidence, bool]:
        """Match a scan near where odometry has a hypothesis, and move that there if it fits.

        `ends`, `at`: End points and odometry, as `Surroundings` has them.
        `fits`: Whether evidence is that of a right pose.
        Returns Match, Evidence, bool: The last is true if the scan narrowed what odometry left open, so that
            other poses may fit, too.
        """
        guess, around = one.map_odometry @ at, self._around
        prior = self.predicted(one, at)
        sigmas = np.sqrt(np.diag(prior))
        near = max(LEAST[0], SIGMAS * max(sigmas[:2])), max(LEAST[1], SIGMAS * sigmas[-1])
        match = around.match(ends, guess, (0.0, 0.0), prior)
        found = around.match(ends, guess, (min(near[0], WIDEST[0]), min(near[1], WIDEST[1])), prior)
        # Of flat likelihoods, the search gives any: it counts where it is clearly the better one.
        if around.score(ends, found.pose) > CLEARLY * around.score(ends, match.pose):
            match = found
        ways = self._ways_alike(ends, match.pose)
        pose, covariance = told_by(guess, prior, match.pose, around.covariance(match), ways)
        one.slides(len(ways))
        before, after = (math.sqrt(np.linalg.eigvalsh(c[:2, :2])[1]) for c in (prior, covariance))
        evidence = around.evidence(pose, ends)
        if fits(evidence):
            one.map_odometry, one.covariance = pose @ inverse(at), covariance
            one.matched, one.failed = at, 0
        else:
            one.failed += 1
        return match, evidence, before > OPEN and after < NARROWS * before

    def _ways_alike(self, ends: Floats, pose: Floats) -> list[Floats]:
        """Unit motions along which a scan fits elsewhere as well: corridors, fences, rows of the same."""
        variances, axes = np.linalg.eigh(self._around.alike(ends, pose))
        rest = np.zeros(self._around.dim - 1)
        return [np.append(way, rest) for way in axes.T[variances > SPREAD**2]]

    def prior(self, one: Hypothesis, extent: Floats, at: Floats) -> Prior:
        """Where a hypothesis may be before a scan, in a map of an extent [m]."""
        return Prior(one.map_odometry, self.predicted(one, at), extent, 1 + one.untold)

    def predicted(self, one: Hypothesis, at: Floats) -> Floats:
        """The covariance of where odometry has the sensor, by that of the last match."""
        if one.matched is None:
            return one.covariance
        moved = motion_between(one.map_odometry @ one.matched, one.map_odometry @ at)
        step, turn = lengths_of(moved)
        way = moved[:-1]
        lever = np.eye(len(moved))
        lever[:2, -1] = -way[1], way[0]
        place = STILL[0] ** 2 + WALK[0] ** 2 * step + (SHARE * step) ** 2 + self.jumped**2
        yaw = STILL[1] ** 2 + WALK[1] ** 2 * (step + turn) + (SHARE * turn) ** 2
        noise = [place, place, place - self.jumped**2, yaw] if len(moved) == 4 else [place, place, yaw]
        predicted: Floats = lever @ one.covariance @ lever.T + np.diag(noise)
        if step > 0.0:  # The scale of wheels is wrong alike in all steps: along the way, deviations add up.
            ahead = np.append(way, 0.0) / step
            before = math.sqrt(max(0.0, float(ahead @ one.covariance @ ahead)))
            predicted += 2.0 * before * SHARE * step * np.outer(ahead, ahead)
        return predicted


def told_by(
    guess: Floats, prior: Floats, pose: Floats, covariance: Floats, ways: list[Floats]
) -> tuple[Floats, Floats]:
    """A pose and its covariance without what a scan says by chance.

    What scans from about one place say wrongly, all say alike: it is no knowledge, however many they are. So
    directions in which one scan leaves more than half of the prior's variance keep the prior's mean and
    variance. Along ways on which it fits elsewhere, too, it may have slid by ALIKE: that is marginalised.

    `guess`, `prior`: The pose and its covariance before the scan.
    `pose`, `covariance`: The same with it.
    `ways`: Motions.
    """
    root = np.linalg.cholesky(prior)
    inward = np.linalg.inv(root)
    left, axes = np.linalg.eigh(inward @ covariance @ inward.T)
    off = axes.T @ inward @ motion_between(guess, pose)
    worth = np.maximum(1.0 / left - 1.0, 0.0)  # Information, where the prior's is 1.
    said, gradient = axes * worth @ axes.T, axes @ np.where(worth > 0.0, off / left, 0.0)
    for way in ways:
        slide = inward @ way
        along = said @ slide
        much = float(slide @ along) + ALIKE**-2
        gradient = gradient - along * (float(slide @ gradient) / much)
        said = said - np.outer(along, along) / much
    worth, axes = np.linalg.eigh(said)
    worth = np.where(worth < 1.0, 0.0, worth)
    outward = root @ axes / (1.0 + worth)
    moved = outward @ np.where(worth > 0.0, axes.T @ gradient, 0.0)
    return shifted(guess, moved), outward @ np.diag(1.0 + worth) @ outward.T


def shifted(pose: Floats, motion: Floats) -> Floats:
    """A pose moved by x, y, z in space, and turned by yaw, along and about the map's axes."""
    c, s = math.cos(motion[-1]), math.sin(motion[-1])
    result = pose.copy()
    result[:2, :-1] = np.array([[c, -s], [s, c]]) @ pose[:2, :-1]
    result[:-1, -1] += motion[:-1]
    return result


def matrix_of(pose: ArrayLike) -> Floats:
    """(3, 3) of x, y and yaw, or of a matrix; ValueError if it is no pose."""
    return pose_matrix(pose, dim=2)


def inverse(pose: Floats) -> Floats:
    """Of a rigid motion."""
    back = np.eye(len(pose))
    back[:-1, :-1] = pose[:-1, :-1].T
    back[:-1, -1] = -pose[:-1, :-1].T @ pose[:-1, -1]
    return back
