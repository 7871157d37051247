# SPDX-License-Identifier: BSD-3-Clause
"""Where a robot is in a saved map, scan by scan, from odometry and what its scans see.

Strategy: odometry predicts the pose of a scan, a small window around it is searched by `Matcher`, and what is
found corrects the transform from the map to the odometry's frame. A scan that fits nowhere in its window is
not believed: the pose goes on by odometry, and the next window is wider. After several in a row the robot is
lost: the windows grow from scan to scan up to all of the map, and a pose counts only if no other fits nearly
as well, and if the scans after it fit there, too.

Invariants: a pose is told only while the robot is not lost; the same scans give the same poses. Cost: some
milliseconds a scan while it is tracked, and for a lost one what `Matcher` takes for the window.
"""

from __future__ import annotations

import math
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

#: Window around the predicted pose: least [m, rad], and a share of what odometry moved since the last match.
LEAST, SHARE = (0.15, 0.06), 0.1
#: Standard deviation of what odometry predicts [m, rad], beside that share: along a corridor, where a scan
#: tells little, odometry counts.
SIGMA = 0.02, 0.01
#: If nothing fits there, a larger window is searched, which grows by this factor from scan to scan up to this
#: [m, rad]. What is found in it counts if its score is larger by that factor.
GROWS, WIDEST, BETTER = 1.5, (1.0, 0.5), 1.15
#: Scans in a row that do not fit: then it is lost. And that fit: then it is found.
LOSES, FINDS = 5, 4
#: The first window of a lost robot [m], which doubles with each scan that is not found.
LOST_WINDOW = 2.0
#: Points that are matched at most, of a scan while it is tracked, and while it is lost.
TRACKED, LOST = 400, 90
#: A lost robot is looked for on a grid this much coarser than the map's smallest cells; then on the fine one,
#: in a window of this number of the coarse grid's steps, and turned by this [rad].
COARSER, STEPS, TURN = 4.0, 2.0, 0.15
#: A pose counts for a lost one if another one has no larger share of its score on the coarse grid.
UNIQUE = 0.95
#: A scan fits where its score is at least this, and this share of its points lies on surfaces.
SCORE, INLIERS = 0.5, 0.5


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
        self._reach = self._half if guess is None else LOST_WINDOW
        self._covariance: Floats = np.zeros((3, 3))

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
        return match.score >= self._score and match.inliers >= self._inliers

    def _follow(self, ends: Floats, at: Floats) -> Any:
        """A scan near where odometry has it."""
        moved = inverse(self._matched) @ at if self._matched is not None else np.eye(3)
        step, turn = float(np.hypot(*moved[:2, 2])), abs(math.atan2(moved[1, 0], moved[0, 0]))
        near = [one + SHARE * by for one, by in zip(LEAST, (step, turn))]
        sigmas = [one + SHARE * by for one, by in zip(SIGMA, (step, turn))]
        match = self._match(ends, self._map_odometry @ at, near, sigmas)
        is_guess = self._matched is None  # A guess is rough.
        if match is not None and (is_guess or not self._fits(match)):
            grown = [min(one * GROWS ** (self._failed + 1), most) for one, most in zip(near, WIDEST)]
            wide = self._match(ends, self._map_odometry @ at, list(WIDEST) if is_guess else grown)
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

    def _search(self, ends: Floats, at: Floats) -> Any:
        """A scan of a lost robot: in a window that grows, anywhere in it, turned anyhow."""
        everywhere = self._reach >= self._half
        guess = self._map_odometry @ at
        if everywhere:
            guess = np.eye(3)
            guess[:2, 2] = self._center
        reach = min(self._reach, self._half)
        self._reach = min(2.0 * self._reach, self._half)
        few = ends[:: _stride(ends, LOST)]
        if len(few) < _LEAST_POINTS:
            return None
        found = self._coarse.match(few, guess, window=(reach, reach, math.pi), apart=2.0 * self._step)
        if found.second > UNIQUE * found.score:
            return found
        match = self._match(ends, np.asarray(found.pose), [STEPS * self._step, TURN])
        if match is not None and self._fits(match):
            self._take(match, at)
            self._found = 1
        return match

    def _match(
        self, ends: Floats, guess: Floats, window: list[float], sigmas: list[float] | None = None
    ) -> Any:
        """The best pose of a small window, with standard deviations of its middle [m, rad]."""
        few = ends[:: _stride(ends, TRACKED)]
        if len(few) < _LEAST_POINTS:
            return None
        information = None
        if sigmas:
            information = np.diag([sigmas[0] ** -2.0, sigmas[0] ** -2.0, sigmas[1] ** -2.0])
        return self._matcher.match(
            few, guess, window=(window[0], window[0], window[1]), information=information, second=False
        )

    def _take(self, match: Any, at: Floats) -> None:
        self._map_odometry = match.pose @ inverse(at)
        self._covariance = np.asarray(match.covariance)
        self._matched, self._failed = at, 0
        self.fitting += 1

    def _fail(self) -> None:
        self._failed += 1
        if self._found:  # It was not there.
            self._found = 0
            self._reach = self._half
        elif self._failed >= LOSES and not self.is_lost:
            self.is_lost, self._reach = True, LOST_WINDOW
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
