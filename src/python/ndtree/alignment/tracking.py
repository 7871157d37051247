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
from dataclasses import dataclass, field

import numpy as np

from ndtree._native._core import Matcher
from ndtree.alignment.outline import Outline
from ndtree.alignment.planar import Floats, between, composed, placed, pose_of, thinned, turned
from ndtree.alignment.sensor_scans import SensorScan


@dataclass(frozen=True)
class Motion:
    """How far odometry may be wrong, as standard deviations."""

    still: float = 0.02  # Of a place, whatever the way [m];
    still_angle: float = 0.01  # of the yaw [rad];
    rate: float = 0.1  # of a way, of a turn;
    turn: float = 0.02  # of the yaw for a way [rad/m].

    def sigmas(self, step: Floats, has_heading: bool) -> Floats:
        """Of x, y and yaw, for one motion."""
        way = math.hypot(step[0], step[1])
        place = self.still + self.rate * way
        turned = abs(step[2]) if has_heading else _SOME_TURN
        return np.array([place, place, self.still_angle + self.turn * way + self.rate * turned])


#: Of logs without odometry: the scan before moved so, this one does nearly.
NO_ODOMETRY = Motion(still=0.08, still_angle=0.05, rate=0.5, turn=0.1)

_SOME_TURN = 0.2  # Where a log does not say how far the sensor turned [rad].
_SIGMAS = 3.0  # Of odometry, that the window has to each side.
_LONGER = 2.0  # Time since the last scan, times that before: it does not go on as before.
_LARGEST = np.array([1.0, 1.0, 0.5])  # Window of one step [m, m, rad].
_WIDE = np.array([1.0, 1.0, 0.6])  # Where it moved anyhow,
_ANY_TURN = np.array([1.0, 1.0, 2.0])  # times this if the log does not say how it turned;
_APART = np.array([0.5, 0.5, 0.35])  # and which poses there are different ones.
_AS_BEFORE, _ANYHOW = math.log(0.01), math.log(0.001)  # How often it moves so, against odometry.
_PIECE = 0.2  # End points on one piece of surface of this size are wrong alike: it counts once [m].
_POOR = 0.75  # Of the score of scans before: below it, the wide window is looked at, too.
_UNIQUE = 0.9  # Of the score of a pose that was found there, which no other may have.
_CERTAIN = 7.0  # Log-likelihood by which another pose is less likely: one in a thousand is wrong.
_THROUGH = 3.0  # Log-likelihood that a piece costs that lies where others saw through.
_STALL = 16  # Scans that odometry may stall for, at most, and two.
_STALLED = 0.2  # Of what the sensor moves from scan to scan, more than which odometry tells something.
_COMPARED = 4  # Key scans whose outlines are compared.
_LOST = 0.3  # Fewer points on surfaces are no match.
_MOVES = 0.01  # Shorter steps do not tell odometry's scale [m].
_OPEN = 0.5  # Of odometry's variance: what leaves more of it does not tell.
_REMEMBERED = 30  # Scans whose scores are compared.
_FEWEST = 10  # Points of a scan that says something.
_MAP_SCANS = 60  # Key scans of the sliding map,
_MAP_WAY = 10.0  # and how long their way is, at most [m].


@dataclass(frozen=True)
class Hypothesis:
    """How a sensor may have moved, and the pose that fits best then."""

    pose: Floats
    covariance: Floats
    score: float
    inliers: float
    posterior: float  # Logarithm, but for a constant.


@dataclass(frozen=True)
class Step:
    """A scan whose match contradicts odometry.

    Parameters
    ----------
    scan : int
        Its number.
    is_sure : bool
        Whether it fits as well as others do, and nowhere else near.
    """

    scan: int
    is_sure: bool


@dataclass
class Track:
    """Where scans were, each as it was matched with those before."""

    poses: list[Floats] = field(default_factory=list)  # Of all scans.
    keys: list[int] = field(default_factory=list)  # Scans that are key scans.
    scans: list[SensorScan] = field(default_factory=list)  # Of the key scans.
    way: list[float] = field(default_factory=list)  # Up to each key scan [m].
    relations: list[Floats] = field(default_factory=list)  # Of each key scan to the next.
    covariances: list[Floats] = field(default_factory=list)  # Of these.
    lost: int = 0  # Scans that did not match.
    against: list[Step] = field(default_factory=list)  # Odometry.
    unfixed: list[float] = field(default_factory=list)  # Way of each scan that only odometry tells [m].
    through: list[float] = field(
        default_factory=list
    )  # Of each key scan: points where those before saw through.
    ratios: list[float] = field(default_factory=list)  # Of ways that scans say, to those of odometry.
    final: int = 0  # Key scans up to whose last all stays as it is.

    def copy(self) -> Track:
        """One that can be gone on with by itself."""
        return Track(
            **{name: list(one) if isinstance(one, list) else one for name, one in vars(self).items()}
        )


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
        self._matcher: Matcher | None = None
        self._map = [np.zeros((0, 2)) for _ in self.track.keys]  # End points of key scans where they were.
        self._outlines: dict[int, Outline] = {}  # Of the last key scans, by their numbers.
        self._recent: deque[SensorScan] = deque(maxlen=_STALL)  # The last scans.
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
        place = self._motion.sigmas(step, scan.has_heading)[0]
        track.unfixed.append(_unfixed(moved, covariance[:2, :2], place, self._has_odometry))
        square = float(told[:2] @ told[:2])
        if self._has_odometry and square > _MOVES**2:
            track.ratios.append(float(told[:2] @ self._step[:2]) / square)
        track.poses.append(pose)
        key = track.poses[track.keys[-1]]
        relation = between(key, pose)
        way = math.hypot(relation[0], relation[1])
        if way >= self._key_distance or abs(relation[2]) >= self._key_angle:
            self._scores.append(score)
            track.relations.append(relation)
            track.covariances.append(turned(covariance, key[2]))
            self._keep(scan, pose, track.way[-1] + way)
        self._recent.append(scan)
        window = _SIGMAS * self._motion.sigmas(before, True)
        if (
            self._has_odometry
            and self._is_regular
            and self._is_matched
            and _is_leap(before, self._step, window)
        ):
            self._smooth()

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
            way = track.way[-1] + _MAP_WAY  # Beyond the sliding map.
        track.poses.append(scan.pose)
        self._recent.clear()
        self._recent.append(scan)
        track.unfixed.append(0.0)
        self._keep(scan, scan.pose, way)

    def _scaled(self, told: Floats) -> Floats:
        """A motion by odometry, as far as scans say that it goes."""
        return told * (self._scale, self._scale, 1.0)

    def _matched(self, scan: SensorScan, last: Floats, step: Floats) -> tuple[Floats, Floats, float]:
        """Pose, covariance and score of a scan."""
        track = self.track
        guess, sigmas = composed(last, step), self._motion.sigmas(step, scan.has_heading)
        if len(scan.points) < _FEWEST:
            return guess, np.diag(sigmas**2), 0.0
        pieces = len(thinned(scan.points, _PIECE))
        by_odometry = best = self._near(scan, guess, sigmas, pieces)
        window = np.minimum(_SIGMAS * sigmas, _LARGEST)
        goes_on = self._has_odometry and self._is_regular and self._is_matched and len(track.poses) > 1
        if goes_on and _is_outside(step, self._step, window):
            free = NO_ODOMETRY.sigmas(self._step, True)
            as_before = self._near(scan, composed(last, self._step), free, pieces, _AS_BEFORE)
            best = max(best, as_before, key=_posterior)
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
        gained = pieces * _THROUGH * (self._through(scan, one.pose) - self._through(scan, other.pose))
        return other if other.posterior + gained > one.posterior else one

    def _caught_up(self, scan: SensorScan, pieces: int) -> Hypothesis | None:
        """The best pose around where odometry has it from where it last agreed."""
        if self._agreed is None or self._agreed[1] is self._last_but_one:
            return None
        since = self._scaled(between(self._agreed[1], scan.pose))
        sigmas = self._motion.sigmas(since, scan.has_heading)
        return self._near(scan, composed(self._agreed[0], since), sigmas, pieces, _AS_BEFORE)

    def _through(self, scan: SensorScan, pose: Floats, before: int | None = None) -> float:
        """Fraction of a scan's points at a pose that lie where key scans before some number saw through."""
        track, keys = self.track, range(len(self.track.keys) if before is None else before)[-_COMPARED:]
        judged = [
            self._outlines[key].judge(placed(between(track.poses[track.keys[key]], pose), scan.points))
            for key in keys
            if key in self._outlines
        ]
        same, through = (sum(counts) for counts in zip((0, 0), *judged))
        return through / max(same + through, 1)

    def _smooth(self) -> None:
        """Place the scans before a leap again: odometry stalled and caught up before it.

        From the scan after which the way to here is as even as it was before, each is matched around where
        an even motion has it, and around where odometry has it from here, with what was seen before and the
        last scan: not with each other. What fits best in all counts.
        """
        track, last = self.track, len(self.track.poses) - 1
        recent = list(self._recent)
        first = last - len(recent) + 1
        places = np.array(track.poses[first:])[:, :2]
        stamps = np.array([scan.stamp for scan in recent])
        anchor = first + even_since(places, stamps)
        if anchor >= last - 1:
            return
        end = np.array(track.poses[last])
        told = np.array([scan.pose[:2] for scan in recent[anchor - first : -1]])
        evenly_moved = float(np.hypot(*(end - track.poses[anchor])[:2])) / (last - anchor)
        is_told = np.hypot(*np.diff(told, axis=0).T) > _STALLED * evenly_moved
        if is_told.any():  # Odometry stands still from here on.
            anchor += int(np.flatnonzero(is_told)[-1]) + 1
        if anchor >= last - 1 or (track.final and anchor < track.keys[track.final - 1]):
            return
        scans = recent[anchor - first + 1 : -1]
        shares = np.linspace(0.0, 1.0, last - anchor + 1)[1:-1]
        moved = end - track.poses[anchor]
        moved[2] = math.remainder(moved[2], 2.0 * math.pi)
        evenly = track.poses[anchor] + shares[:, None] * moved
        if np.abs(evenly - track.poses[anchor + 1 : last])[:, :2].max() < 2.0 * self._cell_size:
            return
        if not scans[0].has_heading:
            evenly[:, 2] = np.array(track.poses[anchor + 1 : last])[:, 2]
        by_odometry = [composed(end, self._scaled(between(recent[-1].pose, one.pose))) for one in scans]
        step = moved / (last - anchor)
        known = int(np.searchsorted(track.keys, anchor, side="right"))
        matcher = self._matcher_of(
            [*self._map[self._first_key(known) : known], placed(end, recent[-1].points)]
        )
        free = NO_ODOMETRY.sigmas(step, True)
        pieces = [len(thinned(scan.points, _PIECE)) for scan in scans]
        best, most = (
            None,
            sum(
                many * matcher.score(scan.points, track.poses[anchor + 1 + i])
                for i, (scan, many) in enumerate(zip(scans, pieces))
            )
            - _AS_BEFORE,
        )
        for guesses in (evenly, by_odometry):
            found = [
                self._near(*each, free, many, matcher=matcher) for *each, many in zip(scans, guesses, pieces)
            ]
            fits = sum(one.score * many for one, many in zip(found, pieces))
            if fits > most:
                best, most = found, fits
        if best is not None:
            self._replace(anchor + 1, scans, best)

    def _replace(self, first: int, scans: list[SensorScan], found: list[Hypothesis]) -> None:
        """Place scans from a number on where they were found."""
        track = self.track
        for i, (scan, one) in enumerate(zip(scans, found), first):
            track.poses[i] = one.pose
            n = int(np.searchsorted(track.keys, i))
            if n < len(track.keys) and track.keys[n] == i:
                self._map[n] = placed(one.pose, scan.points)
                self._matcher = None
                track.through[n] = self._through(scan, one.pose, n)
                track.covariances[n - 1] = turned(one.covariance, track.poses[track.keys[n - 1]][2])
        for n in range(int(np.searchsorted(track.keys, first)), len(track.keys)):
            ends = track.poses[track.keys[n - 1]], track.poses[track.keys[n]]
            track.relations[n - 1] = between(*ends)
        self._step = between(track.poses[-2], track.poses[-1])
        self.is_smoothed = True

    def _near(
        self,
        scan: SensorScan,
        guess: Floats,
        sigmas: Floats,
        pieces: int,
        weight: float = 0.0,
        matcher: Matcher | None = None,
    ) -> Hypothesis:
        """The best pose around a guess."""
        match = (matcher or self._sliding_map()).match(
            scan.points,
            guess,
            window=np.minimum(_SIGMAS * sigmas, _LARGEST),
            information=np.diag(sigmas**-2),
            second=False,
        )
        pose = pose_of(match.pose)
        off = between(guess, pose) / sigmas
        prior = weight - float(np.log(sigmas).sum()) - 0.5 * float(off @ off)
        return Hypothesis(pose, match.covariance, match.score, match.inliers, pieces * match.score + prior)

    def _anyhow(
        self, scan: SensorScan, found: Floats, as_before: Floats, pieces: int
    ) -> tuple[Hypothesis, bool, float]:
        """The best pose of wide windows, whether no other fits nearly as well, and that one's posterior."""
        middles = [found, as_before] if _is_outside(found, as_before, _APART) else [found]
        wide = _WIDE if scan.has_heading else _WIDE * _ANY_TURN
        matches = [self._sliding_map().match(scan.points, middle, window=wide) for middle in middles]
        poses = [pose_of(match.pose) for match in matches]
        best = int(np.argmax([match.score for match in matches]))
        match, pose = matches[best], poses[best]
        rivals = [one.second for one in matches]
        rivals += [one.score for one, at in zip(matches, poses) if _is_outside(at, pose, _APART)]
        prior = _ANYHOW - float(np.log(2.0 * wide).sum()) + 1.5 * math.log(2.0 * math.pi)
        posterior, rival = pieces * match.score + prior, pieces * max(rivals) + prior
        one = Hypothesis(pose, match.covariance, match.score, match.inliers, posterior)
        return one, max(rivals) <= _UNIQUE * match.score, rival

    def _sliding_map(self) -> Matcher:
        if self._matcher is None:
            count = len(self.track.keys)
            self._matcher = self._matcher_of(self._map[self._first_key(count) :])
        return self._matcher

    def _matcher_of(self, points: list[Floats]) -> Matcher:
        return Matcher(np.concatenate(points), cell_size=self._cell_size)

    def _first_key(self, count: int) -> int:
        """The first of a number of key scans that is in the sliding map."""
        way, first = self.track.way, max(0, count - _MAP_SCANS)
        while first < count - 1 and way[count - 1] - way[first] > _MAP_WAY:
            first += 1
        return first

    def _keep(self, scan: SensorScan, pose: Floats, way: float) -> None:
        track = self.track
        track.through.append(self._through(scan, pose) if self._outlines else 0.0)
        track.keys.append(len(track.poses) - 1)
        track.scans.append(scan)
        track.way.append(way)
        self._map.append(placed(pose, scan.points))
        self._outlines[len(track.keys) - 1] = Outline(scan)
        self._outlines.pop(len(track.keys) - 1 - _COMPARED - _STALL, None)
        if len(self._map) > _MAP_SCANS:  # Only the last are looked at.
            self._map[-_MAP_SCANS - 1] = np.zeros((0, 2))
        self._matcher = None


def _unfixed(moved: Floats, covariance: Floats, sigma: float, has_odometry: bool) -> float:
    """How far a scan moved in directions in which its place is about as sure as odometry has it [m].

    Without odometry: how far it may have moved more, where it is less sure than by a usual odometry.
    """
    variances, axes = np.linalg.eigh(covariance)
    is_open = variances > _OPEN * (sigma if has_odometry else Motion.still) ** 2
    return float(np.linalg.norm((moved @ axes)[is_open] if has_odometry else np.sqrt(variances[is_open])))


def _is_leap(before: Floats, step: Floats, window: Floats) -> bool:
    """Whether a step is longer than the one before it, or goes elsewhere, by more than usual."""
    return bool((np.abs(step - before) > window)[:2].any())


def even_since(places: Floats, stamps: Floats) -> int:
    """Since which of some places the way to the last is most like that before it.

    `places` (n, 2) [m] and `stamps` (n,) [s] of consecutive scans; without times they are evenly spaced.
    """
    times = stamps if (np.diff(stamps) > 0).all() else np.arange(len(places), dtype=np.float64)
    if len(places) < 3:
        return len(places) - 1
    speeds = (places[-1] - places[:-1]) / (times[-1] - times[:-1])[:, None]
    before = np.diff(places, axis=0)[:-1] / np.diff(times)[:-1, None]
    off = np.hypot(*(speeds[1:] - before).T)
    return 1 + int(off.argmin())


def _posterior(hypothesis: Hypothesis) -> float:
    return hypothesis.posterior


def _is_outside(pose: Floats, guess: Floats, window: Floats) -> bool:
    return bool((np.abs(between(guess, pose)) > window).any())
