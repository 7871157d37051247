# SPDX-License-Identifier: BSD-3-Clause
"""What a map says of scans: where they fit, near a pose and everywhere, and how well beams agree with it.

In the plane a pose has x, y and yaw; in space, where gravity is known, x, y, z and yaw. Strategy in space:
scans are turned upright first. What stands upright, as walls, posts and trunks, tells the place, and is all
that counts as evidence, as floors fit everywhere; floors tell the height. All of a map is searched in the
plane, by what stands in it and in the scan; each pose found there is tried at all heights.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ndtree._native._core import Matcher, OccupancyMap, pose_matrix
from ndtree.alignment.planar import pose_of, yaw_of
from ndtree.live import hypotheses
from ndtree.live.hypotheses import Evidence, Floats

#: Points that are matched at most, of a scan while it is tracked, and in all of the map.
TRACKED, LOST = 400, 90
#: All of the map is searched on a grid this much coarser than its smallest cells; then on the fine one, in
#: a window of this number of the coarse grid's steps, and turned by this [rad]; of this number of poses.
COARSER, STEPS, TURN, MOST = 4.0, 2.0, 0.15, 8
#: Bricks of 8 cells on each axis that `Matcher` has at most.
MOST_BRICKS = 2**24
#: Modes of a scan are looked for up to this far from where it fits best [m], with this number of points.
ALIKE, MODES_OF = 1.0, 150
#: Of a scan in space, this share of points that do not stand upright, which tell its height.
FLAT = 0.25
#: Points over one another in a column of this width, none farther than this from the next, stand upright if
#: they are as tall as this [m].
COLUMN, GAP, TALL = 0.3, 1.0, 0.3
#: A robot that slips does not rise by more than this [m]; and how far gravity is off [rad].
RISES, TILT = 0.3, 0.01
#: Heights whose scores are at least this much of the best one's are tried.
AS_HIGH = 0.8
#: Freedoms of a pose in space, of those of `Match.covariance`.
_UPRIGHT = np.ix_((0, 1, 2, 5), (0, 1, 2, 5))


class Surroundings:
    """A 2-D map, which is not changed; `extent` (dim,) is that of what is occupied [m]."""

    dim = 2

    def __init__(self, m: OccupancyMap) -> None:
        surface = m.leaves(states=("occupied",))
        if not len(surface.size):
            raise ValueError("a map without occupied cells: there is nothing to be localised by")
        bounds = surface.lower.min(axis=0), (surface.lower + surface.size[:, None]).max(axis=0)
        self.extent: Floats = bounds[1] - bounds[0]
        self._middle: Floats = 0.5 * (bounds[0] + bounds[1])
        self._map, self._cell = m, m.min_cell_size
        self._noise = m.options["range_sigma"], m.options["range_sigma_quadratic"]
        self._grid = self._cell  # Of the matcher, which holds 350 MB at most: coarser in a large map.
        while np.prod(np.ceil((self.extent / self._grid + 12.0) / 8.0)) > MOST_BRICKS:
            self._grid *= 2.0
        self._step = COARSER * self._grid
        self._matcher: Matcher = m.matcher(cell_size=self._grid)
        self._coarse = self._searched(m, surface)

    def _searched(self, m: OccupancyMap, surface: Any) -> Matcher:
        return m.matcher(cell_size=self._step)

    def matrix_of(self, pose: ArrayLike) -> Floats:
        """Of x, y and yaw, or of a matrix; ValueError if it is no pose."""
        return pose_matrix(pose, dim=self.dim)

    def guess_of(self, guess: ArrayLike) -> Floats:
        """The pose that a guess of `Localizer` says; ValueError if it is none."""
        return self.matrix_of(guess)

    def heights(self, ends: Floats, pose: Floats) -> list[Floats]:
        """A guessed pose at each height where it may be, if that was not said; the likeliest first."""
        return [pose]

    def level(self, pose: Floats) -> Floats:
        """A pose without roll and pitch."""
        return pose

    def seen(self, points: ArrayLike, sensor: Floats) -> tuple[Floats, Floats]:
        """A sensor's pose without roll and pitch, and a scan's end points there, to be matched."""
        return sensor, thinned(self._finite(points), TRACKED)

    def _finite(self, points: ArrayLike) -> Floats:
        ends = np.asarray(points, dtype=np.float64)
        if ends.ndim != 2 or ends.shape[1] != self.dim:
            raise ValueError(f"points has shape {ends.shape}: must be (n, {self.dim})")
        return ends[np.isfinite(ends).all(axis=1)]

    def evidence(self, pose: Floats, ends: Floats) -> Evidence:
        """What a scan says for a pose."""
        return hypotheses.scan_evidence(self._map, self._noise, pose, ends)

    def pieces(self, ends: Floats) -> int:
        """Of surface that a scan sees."""
        return hypotheses.pieces_of(self._telling(ends))

    def _telling(self, ends: Floats) -> Floats:
        return ends

    def score(self, ends: Floats, pose: Floats) -> float:
        """How well end points fit, 0 to 1."""
        return self._matcher.score(ends[:, : self.dim], pose)

    def match(
        self, ends: Floats, guess: Floats, window: tuple[float, float], prior: Floats | None = None
    ) -> Any:
        """The best pose of a small window [m, rad], by the covariance of its middle if there is one."""
        if prior is None:  # Anywhere in the window.
            prior = np.diag([window[0] ** 2 / 3] * self.dim + [window[1] ** 2 / 3])
        information = np.linalg.inv(self._whole(prior))
        information = 0.5 * (information + information.T)
        return self._matcher.match(
            ends[:, : self.dim], guess, window=self._window(*window), information=information, second=False
        )

    def covariance(self, match: Any) -> Floats:
        """Of a match: of the freedoms of a pose."""
        return np.asarray(match.covariance)

    def _whole(self, prior: Floats) -> Floats:
        """As the matcher has it."""
        return prior

    def _window(self, half: float, turn: float) -> tuple[float, ...]:
        return half, half, turn

    def alike(self, ends: Floats, pose: Floats) -> Floats:
        """(2, 2) covariance of x and y of where a scan fits as well, around a pose."""
        few = self._telling(ends)[:, : self.dim]
        few = few[:: max(len(few) // MODES_OF, 1)]
        window = (ALIKE, ALIKE, *[0.0] * (self.dim - 1))
        match = self._matcher.match(few, pose, window=window, second=False)
        return np.asarray(match.covariance)[:2, :2]

    def near(self, ends: Floats, pose: Floats, half: float, turn: float) -> list[Floats]:
        """Poses in a window [m, rad] that explain a scan."""
        modes = self._matcher.modes(thinned(ends, LOST), pose, window=(half, half, turn), most=MOST)
        return [np.asarray(mode.pose) for mode in modes]

    def anywhere(self, ends: Floats) -> list[Any]:
        """Matches in all of the map."""
        window = (*np.full(2, 0.5 * float(self.extent[:2].max())), math.pi)
        middle = self.matrix_of([*self._middle, 0.0])
        few = thinned(ends, LOST)
        modes = self._coarse.modes(few, middle, window=window, apart=2.0 * self._step, most=MOST)
        near = STEPS * self._step, TURN
        return [self.match(ends, np.asarray(mode.pose), near) for mode in modes]


def thinned(ends: Floats, most: int) -> Floats:
    """End points at equal steps, at most a number."""
    return ends[:: max(-(-len(ends) // most), 1)]


class InSpace(Surroundings):
    """A 3-D map, whose z is up. End points are (n, 4): the last is 1 for one on what stands upright."""

    dim = 3

    _heading: int | None = None  # The sensor's axis whose direction from above is the yaw.

    def _searched(self, m: OccupancyMap, surface: Any) -> Matcher:
        """What stands in the map, from above."""
        cells = []
        for size in np.unique(surface.size):
            many = min(round(float(size / self._cell)), 8)
            offset = (
                (np.stack(np.meshgrid(*[np.arange(many)] * 3), axis=-1).reshape(-1, 3) + 0.5) * size / many
            )
            cells.append((surface.lower[surface.size == size][:, None] + offset).reshape(-1, 3))
        points = np.concatenate(cells)
        above = np.unique(np.floor(points[upright(points)][:, :2] / self._cell), axis=0)
        self._step = 0.5 * COARSER * self._grid
        return Matcher((above + 0.5) * self._cell, cell_size=self._step)

    def matrix_of(self, pose: ArrayLike) -> Floats:
        """Of x, y, z and yaw, or of a matrix, or as poses of maps; ValueError if it is no pose."""
        pose = np.asarray(pose, dtype=np.float64)
        if pose.shape != (4,):
            return pose_matrix(pose, dim=3)
        half = 0.5 * pose[3]
        return pose_matrix([*pose[:3], 0.0, 0.0, math.sin(half), math.cos(half)], dim=3)

    def guess_of(self, guess: ArrayLike) -> Floats:
        given = np.asarray(guess, dtype=np.float64)
        if given.shape != (3,):
            return self.matrix_of(given)
        pose = self.matrix_of([*given[:2], 0.0, given[2]])
        pose[2, 3] = math.nan
        return pose

    def level(self, pose: Floats) -> Floats:
        return self.matrix_of([*pose[:3, 3], yaw_of(pose)])

    def seen(self, points: ArrayLike, sensor: Floats) -> tuple[Floats, Floats]:
        if self._heading is None:  # x, unless it is steeper than 45 degrees.
            steep = np.abs(sensor[2, :3])
            self._heading = 0 if steep[0] < math.sqrt(0.5) else int(steep.argmin())
        yaw = math.atan2(sensor[1, self._heading], sensor[0, self._heading])
        at = self.matrix_of([*sensor[:3, 3], yaw])
        ends = self._finite(points) @ (at[:3, :3].T @ sensor[:3, :3]).T
        _, first = np.unique(np.floor(ends / hypotheses.PIECE) @ [1e12, 1e6, 1.0], return_index=True)
        ends = ends[np.sort(first)]
        stands = upright(ends)
        flat = thinned(ends[~stands], int(FLAT * TRACKED))
        stands = thinned(ends[stands], TRACKED - len(flat))
        whole = np.concatenate([np.c_[stands, np.ones(len(stands))], np.c_[flat, np.zeros(len(flat))]])
        return at, whole[np.random.default_rng(0).permutation(len(whole))]  # Any few of them are of both.

    def _telling(self, ends: Floats) -> Floats:
        return ends[ends[:, 3] > 0.0]

    def evidence(self, pose: Floats, ends: Floats) -> Evidence:
        ends = self._telling(ends)[:, :3]
        ranges = np.linalg.norm(ends, axis=1)
        begin = 2.0 * self._cell  # The sensor's own cell may be unknown.
        ends, ranges = ends[ranges > begin], ranges[ranges > begin]
        ahead = ends / ranges[:, None] @ pose[:3, :3].T
        cast = self._map.cast_rays(pose[:3, 3] + begin * ahead, ahead, unknown="stop", details=True)
        stops = np.where(np.isnan(cast.distance), np.inf, cast.distance + begin)
        off = self._off(pose[:3, 3] + ranges[:, None] * ahead)
        is_before, is_through = ranges + self._cell < stops, (cast.state == 1) & (stops + self._cell < ranges)
        # A ray that grazes a surface is at it from where it is ended to where it ends.
        for share in (0.25, 0.5, 0.75):
            way = (stops + share * (ranges - stops))[is_through]
            between = self._off(pose[:3, 3] + way[:, None] * ahead[is_through])
            off[is_through] = np.maximum(off[is_through], between)
        near = np.exp(
            -0.5 * np.square(off / np.hypot(0.5 * self._cell, self._noise[0] + self._noise[1] * ranges**2))
        )
        least = np.where(
            is_through, hypotheses.THROUGH, np.where(is_before, hypotheses.BEFORE, hypotheses.UNKNOWN)
        )
        is_known = (cast.state == 1) | (near > 0.5)
        return hypotheses.evidence_by(ends, np.log(least + (1.0 - least) * near), is_known)

    def _off(self, points: Floats) -> Floats:
        """How far points are from what is occupied, and half a cell around it [m]."""
        away = np.asarray(self._map.nearest_occupied(points, max_distance=1.0).distance)
        return np.maximum(np.minimum(away, 1.0) - 0.5 * self._cell, 0.0)

    def covariance(self, match: Any) -> Floats:
        return np.asarray(match.covariance)[_UPRIGHT]

    def match(
        self, ends: Floats, guess: Floats, window: tuple[float, float], prior: Floats | None = None
    ) -> Any:
        # A search of a wide window costs as much as it has heights more.
        few = ends if window[0] <= RISES else thinned(ends, MODES_OF)
        return super().match(few, guess, window, prior)

    def _whole(self, prior: Floats) -> Floats:
        whole = TILT**2 * np.eye(6)
        whole[_UPRIGHT] = prior
        return whole

    def _window(self, half: float, turn: float) -> tuple[float, ...]:
        return half, half, min(half, RISES), turn

    def near(self, ends: Floats, pose: Floats, half: float, turn: float) -> list[Floats]:
        return self._above(ends, pose, (half, half, turn))

    def _above(self, ends: Floats, pose: Floats, window: tuple[float, ...]) -> list[Floats]:
        """Poses in a window of x, y and yaw that explain a scan from above, at the height of a pose."""
        few = thinned(self._telling(ends), LOST)[:, :2]
        plane = pose_matrix([*pose[:2, 3], yaw_of(pose)], dim=2)
        modes = self._coarse.modes(few, plane, window=window, apart=2.0 * self._step, most=MOST)
        result = [self.guess_of(pose_of(np.asarray(mode.pose))) for mode in modes]
        for one in result:
            one[2, 3] = pose[2, 3]
        return result

    def anywhere(self, ends: Floats) -> list[Any]:
        half = 0.5 * float(self.extent[:2].max())
        middle = self.guess_of([*self._middle[:2], 0.0])
        near = STEPS * self._step, TURN
        poses = [
            one
            for pose in self._above(ends, middle, (half, half, math.pi))
            for one in self.heights(ends, pose)
        ]
        return [self.match(ends, one, near) for one in poses]

    def heights(self, ends: Floats, pose: Floats) -> list[Floats]:
        if math.isfinite(pose[2, 3]):
            return [pose]
        pose = pose.copy()
        pose[2, 3] = self._middle[2]
        window = (0.0, 0.0, 0.5 * self.extent[2] + GAP, 0.0)
        modes = self._matcher.modes(thinned(ends, LOST)[:, :3], pose, window=window, most=MOST)
        found = []
        for mode in modes:
            if mode.score >= AS_HIGH * modes[0].score:
                found.append(pose.copy())
                found[-1][2, 3] = np.asarray(mode.pose)[2, 3]
        return found


def upright(points: Floats) -> NDArray[np.bool_]:
    """(n,) which of points (n, 3) stand over one another: O(n log n)."""
    x, y = np.floor(points[:, :2] / COLUMN).astype(np.int64).T
    order = np.lexsort((points[:, 2], y, x))
    x, y, z = x[order], y[order], points[order, 2]
    is_next = (np.diff(x) == 0) & (np.diff(y) == 0) & (np.diff(z) <= GAP)
    chain = np.cumsum(np.r_[0, ~is_next])[: len(z)]
    first, last = np.searchsorted(chain, chain, "left"), np.searchsorted(chain, chain, "right") - 1
    stands = np.empty(len(z), dtype=np.bool_)
    stands[order] = z[last] - z[first] >= TALL
    return stands
