# SPDX-License-Identifier: BSD-3-Clause
"""Where a robot is in a saved map, scan by scan, from odometry and what its scans see.

Strategy: hypotheses, each a normal distribution of the pose. Odometry moves them and widens them by its
noise; `Matcher` searches a window around each, and gives the next posterior: what scans do not tell, as the
way along a corridor, keeps odometry's mean, and a variance that grows with the way. `Surroundings` compares
the beams with where the map ends them, and `leads` weighs hypotheses by that and by how a robot moves. While
one is left, and scans fit it as those before did, that is where the robot is. A scan that fits clearly worse,
or tells a place that odometry had left open, asks for others: near, and in all of the map. A pose is told
again when one explains all that was seen since then, and none that is elsewhere does nearly.

Invariants: a pose is told only while the robot is not lost; the same scans give the same poses. Cost: some
milliseconds a scan while it is tracked, and for a lost one what `Matcher` takes for the map.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ndtree._native._core import OccupancyMap
from ndtree.alignment.planar import yaw_of
from ndtree.base.words import numbers_in
from ndtree.live.following import GUESS, LEAST, WIDEST, Follower, inverse
from ndtree.live.hypotheses import (
    NOT_HERE,
    Evidence,
    Floats,
    Hypothesis,
    Prior,
    Viewpoint,
    leads,
    lengths_of,
    motion_between,
)
from ndtree.live.surroundings import MOST, InSpace, Surroundings
from ndtree.logs.poses.pose import quaternions_of

#: A hypothesis, a scan's match near it, and what the scan says for it.
_Said = tuple[Hypothesis, Any, Evidence]
#: The frame of odometry, unless another is said: scans are placed in it, and found in the map.
ODOMETRY = "odom"
#: A scan with fewer points says nothing.
_LEAST_POINTS = 10

#: Scans in a row that do not fit: then it is lost. And that fit: then it is found.
LOSES, FINDS = 5, 4
#: A scan fits that is likelier in the map than out of it, or whose mean log-likelihood is no more than
#: this below the median of the last scans that fitted, at most this number of them.
WORSE, REMEMBERED = 0.3, 30
#: Others are asked for where a scan's log-likelihood is this much below the usual, or its score this much;
#: after a search without success not for twice as many scans as before it, at most for this number.
ASKS, USUAL, RESTS = 8.0, 0.93, 16
#: How much likelier a hypothesis must be than all others, in logarithms: one in a thousand is wrong. With
#: less than the second number the robot is lost; with more than the third the less likely is forgotten.
CERTAIN, DOUBTS, FORGETS = 7.0, 4.0, 15.0
#: Fraction of beams that end where the map is known, of a pose that may be another one.
LEAST_KNOWN = 0.5
#: Logarithm of how many poses there are in a map, of which any may fit by chance.
ANYWHERE = 14.0
#: A viewpoint begins after a way [m] or a turn [rad]. A robot that was never found is found after this
#: number of viewpoints, if their mean log-likelihood is at least this, and the last one's; or where it
#: stands, after this number of scans that are at least this likely.
ANEW, VIEWPOINTS, KNOWN, STANDS, WELL = (0.25, 0.25), 8, -0.3, 10, -0.1


@dataclass(frozen=True, eq=False)
class Localization:
    """Where a robot is; poses and covariance are (dim + 1, dim + 1) float64.

    `body`: Of the robot in the map, as far as it was told where the sensor is on it; else the sensor's.
    `map_odometry`: The odometry's frame in the map: what a robot publishes.
    `covariance`: Of x, y, in space z, and yaw of the pose [m, rad].
    `score`, `inliers`: As of `Match`; of a scan that was not matched 0.
    """

    stamp: float  # Of the scan [s].
    is_lost: bool  # Nothing is known then, and the rest is the last that was.
    pose: Floats  # Of the sensor in the map.
    body: Floats
    map_odometry: Floats
    covariance: Floats
    score: float
    inliers: float


class Localizer:
    """Tracks a sensor in a map, says when it is lost, and finds it again.

    `m`: 2-D, or 3-D with -z along gravity; it is not changed.
    `guess` (3,) or (4,): Where the sensor is at the first scan: x, y and yaw, or x, y, z and yaw; left out,
        it is looked for in all of the map. In a 3-D map without z, at all heights. The yaw is that of the
        sensor's x axis; if that is steeper than 45 degrees at the first scan, of its most level one.
    Attributes:
    `is_lost`: Also until a scan fits at the guess.
    `scans`, `fitting`, `times_lost`: Scans that came, that fitted, and how often the robot was lost.
    Raises ValueError if the map is neither 2-D nor 3-D, or has no occupied cells.
    """

    def __init__(self, m: OccupancyMap, guess: ArrayLike | None = None) -> None:
        if m.dim not in (2, 3):
            raise ValueError(f"a map with dim = {m.dim}: must be 2 or 3 to be localised in")
        self.dim = m.dim
        self._around = Surroundings(m) if m.dim == 2 else InSpace(m)
        self._extent = self._around.extent
        self._follower = Follower(self._around)
        self._is_lost, self._is_doubted = guess is None, guess is not None
        self.scans = self.fitting = self.times_lost = 0
        self._guess = None if guess is None else self._around.guess_of(guess)
        self._told = self._guessed(np.eye(m.dim + 1))  # The last that was likeliest.
        self._hypotheses: list[Hypothesis] = []
        self._heights: list[Hypothesis] = []  # Hypotheses of a guess without a height: one is right.
        self._viewpoints: list[Viewpoint] = []  # Since it is not sure which.
        self._prior: Prior | None = None  # Where it may have been when it was not sure; None: anywhere.
        self._usual: deque[tuple[float, float]] = deque(maxlen=REMEMBERED)  # Means and scores that fitted.
        self._rests = self._rested = 0  # Scans until others may be asked for.

    @property
    def is_lost(self) -> bool:
        return self._is_lost or self._is_doubted

    def track(
        self, points: ArrayLike, odometry: ArrayLike, stamp: float = 0.0, *, body: ArrayLike | None = None
    ) -> Localization:
        """Take a scan.

        `points` (n, dim): End points on surfaces, in the sensor's frame [m]; those that are not finite say
            nothing.
        `odometry` (3,) or (3, 3); in space (4,) or (4, 4): The sensor in the odometry's frame, whose z is up
            in space: x, y, there z, and yaw, or a matrix.
        `stamp`: [s]
        `body`: The same of the robot; else of the sensor.
        """
        around, sensor = self._around, self._around.matrix_of(odometry)
        at, ends = around.seen(points, sensor)
        has_points = len(ends) >= _LEAST_POINTS
        waits = self._guess is not None and not has_points  # For points that tell a height.
        if self._guess is not None and not waits:
            poses, self._guess = around.heights(ends, self._guess), None
            self._hypotheses = [self._guessed(pose @ inverse(at)) for pose in poses]
            self._heights = self._hypotheses if len(poses) > 1 else []
            if self._hypotheses:
                self._told = self._hypotheses[0]
            else:
                self._lose()
        self.scans += 1
        self._follower.note(at)
        match = self._weigh(ends, at) if has_points else None
        if match is None and not waits:
            self._miss()
        told, here = self._told, self._told.map_odometry
        is_matched = told.matched is None or told.matched is at
        covariance = told.covariance if is_matched else self._follower.predicted(told, at)
        return Localization(
            stamp,
            self.is_lost,
            here @ sensor,
            here @ (sensor if body is None else around.matrix_of(body)),
            here.copy(),
            told.told_covariance(self._extent, covariance),
            0.0 if match is None else float(match.score),
            0.0 if match is None else float(match.inliers),
        )

    def _guessed(self, map_odometry: Floats) -> Hypothesis:
        dim = len(map_odometry) - 1
        return Hypothesis(map_odometry, np.diag(np.square([GUESS[0]] * dim + [GUESS[1]])))

    def _weigh(self, ends: Floats, at: Floats) -> Any:
        """Move all hypotheses to where the scan has them, look for others, judge; the likeliest's match."""
        said: list[_Said] = []
        narrowed = False
        if not self._is_lost and not self._viewpoints:
            self._prior = self._follower.prior(self._told, self._extent, at)
        for one in self._hypotheses:
            match, evidence, was_open = self._follower.follow(one, ends, at, self._fits)
            said.append((one, match, evidence))
            narrowed = narrowed or (was_open and one is self._told)
        said = _apart(said, at)
        if self._is_lost or self._viewpoints:
            self._see(ends, at, [(one, evidence) for one, _, evidence in said])
        elif said and (narrowed or self._heights or self._is_odd(said[0][2], said[0][1].score)):
            self._viewpoints = [Viewpoint(at, ends, said[0][2].pieces)]
            self._told.prior = self._prior_of(self._told, at)
            for one, _, evidence in said:
                one.see(evidence, is_new=True)
            self._rests = 0 if narrowed or self._told.failed else self._rests
        if self._viewpoints:
            said += self._ask(ends, at)
        said = [one for one in said if one[0].failed < LOSES]
        if not said:
            self._hypotheses = []
            return None
        likelier = leads([one for one, _, _ in said], [view.pieces for view in self._viewpoints])
        first = int(likelier.min(axis=1).argmax())
        best, match, evidence = said[first]
        elsewhere = [
            float(by)
            for (one, _, _), by in zip(said, likelier[first])
            if not best.tells(one, at, self._extent)
        ]
        lead = min(elsewhere, default=math.inf)
        self._hypotheses = [one for (one, _, _), by in zip(said, likelier[first]) if by <= FORGETS]
        self._judge(best, lead, self._is_odd(evidence, match.score))
        self._is_doubted = self._is_doubted and not self._is_lost and (best.failed > 0 or lead < CERTAIN)
        if best.failed == 0 and not self._is_lost and lead >= CERTAIN and best is self._told:
            self._usual.append((evidence.mean, match.score))
        return match

    def _judge(self, best: Hypothesis, lead: float, is_odd: bool) -> None:
        """Whether the likeliest is where the robot is."""
        if best.failed == 0:
            self.fitting += 1
            self._follower.jumped = 0.0
        if not self._is_lost and any(self._is_near(one, best) for one in self._heights):
            self._told = best
            if best.failed == 0 and lead >= CERTAIN:
                self._settle(best)
        elif self._is_lost:
            self._told = best
            if lead >= CERTAIN and self._is_found(best):
                self._is_lost = False
                self._settle(best)
        elif lead < DOUBTS:
            self._lose()
        elif best is not self._told:
            if best.failed == 0 and (lead >= CERTAIN and self._is_near(self._told, best)):
                self._settle(best)
            elif not self._told.tells(best, self._follower.before, self._extent):
                self._lose()
        elif self._viewpoints and best.failed == 0 and lead >= CERTAIN and not is_odd:
            self._settle(best)

    def _prior_of(self, one: Hypothesis, at: Floats) -> float:
        return 0.0 if self._prior is None else self._prior.of(one.map_odometry, at)

    def _is_near(self, one: Hypothesis, other: Hypothesis) -> bool:
        """Whether the robot may have moved from one to another by itself."""
        assert self._follower.before is not None
        way, turn = lengths_of(one.away(other, self._follower.before))
        return way < WIDEST[0] and turn < WIDEST[1]

    def _is_found(self, one: Hypothesis) -> bool:
        """Whether enough was seen from where a hypothesis has the lost robot."""
        count = sum(one.scans)
        pieces = [view.pieces for view in self._viewpoints]
        least = CERTAIN if self._usual else ANYWHERE
        if one.failed or one.untold or count <= FINDS or one.likely < NOT_HERE * sum(pieces) + least:
            return False
        if self._usual:
            return True
        means = [float(seen.sum()) / max(many, 1) for seen, many in zip(one.seen, pieces)]
        if one.likely < KNOWN * sum(pieces) or means[-1] < KNOWN:
            return False
        return len(means) >= VIEWPOINTS or (count >= STANDS and min(means) >= WELL)

    def _settle(self, one: Hypothesis) -> None:
        one.prior, one.seen, one.scans = 0.0, [], []
        self._hypotheses, self._viewpoints, self._heights = [one], [], []
        self._told = one

    def _lose(self) -> None:
        self._is_lost, self._heights = True, []
        self.times_lost += 1
        self._rests = self._rested = 0

    def _miss(self) -> None:
        """A scan that fits no hypothesis, or says nothing."""
        for one in self._hypotheses:
            one.failed += 1
        if not self._is_lost and all(one.failed >= LOSES for one in self._hypotheses):
            self._lose()

    def _is_odd(self, evidence: Evidence, score: float) -> bool:
        usual, usual_score = self._median()
        return (usual - evidence.mean) * evidence.pieces > ASKS or score < USUAL * usual_score

    def _fits(self, evidence: Evidence) -> bool:
        if self._is_doubted and evidence.known < LEAST_KNOWN:
            return False
        return evidence.mean >= (NOT_HERE if self._is_doubted else min(self._median()[0] - WORSE, NOT_HERE))

    def _median(self) -> tuple[float, float]:
        """Of the mean log-likelihoods and scores of scans that fitted."""
        if not self._usual:
            return NOT_HERE, 0.0
        mean, score = np.median(np.array(self._usual), axis=0)
        return float(mean), float(score)

    def _see(self, ends: Floats, at: Floats, said: list[tuple[Hypothesis, Evidence]]) -> None:
        """Note what was seen, at the last viewpoint or a new one."""
        step, turn = lengths_of(motion_between(self._viewpoints[-1].odometry if self._viewpoints else at, at))
        is_new = not self._viewpoints or step > ANEW[0] or turn > ANEW[1]
        if is_new:
            self._viewpoints.append(Viewpoint(at, ends, self._around.pieces(ends)))
            self._rests = 0 if self._is_lost else self._rests
        for one, evidence in said:
            one.see(evidence, is_new=is_new)
        if len(self._viewpoints) > MOST:
            del self._viewpoints[0]
            for one, _ in said:
                del one.seen[0], one.scans[0]

    def _ask(self, ends: Floats, at: Floats) -> list[_Said]:
        """Other hypotheses, near and in all of the map, that explain the scan."""
        self._rests -= 1
        is_due = self._rests < 0
        slipped = self._told if self._told in self._hypotheses and self._told.failed else None
        new: list[_Said] = []
        others = self._near(ends, at) if self._hypotheses and (is_due or slipped) else []
        nearby = len(others)
        others += self._around.anywhere(ends) if is_due else []
        for i, match in enumerate(others):
            pose = self._around.level(match.pose)
            one = Hypothesis(pose @ inverse(at), self._around.covariance(match), at, untold=1)
            known = [other for other in self._hypotheses if not other.failed] + [other for other, _, _ in new]
            if any(other.is_same(one, at) for other in known):
                continue
            evidence = self._around.evidence(pose, ends)
            if not self._fits(evidence) or evidence.known < LEAST_KNOWN:
                continue
            for view in self._viewpoints[:-1]:
                before = self._around.evidence(one.map_odometry @ view.odometry, view.ends)
                one.see(before, is_new=True)
            one.prior = self._prior_of(one, at)
            if slipped is not None and i < nearby:  # Just now, or before all viewpoints.
                one.inherit(slipped, self._follower.prior(slipped, self._extent, at).of(one.map_odometry, at))
            one.see(evidence, is_new=True)
            new.append((one, match, evidence))
        if not is_due:
            return new
        self._rested = min(2 * self._rested + 1, RESTS) if not new else 1
        self._rests = LOSES if self._is_lost else self._rested
        return new

    def _near(self, ends: Floats, at: Floats) -> list[Any]:
        near, around = self._told.map_odometry @ at, self._around
        poses = around.near(ends, near, 2.0 * WIDEST[0], WIDEST[1])
        return [around.match(ends, near, WIDEST), *(around.match(ends, pose, LEAST) for pose in poses)]


def place_of(text: str, dim: int = 2) -> Floats:
    """Of X,Y,YAW, or in space also of X,Y,Z,YAW; ValueError says what is wrong."""
    forms = {3: "X,Y,YAW", 4: "X,Y,Z,YAW"} if dim == 3 else {3: "X,Y,YAW"}
    place = np.array(numbers_in(text))
    if len(place) not in forms or not np.isfinite(place).all():
        raise ValueError(f"guess = {text}: must be {' or '.join(forms.values())} in m and rad")
    return place


def quaternion_of(pose: Floats) -> tuple[float, float, float, float]:
    """x, y, z and w of the turn of a pose in the plane or in space."""
    if len(pose) == 3:
        return quaternion_of_yaw(yaw_of(pose))
    x, y, z, w = quaternions_of(pose[None, :3, :3])[0].tolist()
    return x, y, z, w


def quaternion_of_yaw(yaw: float) -> tuple[float, float, float, float]:
    """x, y, z and w of a turn about z [rad]."""
    return 0.0, 0.0, math.sin(0.5 * yaw), math.cos(0.5 * yaw)


def _apart(said: list[_Said], at: Floats) -> list[_Said]:
    """Of hypotheses that scans moved to one pose the likeliest."""
    kept: list[_Said] = []
    for one in sorted(said, key=lambda one: -one[0].weight):
        if not any(other.is_same(one[0], at) for other, _, _ in kept):
            kept.append(one)
    return kept
