# SPDX-License-Identifier: BSD-3-Clause
"""Where a robot is in a saved map, scan by scan, from odometry and what its scans see.

Strategy: the posterior of the pose before, moved by odometry and widened by its noise, is the prior of a
scan. `Matcher` searches a window around it, and gives the next posterior: what scans do not tell, as the
way along a corridor, keeps odometry's mean, and a variance that grows with the way. A scan that fits
clearly worse than those before is not believed: the pose goes on by odometry. After several in a row the
robot is lost: it is looked for in all of the map, and a pose counts only if no other fits nearly as well,
if it fits as well as scans did before, or well, and if the scans after it fit there, too.

Invariants: a pose is told only while the robot is not lost; the same scans give the same poses. Cost: some
milliseconds a scan while it is tracked, and for a lost one what `Matcher` takes for the map.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ndtree._native._core import Matcher, OccupancyMap, pose_matrix

Floats = NDArray[np.float64]
#: The frame of odometry, unless another is said: scans are placed in it, and found in the map.
ODOMETRY = "odom"
#: A scan with fewer points says nothing.
_LEAST_POINTS = 10

#: Standard deviations of a guess of where it is [m, m, rad].
GUESS = 0.3, 0.3, 0.15
#: Window around the predicted pose, at least [m, rad]; else this number of its standard deviations.
LEAST, SIGMAS = (0.15, 0.06), 3.0
#: Standard deviations of odometry: at a standstill, by chance for a way of 1 m or a turn of 1 rad, where they
#: grow with its root [m, rad]; and as a share of what it moved since the last match.
STILL, WALK, SHARE = (0.005, 0.003), (0.06, 0.03), 0.1
#: A step this many times longer than the longest of the last STEPS_BEFORE, and this much [m], is a jump of
#: odometry: how far it went is open.
JUMP, JUMPS_BY, STEPS_BEFORE = 2.0, 0.2, 10
#: If nothing fits there, a larger window is searched, which grows by this factor from scan to scan up to this
#: [m, rad]. What is found in it counts if its score is larger by that factor.
GROWS, WIDEST, BETTER, CLEARLY = 1.5, (1.0, 0.5), 1.15, 1.03
#: Scans in a row that do not fit: then it is lost. And that fit: then it is found.
LOSES, FINDS = 5, 4
#: Points that are matched at most, of a scan while it is tracked, and while it is lost.
TRACKED, LOST = 400, 90
#: A lost robot is looked for on a grid this much coarser than the map's smallest cells; then on the fine one,
#: in a window of this number of the coarse grid's steps, and turned by this [rad].
COARSER, STEPS, TURN = 4.0, 2.0, 0.15
#: A pose counts for a lost one if another one has no larger share of its score on the coarse grid.
UNIQUE = 0.95
#: A scan fits where its score is at least this, and this share of its points lies on surfaces.
SCORE, INLIERS = 0.5, 0.5
#: And where both are at least this share of the medians of the last scans that fitted, at most this many; or,
#: where there were none, this share of its points lies on surfaces.
USUAL, REMEMBERED, UNSEEN = 0.85, 30, 0.85


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
    score, inliers : float
        What a scan must have to fit, as of `Match`.

    Attributes
    ----------
    is_lost : bool
    scans, fitting, times_lost : int
        Scans that came, that fitted, and how often the robot was lost.

    Raises
    ------
    ValueError
        If the map is not 2-D or has no occupied cells, or a number is out of its limits.
    """

    def __init__(
        self,
        m: OccupancyMap,
        guess: ArrayLike | None = None,
        *,
        score: float = SCORE,
        inliers: float = INLIERS,
    ) -> None:
        if m.dim != 2:
            raise ValueError(f"a map with dim = {m.dim}: must be 2 to be localised in")
        for name, value in (("score", score), ("inliers", inliers)):
            if not 0 <= value <= 1:
                raise ValueError(f"{name} = {value:g}: must be from 0 to 1")
        surface = m.leaves(states=("occupied",))
        if not len(surface.size):
            raise ValueError("a map without occupied cells: there is nothing to be localised by")
        bounds = surface.lower.min(axis=0), (surface.lower + surface.size[:, None]).max(axis=0)
        self._center = 0.5 * (bounds[0] + bounds[1])
        self._half = 0.5 * float(np.max(bounds[1] - bounds[0]))
        self._matcher: Matcher = m.matcher()
        self._coarse: Matcher = m.matcher(cell_size=COARSER * m.min_cell_size)
        self._step = COARSER * m.min_cell_size
        self._score, self._inliers = score, inliers
        self.is_lost = guess is None
        self.scans = self.fitting = self.times_lost = 0
        self._map_odometry: Floats = np.eye(3)
        self._guess = None if guess is None else matrix_of(guess)
        self._matched: Floats | None = None  # The odometry at the last match.
        self._failed = 0
        self._found = 0
        self._covariance: Floats = np.zeros((3, 3))
        self._before: Floats | None = None  # The odometry of the scan before.
        self._steps: deque[float] = deque(maxlen=STEPS_BEFORE)  # Of odometry [m].
        self._usual: deque[tuple[float, float]] = deque(maxlen=REMEMBERED)  # Scores and inliers that fitted.
        self._jumped = 0.0  # Of odometry, since the last match [m].

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
            self._map_odometry, self._guess = self._guess @ inverse(at), None
        self.scans += 1
        self._note(at)
        if self.is_lost and not self._found:
            match = self._search(ends, at)
        else:
            match = self._follow(ends, at)
        score, inliers = (match.score, match.inliers) if match is not None else (0.0, 0.0)
        return Localization(
            stamp,
            self.is_lost,
            self._map_odometry @ at,
            self._map_odometry @ (at if body is None else matrix_of(body)),
            self._map_odometry.copy(),
            self._covariance.copy(),
            score,
            inliers,
        )

    def _fits(self, match: Any) -> bool:
        least = [self._score, self._inliers]
        if self._usual:
            usual = USUAL * np.median(np.array(self._usual), axis=0)
            least = [max(one, float(by)) for one, by in zip(least, usual)]
        elif self.is_lost:
            least[1] = max(least[1], UNSEEN)
        return match.score >= least[0] and match.inliers >= least[1]

    def _follow(self, ends: Floats, at: Floats) -> Any:
        """A scan near where odometry has it."""
        guess = self._map_odometry @ at
        if self._matched is None:
            match = self._match(ends, guess, list(WIDEST), np.diag(np.square(GUESS)))
        else:
            prior = self._predicted(at)
            sigmas = np.sqrt(np.diag(prior))
            near = [max(LEAST[0], SIGMAS * max(sigmas[:2])), max(LEAST[1], SIGMAS * sigmas[2])]
            near = [min(one, most) for one, most in zip(near, WIDEST)]
            match = self._match(ends, guess, [0.0, 0.0], prior)
            found = self._match(ends, guess, near, prior)
            # Of flat likelihoods, the search gives any: it counts where it is clearly the better one.
            if match is not None and self._score_at(ends, found) > CLEARLY * self._score_at(ends, match):
                match = found
            if match is not None and not self._fits(match):
                grown = [min(one * GROWS ** (self._failed + 1), most) for one, most in zip(near, WIDEST)]
                wide = self._match(ends, guess, grown)
                match = wide if wide.score > BETTER * match.score else match
        if match is None or not self._fits(match):
            self._fail()
            return match
        self._take(match, at)
        if self._found:
            self._found += 1
            if self._found > FINDS:
                self._found, self.is_lost = 0, False
        return match

    def _note(self, at: Floats) -> None:
        """Remember how far odometry moved, and whether it jumped."""
        if self._before is not None:
            step = float(np.hypot(*(inverse(self._before) @ at)[:2, 2]))
            if self._steps and step > JUMP * max(self._steps) + JUMPS_BY:
                self._jumped += step
            else:
                self._steps.append(step)
        self._before = at

    def _predicted(self, at: Floats) -> Floats:
        """The covariance of where odometry has the sensor, by that of the last match."""
        assert self._matched is not None
        moved = inverse(self._matched) @ at
        step, turn = float(np.hypot(*moved[:2, 2])), abs(math.atan2(moved[1, 0], moved[0, 0]))
        way = (self._map_odometry @ at - self._map_odometry @ self._matched)[:2, 2]
        lever = np.eye(3)
        lever[:2, 2] = -way[1], way[0]
        place = STILL[0] ** 2 + WALK[0] ** 2 * step + (SHARE * step) ** 2 + self._jumped**2
        yaw = STILL[1] ** 2 + WALK[1] ** 2 * (step + turn) + (SHARE * turn) ** 2
        predicted: Floats = lever @ self._covariance @ lever.T + np.diag([place, place, yaw])
        if step > 0.0:  # The scale of wheels is wrong alike in all steps: along the way, deviations add up.
            ahead = np.array([way[0], way[1], 0.0]) / step
            before = math.sqrt(max(0.0, float(ahead @ self._covariance @ ahead)))
            predicted += 2.0 * before * SHARE * step * np.outer(ahead, ahead)
        return predicted

    def _search(self, ends: Floats, at: Floats) -> Any:
        """A scan of a lost robot: anywhere in the map, turned anyhow."""
        guess = np.eye(3)
        guess[:2, 2] = self._center
        few = ends[:: _stride(ends, LOST)]
        if len(few) < _LEAST_POINTS:
            return None
        window = (self._half, self._half, math.pi)
        found = self._coarse.match(few, guess, window=window, apart=2.0 * self._step)
        if found.second > UNIQUE * found.score:
            return found
        match = self._match(ends, np.asarray(found.pose), [STEPS * self._step, TURN])
        if match is not None and self._fits(match):
            self._take(match, at)
            self._found = 1
        return match

    def _match(self, ends: Floats, guess: Floats, window: list[float], prior: Floats | None = None) -> Any:
        """The best pose of a small window, by the covariance of its middle if there is one."""
        few = ends[:: _stride(ends, TRACKED)]
        if len(few) < _LEAST_POINTS:
            return None
        if prior is None:  # Anywhere in the window.
            prior = np.diag([window[0] ** 2 / 3, window[0] ** 2 / 3, window[1] ** 2 / 3])
        information = np.linalg.inv(prior)
        information = 0.5 * (information + information.T)
        return self._matcher.match(
            few, guess, window=(window[0], window[0], window[1]), information=information, second=False
        )

    def _score_at(self, ends: Floats, match: Any) -> float:
        """Of the refined pose."""
        here = self._match(ends, np.asarray(match.pose), [0.0, 0.0], np.diag(np.square(GUESS)))
        return 0.0 if here is None else float(here.score)

    def _take(self, match: Any, at: Floats) -> None:
        self._map_odometry = match.pose @ inverse(at)
        self._covariance = np.asarray(match.covariance)
        self._matched, self._failed, self._jumped = at, 0, 0.0
        if not self.is_lost:
            self._usual.append((match.score, match.inliers))
        self.fitting += 1

    def _fail(self) -> None:
        self._failed += 1
        if self._found:  # It was not there.
            self._found = 0
        elif self._failed >= LOSES and not self.is_lost:
            self.is_lost = True
            self.times_lost += 1


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
