# SPDX-License-Identifier: BSD-3-Clause
"""Scans matched one after the other with those before: odometry from a laser.

Strategy: a scan is matched with a sliding map of the last key scans. How the sensor moved is a mixture:
nearly always as odometry says; at times odometry stalls, jumps or slips, and then the sensor moved about as
before, or anyhow; and odometry that was late catches up: from where it last agreed, it is right again. Each
is a window that is searched, those but the first only where odometry leaves doubt, and the pose with the
largest posterior is taken, to which beams count that pass through what the last key scans saw. That anyhow
counts only if no other pose of its window fits nearly as well. A scan that is far enough from the last key
scan becomes one, with a relation to it.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from ndtree.alignment.motion import (
    ANYHOW,
    AS_BEFORE,
    LARGEST,
    NO_ODOMETRY,
    PIECE,
    SIGMAS,
    Hypothesis,
    LearnedRate,
    Motion,
    best_near,
    pieces_of,
)
from ndtree.alignment.planar import Floats, between, composed, pose_of, thinned, turned
from ndtree.alignment.sensor_scans import SensorScan, Step, Track
from ndtree.alignment.sliding_map import KEPT, MAP_WAY, SlidingMap
from ndtree.alignment.stalls import place_again

_LONGER = 2.0  # Time since the last scan, times that before: it does not go on as before.
_WIDE = np.array([1.0, 1.0, 0.6])  # Where it moved anyhow,
_ANY_TURN = np.array([1.0, 1.0, 2.0])  # times this if the log does not say how it turned;
_APART = np.array([0.5, 0.5, 0.35])  # and which poses there are different ones.
_POOR = 0.75  # Of the score of scans before: below it, the wide window is looked at, too.
_UNIQUE = 0.9  # Of the score of a pose that was found there, which no other may have.
_CERTAIN = 7.0  # Log-likelihood by which another pose is less likely: one in a thousand is wrong.
_THROUGH = 3.0  # Log-likelihood that a piece costs that lies where others saw through.
_LOST = 0.3  # Fewer points on surfaces are no match.
_MOVES = 0.01  # Shorter steps do not tell odometry's scale [m].
_ELSEWHERE = 0.5  # Window in which a scan may fit elsewhere [m],
_ALIKE = 2.0  # and the standard deviation of that in cells, from which on it does.
_OPEN = 0.5  # Of odometry's variance: what leaves more of it does not tell.
_REMEMBERED = 30  # Scans whose scores are compared.
_FEWEST = 10  # Points of a scan that says something.


class Tracker:
    """Places scans one by one.

    Parameters
    ----------
    cell_size : float
        Of the matched map [m].
    motion : Motion
        How wrong odometry may be.
    has_odometry : bool
        Whether poses of scans say how the sensor moved.
    scale : float
        What odometry's ways are to be multiplied by: -1 where it counts backwards.
    track : Track, optional
        That is gone on with, by `begin`.
    """

    def __init__(
        self,
        cell_size: float,
        motion: Motion,
        has_odometry: bool = True,
        scale: float = 1.0,
        track: Track | None = None,
    ) -> None:
        self.track = track or Track()
        self.covariance = np.diag(motion.sigmas(np.zeros(3), True) ** 2)  # Of the last match.
        self._cell_size = cell_size
        self._motion = motion
        self._has_odometry = has_odometry
        self._scale = scale
        self._near = SlidingMap(self.track, cell_size)
        self._learned = LearnedRate(motion.rate)
        self._recent: deque[SensorScan] = deque(maxlen=KEPT)  # The last scans.
        self._scores: list[float] = []
        self._last: SensorScan | None = None
        self._lasted = 0.0  # Time from the scan before it [s].
        self._last_but_one: Floats | None = None  # Pose in the log of the scan before it.
        self._agreed: tuple[Floats, Floats] | None = (
            None  # Where odometry was right: pose, and that in the log.
        )
        self.is_smoothed = False  # Whether poses before the last have changed.
        self._is_matched = True  # Whether that was.
        self._is_regular = True  # Whether the time to this one is about as long.
        self._step = np.zeros(3)  # What the last scan moved.
        self._key_distance, self._key_angle = 4 * cell_size, 0.15

    def add(self, scan: SensorScan) -> None:
        """Place the next scan."""
        track = self.track
        if self._last is None:
            self.begin(scan)
            return
        told = between(self._last.pose, scan.pose)
        step = self._scaled(told) if self._has_odometry else self._step
        before = self._step
        lasted, self._lasted = self._lasted, scan.stamp - self._last.stamp
        self._is_regular = self._lasted <= _LONGER * lasted or lasted <= 0.0
        self._last_but_one, self._last = self._last.pose, scan
        pose, covariance, score = self._matched(scan, track.poses[-1], step)
        self.covariance = covariance
        self._step = between(track.poses[-1], pose)
        moved = pose[:2] - track.poses[-1][:2]
        least = _OPEN * self._motion.sigmas(step, scan.has_heading)[0] ** 2
        of_place = covariance[:2, :2]
        track.unfixed.append(_unfixed(moved, of_place, least) if self._has_odometry else _untold(of_place))
        square = float(told[:2] @ told[:2])
        if self._has_odometry and square > _MOVES**2:
            track.ratios.append(float(told[:2] @ self._step[:2]) / square)
        track.poses.append(pose)
        key = track.poses[track.keys[-1]]
        relation = between(key, pose)
        way = math.hypot(relation[0], relation[1])
        if way >= self._key_distance or abs(relation[2]) >= self._key_angle:
            if self._has_odometry and self._is_matched:
                since = sum(track.unfixed[track.keys[-1] + 1 : -1])
                track.unfixed[-1] = max(track.unfixed[-1], self._slides(scan, pose, relation) - since)
            self._scores.append(score)
            track.relations.append(relation)
            track.covariances.append(turned(covariance, key[2]))
            self._near.keep(scan, pose, track.way[-1] + way)
        self._recent.append(scan)
        window = SIGMAS * self._motion.sigmas(before, True)
        if (
            self._has_odometry
            and self._is_regular
            and self._is_matched
            and _is_leap(before, self._step, window)
            and place_again(track, self._near, [*self._recent], self._told, 2.0 * self._cell_size)
        ):
            self._step = between(track.poses[-2], track.poses[-1])
            self.is_smoothed = True

    def begin(self, scan: SensorScan, covariance: Floats | None = None) -> None:
        """Place a scan by its pose alone: the first, or one whose pose in the map has a covariance.

        It is matched with none before it, but the loops of the next scans may tell more.
        """
        track = self.track
        self._last, self._agreed, self._is_matched, self._step = scan, None, True, np.zeros(3)
        self._last_but_one = None
        way = 0.0
        if covariance is not None and track.keys:
            key = track.poses[track.keys[-1]]
            track.relations.append(between(key, scan.pose))
            track.covariances.append(turned(covariance, key[2]))
            way = track.way[-1] + MAP_WAY  # Beyond the sliding map.
        track.poses.append(scan.pose)
        self._recent.clear()
        self._recent.append(scan)
        track.unfixed.append(0.0)
        self._near.keep(scan, scan.pose, way)

    def _slides(self, scan: SensorScan, pose: Floats, relation: Floats) -> float:
        """How far a scan moved since the last key scan where it fits as well some cells away [m].

        Around where odometry has it, few end points that no others surround have it where odometry was,
        however wrong: in a window that odometry does not narrow, they fit in many places. What odometry is
        worth there is learned where scans tell the way; the way is one of an odometry as wrong as `motion`.
        """
        few = thinned(scan.points, PIECE)
        match = self._near.matcher.match(few, pose, window=(_ELSEWHERE, _ELSEWHERE, 0.0), second=False)
        moved = pose[:2] - self.track.poses[self.track.keys[-1]][:2]
        way = _unfixed(moved, match.covariance[:2, :2], (_ALIKE * self._cell_size) ** 2)
        if way == 0.0:
            self._learned.learn(self._told(self.track.scans[-1], scan), relation)
            return 0.0
        return way * min(1.0, self._learned.rate / self._motion.rate)

    def _scaled(self, told: Floats) -> Floats:
        """A motion by odometry, as far as scans say that it goes."""
        return told * (self._scale, self._scale, 1.0)

    def _told(self, one: SensorScan, other: SensorScan) -> Floats:
        """A scan as seen from another one, by odometry, as far as scans say that it goes."""
        return self._scaled(between(one.pose, other.pose))

    def _matched(self, scan: SensorScan, last: Floats, step: Floats) -> tuple[Floats, Floats, float]:
        """Pose, covariance and score of a scan."""
        track = self.track
        guess, sigmas = composed(last, step), self._motion.sigmas(step, scan.has_heading)
        if len(scan.points) < _FEWEST:
            return guess, np.diag(sigmas**2), 0.0
        pieces, near = pieces_of(scan), self._near.matcher
        by_odometry = best = best_near(near, scan, guess, sigmas, pieces)
        window = np.minimum(SIGMAS * sigmas, LARGEST)
        goes_on = self._has_odometry and self._is_regular and self._is_matched and len(track.poses) > 1
        if goes_on and _is_outside(step, self._step, window):
            free = NO_ODOMETRY.sigmas(self._step, True)
            as_before = best_near(near, scan, composed(last, self._step), free, pieces, AS_BEFORE)
            best = max(best, as_before, key=lambda one: one.posterior)
        before = self._scores[-_REMEMBERED:]
        usual = _POOR * float(np.median(before)) if len(before) > 5 else 0.0
        is_against = self._has_odometry and _is_outside(best.pose, guess, window)
        if best.score < usual or best.inliers < _LOST or is_against:
            anyhow, is_unique, rival = self._anyhow(scan, best.pose, composed(last, self._step), pieces)
            if is_unique:
                best = self._likelier(scan, pieces, best, anyhow)
            elif _is_outside(anyhow.pose, best.pose, _APART):
                rival = anyhow.posterior
            late = self._caught_up(scan, pieces) if best.score < usual or best.inliers < _LOST else None
            if late is not None:
                best = self._likelier(scan, pieces, best, late)
            # It sees what was not seen before: only odometry knows.
            if self._has_odometry and best.score < usual:
                best = by_odometry
            if self._has_odometry and _is_outside(best.pose, guess, window):
                track.against.append(Step(len(track.poses), is_unique or best.posterior > rival + _CERTAIN))
        if self._has_odometry and not _is_outside(best.pose, guess, window):
            self._agreed = best.pose, scan.pose
        self._is_matched = best.inliers >= _LOST
        if not self._is_matched:
            track.lost += 1
            return guess, np.diag(sigmas**2), best.score
        return best.pose, best.covariance, best.score

    def _likelier(self, scan: SensorScan, pieces: int, one: Hypothesis, other: Hypothesis) -> Hypothesis:
        """Of two hypotheses, by their posteriors and by how many beams contradict the scans before."""
        gained = (
            pieces * _THROUGH * (self._near.through(scan, one.pose) - self._near.through(scan, other.pose))
        )
        return other if other.posterior + gained > one.posterior else one

    def _caught_up(self, scan: SensorScan, pieces: int) -> Hypothesis | None:
        """The best pose around where odometry has it from where it last agreed."""
        if self._agreed is None or self._agreed[1] is self._last_but_one:
            return None
        since = self._scaled(between(self._agreed[1], scan.pose))
        sigmas = self._motion.sigmas(since, scan.has_heading)
        return best_near(
            self._near.matcher, scan, composed(self._agreed[0], since), sigmas, pieces, AS_BEFORE
        )

    def _anyhow(
        self, scan: SensorScan, found: Floats, as_before: Floats, pieces: int
    ) -> tuple[Hypothesis, bool, float]:
        """The best pose of wide windows, whether no other fits nearly as well, and that one's posterior."""
        middles = [found, as_before] if _is_outside(found, as_before, _APART) else [found]
        wide = _WIDE if scan.has_heading else _WIDE * _ANY_TURN
        matches = [self._near.matcher.match(scan.points, middle, window=wide) for middle in middles]
        poses = [pose_of(match.pose) for match in matches]
        best = int(np.argmax([match.score for match in matches]))
        match, pose = matches[best], poses[best]
        rivals = [one.second for one in matches]
        rivals += [one.score for one, at in zip(matches, poses) if _is_outside(at, pose, _APART)]
        prior = ANYHOW - float(np.log(2.0 * wide).sum()) + 1.5 * math.log(2.0 * math.pi)
        posterior, rival = pieces * match.score + prior, pieces * max(rivals) + prior
        one = Hypothesis(pose, match.covariance, match.score, match.inliers, posterior)
        return one, max(rivals) <= _UNIQUE * match.score, rival


def _unfixed(moved: Floats, covariance: Floats, least: float) -> float:
    """How far a scan moved in directions in which its place has more than a variance [m]."""
    variances, axes = np.linalg.eigh(covariance)
    return float(np.linalg.norm((moved @ axes)[variances > least]))


def _untold(covariance: Floats) -> float:
    """How far a scan may have moved more, where it is less sure than by a usual odometry [m]."""
    variances = np.linalg.eigvalsh(covariance)
    return math.sqrt(float(variances[variances > _OPEN * Motion.still**2].sum()))


def _is_leap(before: Floats, step: Floats, window: Floats) -> bool:
    """Whether a step is longer than the one before it, or goes elsewhere, by more than usual."""
    return bool((np.abs(step - before) > window)[:2].any())


def _is_outside(pose: Floats, guess: Floats, window: Floats) -> bool:
    return bool((np.abs(between(guess, pose)) > window).any())
