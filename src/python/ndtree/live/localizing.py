# SPDX-License-Identifier: BSD-3-Clause
"""Where a robot is in a saved map, scan by scan, from odometry and what its scans see.

Strategy: hypotheses, each a normal distribution of the pose. Odometry moves them and widens them by its
noise; `Matcher` searches a window around each, and gives the next posterior: what scans do not tell, as the
way along a corridor, keeps odometry's mean, and a variance that grows with the way. `ScanEvidence` compares
the beams with where the map ends them, and weighs hypotheses. While one is left, and scans fit it as those
before did, that is where the robot is. A scan that fits clearly worse asks for others: near, and in all of
the map. A pose is told again when one explains all that was seen since then, and no other does nearly.

Invariants: a pose is told only while the robot is not lost; the same scans give the same poses. Cost: some
milliseconds a scan while it is tracked, and for a lost one what `Matcher` takes for the map.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ndtree._native._core import Matcher, OccupancyMap, pose_matrix
from ndtree.live.hypotheses import NOT_HERE, Evidence, Hypothesis, ScanEvidence, Viewpoint, pieces_of

Floats = NDArray[np.float64]
#: The frame of odometry, unless another is said: scans are placed in it, and found in the map.
ODOMETRY = "odom"
#: A scan with fewer points says nothing.
_LEAST_POINTS = 10

#: Standard deviations of a guess of where it is [m, m, rad].
GUESS = 0.3, 0.3, 0.15
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
#: Scans in a row that do not fit: then it is lost. And that fit: then it is found.
LOSES, FINDS = 5, 4
#: Odometry's standard deviations above this [m] are narrowed only where beams confirm it: three of the
#: narrowed ones away, at least this far [m], the logarithm of their likelihood is lower by this.
PROBED, TELLS, FLAT = 0.1, 0.15, 2.0
#: Points that are matched at most, of a scan while it is tracked, and in all of the map.
TRACKED, LOST = 400, 90
#: All of the map is searched on a grid this much coarser than its smallest cells; then on the fine one, in
#: a window of this number of the coarse grid's steps, and turned by this [rad]. The last is the number of poses.
COARSER, STEPS, TURN, MOST = 4.0, 2.0, 0.15, 8
#: A scan fits that is likelier in the map than out of it, or whose mean log-likelihood is no more than
#: this below the median of the last scans that fitted, at most this number of them.
WORSE, REMEMBERED = 0.3, 30
#: Others are asked for where a scan's log-likelihood is this much below the usual, or its score this much;
#: after a search without success not for twice as many scans as before it, at most for this number.
ASKS, USUAL, RESTS = 8.0, 0.93, 16
#: And where a scan narrows a standard deviation of more than this [m] by this factor: other poses may have
#: fitted.
OPEN, NARROWS = 0.35, 0.2
#: How much likelier a hypothesis must be than all others, in logarithms: one in a thousand is wrong. With
#: less than the second number the robot is lost; with more than the third the less likely is forgotten.
CERTAIN, DOUBTS, FORGETS = 7.0, 4.0, 15.0
#: Fraction of beams that end where the map is known, of a pose that may be another one.
LEAST_KNOWN = 0.5
#: Logarithms: of how often a robot is carried elsewhere between two scans; and of how many poses there are
#: in a map, of which any may fit by chance.
CARRIED, ANYWHERE = 9.0, 14.0
#: A viewpoint begins after a way [m] or a turn [rad]. A robot that was never found is found after this
#: number of viewpoints, if their mean log-likelihood is at least this; or where it stands, after this
#: number of scans that are at least this likely.
ANEW, VIEWPOINTS, KNOWN, STANDS, WELL = (0.25, 0.25), 8, -0.3, 10, -0.1


@dataclass(frozen=True, eq=False)
class Localization:
    """Where a robot is.

    Attributes
    ----------
    stamp : float
        Of the scan [s].
    is_lost : bool
        Nothing is known then, and the rest is the last that was.
    pose : (3, 3) float64
        Of the sensor in the map.
    body : (3, 3) float64
        Of the robot in the map, as far as it was told where the sensor is on it; else the sensor's.
    map_odometry : (3, 3) float64
        The odometry's frame in the map: what a robot publishes.
    covariance : (3, 3) float64
        Of x, y and yaw of the pose [m, rad].
    score, inliers : float
        As of `Match`; of a scan that was not matched 0.
    """

    stamp: float
    is_lost: bool
    pose: Floats
    body: Floats
    map_odometry: Floats
    covariance: Floats
    score: float
    inliers: float


class Localizer:
    """Tracks a sensor in a map, says when it is lost, and finds it again.

    Parameters
    ----------
    m : OccupancyMap
        2-D; it is not changed.
    guess : array_like, (3,), optional
        Where the sensor is at the first scan: x, y and yaw; left out, it is looked for in all of the map.

    Attributes
    ----------
    is_lost : bool
    scans, fitting, times_lost : int
        Scans that came, that fitted, and how often the robot was lost.

    Raises
    ------
    ValueError
        If the map is not 2-D or has no occupied cells.
    """

    def __init__(self, m: OccupancyMap, guess: ArrayLike | None = None) -> None:
        if m.dim != 2:
            raise ValueError(f"a map with dim = {m.dim}: must be 2 to be localised in")
        surface = m.leaves(states=("occupied",))
        if not len(surface.size):
            raise ValueError("a map without occupied cells: there is nothing to be localised by")
        bounds = surface.lower.min(axis=0), (surface.lower + surface.size[:, None]).max(axis=0)
        self._center = 0.5 * (bounds[0] + bounds[1])
        self._half = 0.5 * float(np.max(bounds[1] - bounds[0]))
        self._matcher: Matcher = m.matcher()
        self._coarse: Matcher = m.matcher(cell_size=COARSER * m.min_cell_size)
        self._step = COARSER * m.min_cell_size
        self._evidence = ScanEvidence(m)
        self.is_lost = guess is None
        self.scans = self.fitting = self.times_lost = 0
        self._guess = None if guess is None else matrix_of(guess)
        self._told = Hypothesis(np.eye(3), np.diag(np.square(GUESS)))  # The last that was likeliest.
        self._hypotheses: list[Hypothesis] = [] if guess is None else [self._told]
        self._viewpoints: list[Viewpoint] = []  # Since it is not sure which.
        self._before: Floats | None = None  # The odometry of the scan before.
        self._steps: deque[float] = deque(maxlen=STEPS_BEFORE)  # Of odometry [m].
        self._usual: deque[tuple[float, float]] = deque(maxlen=REMEMBERED)  # Means and scores that fitted.
        self._is_found_anew = False  # The last scan said much more than odometry.
        self._jumped = 0.0  # Of odometry, since the last match [m].
        self._rests = self._rested = 0  # Scans until others may be asked for.

    def track(
        self, points: ArrayLike, odometry: ArrayLike, stamp: float = 0.0, *, body: ArrayLike | None = None
    ) -> Localization:
        """Take a scan.

        Parameters
        ----------
        points : (n, 2)
            End points on surfaces, in the sensor's frame [m]; those that are not finite say nothing.
        odometry : (3,) or (3, 3)
            The sensor in the odometry's frame: x, y and yaw, or a matrix.
        stamp : float
            [s]
        body : (3,) or (3, 3), optional
            The robot in the odometry's frame; else the sensor.

        Returns
        -------
        Localization
        """
        ends = np.asarray(points, dtype=np.float64).reshape(-1, 2)
        ends = ends[np.isfinite(ends).all(axis=1)]
        at = matrix_of(odometry)
        if self._guess is not None:
            self._told.map_odometry, self._guess = self._guess @ inverse(at), None
        self.scans += 1
        self._note(at)
        few = ends[:: _stride(ends, TRACKED)]
        match = self._weigh(few, at) if len(few) >= _LEAST_POINTS else None
        if match is None:
            self._miss()
        here = self._told.map_odometry
        return Localization(
            stamp,
            self.is_lost,
            here @ at,
            here @ (at if body is None else matrix_of(body)),
            here.copy(),
            self._told.covariance.copy(),
            0.0 if match is None else float(match.score),
            0.0 if match is None else float(match.inliers),
        )

    def _weigh(self, ends: Floats, at: Floats) -> Any:
        """Move all hypotheses to where the scan has them, look for others, judge; the likeliest's match."""
        said = [(one, *self._follow(one, ends, at)) for one in self._hypotheses]
        if self.is_lost or self._viewpoints:
            self._see(ends, at, [(one, evidence) for one, _, evidence in said])
        elif said and (self._is_found_anew or self._is_odd(said[0][2], said[0][1].score)):
            self._viewpoints = [Viewpoint(at, ends, said[0][2].pieces)]
            self._told.prior = 0.0 if self._is_found_anew else CARRIED
            self._told.seen = [[said[0][2].total]]
            self._rests = 0 if self._is_found_anew else self._rests
        if self._viewpoints and self._may_ask():
            said += self._ask(ends, at)
        said = [one for one in said if one[0].failed < LOSES]
        if not said:
            self._hypotheses = []
            return None
        best, match, evidence = max(said, key=lambda one: one[0].weight)
        self._hypotheses = [one for one, _, _ in said if one.weight >= best.weight - FORGETS]
        others = [one.weight for one in self._hypotheses if one is not best]
        lead = best.weight - max(others, default=-math.inf)
        self._judge(best, lead, self._is_odd(evidence, match.score))
        if best.failed == 0 and not self.is_lost and lead >= CERTAIN and best is self._told:
            self._usual.append((evidence.mean, match.score))
        return match

    def _judge(self, best: Hypothesis, lead: float, is_odd: bool) -> None:
        """Whether the likeliest is where the robot is."""
        if best.failed == 0:
            self.fitting += 1
            self._jumped = 0.0
        if self.is_lost:
            self._told = best
            if lead >= CERTAIN and self._is_found(best):
                self.is_lost = False
                self._settle(best)
        elif lead < DOUBTS or (best is not self._told and not self._is_near(best)):
            self._lose()
        elif (
            self._viewpoints
            and best.failed == 0
            and lead >= CERTAIN
            and (best is not self._told or not is_odd)
        ):
            self._settle(best)

    def _is_near(self, one: Hypothesis) -> bool:
        """Whether the robot may have moved there by itself."""
        assert self._before is not None
        away = self._told.away(one, self._before)
        return math.hypot(away[0], away[1]) < WIDEST[0] and abs(away[2]) < WIDEST[1]

    def _is_found(self, one: Hypothesis) -> bool:
        """Whether enough was seen from where a hypothesis has the lost robot."""
        count = sum(len(seen) for seen in one.seen)
        pieces = [view.pieces for view in self._viewpoints]
        least = CERTAIN if self._usual else ANYWHERE
        if one.failed or count <= FINDS or one.weight < NOT_HERE * sum(pieces) + least:
            return False
        if self._usual:
            return True
        if one.weight < KNOWN * sum(pieces):
            return False
        means = [float(np.mean(seen)) / max(many, 1) for seen, many in zip(one.seen, pieces)]
        return len(means) >= VIEWPOINTS or (count >= STANDS and min(means) >= WELL)

    def _settle(self, one: Hypothesis) -> None:
        """One is left."""
        one.prior, one.seen = 0.0, []
        self._hypotheses, self._viewpoints = [one], []
        self._told = one

    def _lose(self) -> None:
        self.is_lost = True
        self.times_lost += 1
        self._rests = self._rested = 0

    def _miss(self) -> None:
        """A scan that fits no hypothesis, or says nothing."""
        for one in self._hypotheses:
            one.failed += 1
        if not self.is_lost and all(one.failed >= LOSES for one in self._hypotheses):
            self._lose()

    def _is_odd(self, evidence: Evidence, score: float) -> bool:
        """Whether a scan fits worse than those before."""
        usual, usual_score = self._median()
        return (usual - evidence.mean) * evidence.pieces > ASKS or score < USUAL * usual_score

    def _fits(self, evidence: Evidence) -> bool:
        return evidence.mean >= min(self._median()[0] - WORSE, NOT_HERE)

    def _median(self) -> tuple[float, float]:
        """Of the mean log-likelihoods and scores of scans that fitted."""
        if not self._usual:
            return NOT_HERE, 0.0
        mean, score = np.median(np.array(self._usual), axis=0)
        return float(mean), float(score)

    def _see(self, ends: Floats, at: Floats, said: list[tuple[Hypothesis, Evidence]]) -> None:
        """Note what was seen, at the last viewpoint or a new one."""
        step = inverse(self._viewpoints[-1].odometry) @ at if self._viewpoints else np.eye(3)
        turn = abs(math.atan2(step[1, 0], step[0, 0]))
        is_new = not self._viewpoints or math.hypot(*step[:2, 2]) > ANEW[0] or turn > ANEW[1]
        if is_new:
            self._viewpoints.append(Viewpoint(at, ends, pieces_of(ends)))
            self._rests = 0 if self.is_lost else self._rests
        for one, evidence in said:
            if is_new:
                one.seen.append([])
            one.seen[-1].append(evidence.total)
        if len(self._viewpoints) > MOST:
            del self._viewpoints[0]
            for one, _ in said:
                del one.seen[0]

    def _may_ask(self) -> bool:
        """Whether it is time to look for others."""
        self._rests -= 1
        return self._rests < 0

    def _ask(self, ends: Floats, at: Floats) -> list[tuple[Hypothesis, Any, Evidence]]:
        """Other hypotheses, near and in all of the map, that explain the scan."""
        new: list[tuple[Hypothesis, Any, Evidence]] = []
        for match in self._others(ends, at):
            one = Hypothesis(match.pose @ inverse(at), np.asarray(match.covariance), at)
            known = [*self._hypotheses, *(other for other, _, _ in new)]
            if any(one.is_same(other, at) for other in known):
                continue
            evidence = self._evidence.of(match.pose, ends)
            if not self._fits(evidence) or evidence.known < LEAST_KNOWN:
                continue
            one.seen = [
                [self._evidence.of(one.map_odometry @ view.odometry, view.ends).total]
                for view in self._viewpoints
            ]
            one.seen[-1] = [evidence.total]
            new.append((one, match, evidence))
        self._rested = min(2 * self._rested + 1, RESTS) if not new else 1
        self._rests = LOSES if self.is_lost else self._rested
        return new

    def _others(self, ends: Floats, at: Floats) -> list[Any]:
        """Matches near the last pose, and in all of the map."""
        few = ends[:: _stride(ends, LOST)]
        near = self._told.map_odometry @ at
        window = (2.0 * WIDEST[0], 2.0 * WIDEST[0], WIDEST[1])
        apart = 2.0 * self._step / COARSER
        found = []
        if self._hypotheses:
            found += self._matcher.modes(few, near, window=window, apart=apart, apart_angle=0.1, most=MOST)
        everywhere = np.eye(3)
        everywhere[:2, 2] = self._center
        window = (self._half, self._half, math.pi)
        for mode in self._coarse.modes(few, everywhere, window=window, apart=2.0 * self._step, most=MOST):
            found.append(self._match(ends, np.asarray(mode.pose), (STEPS * self._step, TURN)))
        return found

    def _follow(self, one: Hypothesis, ends: Floats, at: Floats) -> tuple[Any, Evidence]:
        """A scan near where odometry has a hypothesis."""
        guess = one.map_odometry @ at
        prior = np.diag(np.square(GUESS)) if one.matched is None else self._predicted(one, at)
        sigmas = np.sqrt(np.diag(prior))
        near = max(LEAST[0], SIGMAS * max(sigmas[:2])), max(LEAST[1], SIGMAS * sigmas[2])
        match = self._match(ends, guess, (0.0, 0.0), prior)
        found = self._match(ends, guess, (min(near[0], WIDEST[0]), min(near[1], WIDEST[1])), prior)
        # Of flat likelihoods, the search gives any: it counts where it is clearly the better one.
        if self._matcher.score(ends, found.pose) > CLEARLY * self._matcher.score(ends, match.pose):
            match = found
        pose, covariance = told_by(
            guess, prior, match.pose, match.covariance, lambda at: self._evidence.of(at, ends).total
        )
        before, after = (math.sqrt(np.linalg.eigvalsh(c[:2, :2])[1]) for c in (prior, covariance))
        if one is self._told:
            self._is_found_anew = before > OPEN and after < NARROWS * before
        evidence = self._evidence.of(pose, ends)
        if not self._fits(evidence):  # It may have moved anyhow.
            wide = self._match(ends, guess, WIDEST)
            found_there = self._evidence.of(wide.pose, ends)
            if self._fits(found_there) and found_there.total > evidence.total + CERTAIN:
                match, evidence = wide, found_there
                pose, covariance = np.asarray(wide.pose), np.asarray(wide.covariance)
        if self._fits(evidence):
            one.map_odometry, one.covariance = pose @ inverse(at), covariance
            one.matched, one.failed = at, 0
        else:
            one.failed += 1
        return match, evidence

    def _note(self, at: Floats) -> None:
        """Remember how far odometry moved, and whether it jumped."""
        if self._before is not None:
            step = float(np.hypot(*(inverse(self._before) @ at)[:2, 2]))
            if self._steps and step > JUMP * max(self._steps) + JUMPS_BY:
                self._jumped += step
            else:
                self._steps.append(step)
        self._before = at

    def _predicted(self, one: Hypothesis, at: Floats) -> Floats:
        """The covariance of where odometry has the sensor, by that of the last match."""
        assert one.matched is not None
        moved = inverse(one.matched) @ at
        step, turn = float(np.hypot(*moved[:2, 2])), abs(math.atan2(moved[1, 0], moved[0, 0]))
        way = (one.map_odometry @ at - one.map_odometry @ one.matched)[:2, 2]
        lever = np.eye(3)
        lever[:2, 2] = -way[1], way[0]
        place = STILL[0] ** 2 + WALK[0] ** 2 * step + (SHARE * step) ** 2 + self._jumped**2
        yaw = STILL[1] ** 2 + WALK[1] ** 2 * (step + turn) + (SHARE * turn) ** 2
        predicted: Floats = lever @ one.covariance @ lever.T + np.diag([place, place, yaw])
        if step > 0.0:  # The scale of wheels is wrong alike in all steps: along the way, deviations add up.
            ahead = np.array([way[0], way[1], 0.0]) / step
            before = math.sqrt(max(0.0, float(ahead @ one.covariance @ ahead)))
            predicted += 2.0 * before * SHARE * step * np.outer(ahead, ahead)
        return predicted

    def _match(
        self, ends: Floats, guess: Floats, window: tuple[float, float], prior: Floats | None = None
    ) -> Any:
        """The best pose of a small window, by the covariance of its middle if there is one."""
        if prior is None:  # Anywhere in the window.
            prior = np.diag([window[0] ** 2 / 3, window[0] ** 2 / 3, window[1] ** 2 / 3])
        information = np.linalg.inv(prior)
        information = 0.5 * (information + information.T)
        return self._matcher.match(
            ends, guess, window=(window[0], window[0], window[1]), information=information, second=False
        )


def told_by(
    guess: Floats, prior: Floats, pose: Floats, covariance: Floats, likelihood: Callable[[Floats], float]
) -> tuple[Floats, Floats]:
    """A pose and its covariance without what a scan says by chance.

    What scans from about one place say wrongly, all say alike: it is no knowledge, however many they are. So
    directions in which one scan leaves more than half of the prior's variance keep the prior's mean and
    variance; and so do those that are open beforehand, if poses three standard deviations away are about as
    likely.

    Parameters
    ----------
    guess, prior : (3, 3) float64
        The pose and its covariance before the scan.
    pose, covariance : (3, 3) float64
        The same with it.
    likelihood : callable
        Of the scan's beams at a pose, as a logarithm.
    """
    root = np.linalg.cholesky(prior)
    inward = np.linalg.inv(root)
    left, axes = np.linalg.eigh(inward @ covariance @ inward.T)
    is_open = left > 0.5
    outward = root @ axes
    for k in range(3):
        sigma = math.hypot(*outward[:2, k])
        if not is_open[k] and sigma > PROBED:
            off = max(3.0 * math.sqrt(left[k]), TELLS / sigma) * outward[:, k]
            beside = max(likelihood(shifted(pose, off)), likelihood(shifted(pose, -off)))
            is_open[k] = beside > likelihood(pose) - FLAT
    if not is_open.any():
        return pose, covariance
    turn = pose[:2, :2] @ guess[:2, :2].T
    moved = np.array([*(pose - guess)[:2, 2], math.atan2(turn[1, 0], turn[0, 0])])
    kept = outward @ np.where(is_open, 0.0, axes.T @ inward @ moved)
    return shifted(guess, kept), outward @ np.diag(np.where(is_open, 1.0, left)) @ outward.T


def shifted(pose: Floats, motion: Floats) -> Floats:
    """A pose moved by x, y and turned by yaw, along and about the map's axes."""
    c, s = math.cos(motion[2]), math.sin(motion[2])
    result = pose.copy()
    result[:2, :2] = np.array([[c, -s], [s, c]]) @ pose[:2, :2]
    result[:2, 2] += motion[:2]
    return result


def matrix_of(pose: ArrayLike) -> Floats:
    """(3, 3) of x, y and yaw, or of a matrix; ValueError if it is no pose."""
    return pose_matrix(pose, dim=2)


def place_of(text: str) -> Floats:
    """Of X,Y,YAW; ValueError says what is wrong."""
    try:
        place = np.array([float(one) for one in text.split(",")])
    except ValueError:
        place = np.zeros(0)
    if place.shape != (3,) or not np.isfinite(place).all():
        raise ValueError(f"guess = {text}: must be X,Y,YAW in m and rad")
    return place


def quaternion_of(pose: Floats) -> tuple[float, float, float, float]:
    """x, y, z and w of the turn of a (3, 3) pose in the plane."""
    half = 0.5 * math.atan2(pose[1, 0], pose[0, 0])
    return 0.0, 0.0, math.sin(half), math.cos(half)


def inverse(pose: Floats) -> Floats:
    """Of a rigid motion of the plane."""
    back = np.eye(3)
    back[:2, :2] = pose[:2, :2].T
    back[:2, 2] = -pose[:2, :2].T @ pose[:2, 2]
    return back


def _stride(ends: Floats, most: int) -> int:
    return max(-(-len(ends) // most), 1)
