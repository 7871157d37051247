# SPDX-License-Identifier: BSD-3-Clause
"""Places that a 3-D lidar sees again, and poses that fit all of them.

Strategy: around key scans, at equal distances on the path, scans make local maps. Each is looked for in older
ones that may be near: by its flat patches, from where the poses have it and from around there as far as they
may have drifted, and then by GICP (small_gicp). It counts if the drift allows it, and if the end points of
neither lie where the other saw through. The pose graph has a robust kernel, as in the plane, and is solved
whenever a place is found, so that the next are nearer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ndtree._lazy import needs
from ndtree._native import _core
from ndtree.alignment.patches import Patches, covariance_of
from ndtree.alignment.planar import Floats
from ndtree.base.progress import Progress, no_progress

_FAR = 0.9  # This fraction of the points is nearer than the reach of a sensor.
_EVERY = (3.0, 15.0)  # Between key scans: half of the reach, in these bounds [m].
_CELL = (0.1, 0.5)  # Of maps from above: a hundredth of the reach, in these bounds [m].
_SCANS = 40  # Of a local map, at most, evenly spread.
_APART = 3  # Key scans nearer on the path than this see the same anyway.
_MOST = 3  # Of the older local maps that may be near, the nearest are looked at.
_BASIN = 2.0  # Patches find their places from so near [m];
_LARGEST = 6.0  # no farther than this from where the poses have it, a local map is looked for [m].
_DRIFT, _DRIFT_ANGLE = (0.5, 0.02), (0.1, 0.003)  # What odometry may be wrong by: at once, and for a way.
_FEWEST, _AGREE = 200, 0.9  # Points that were compared, and the fraction that must not be seen through,
_THROUGH = 0.2  # as those are in cells that are occupied with less than this probability.
_STEP, _STEP_ANGLE = (0.02, 0.01), (0.002, 5e-4)  # Deviation of odometry: at once, and for a way.
_LEAST, _LEAST_ANGLE = 0.05, 0.003  # And of a loop [m, rad]; added is what GICP tells,
_INDEPENDENT = 100.0  # as if this many of its points were independent.
_KERNEL = 3.0  # Deviations from which on a loop counts half and less,
_CONTRADICTED = 0.2  # its weight where the others contradict it.
_ROUNDS = 10  # Of weighing.


@dataclass(frozen=True)
class SpatialLoop:
    """A place that was seen again: the pose of a newer key scan (4, 4) seen from an older one."""

    older: int
    newer: int
    relation: Floats
    root: Floats  # Of its information (6, 6): of the translation [1/m], then of the rotation [1/rad].
    is_told: bool  # Whether flat surfaces tell it, in all directions.


@dataclass
class SpatialGraph:
    """Key scans of a drive and relations between their poses.

    `poses` (n, 4, 4) float64: Of all scans, each as it was matched with those before.
    `points`: End points of each scan, as its sensor sees them [m].
    `untold` (n, 3, 3) float64: Covariance of each scan's place in what was seen shortly before, where that
        does not tell it; else 0 [m²].
    """

    poses: Floats
    points: Sequence[Any]
    untold: Floats
    loops: list[SpatialLoop] = field(default_factory=list)
    tested: int = 0  # Pairs of local maps that were looked at.

    def __post_init__(self) -> None:
        steps = np.linalg.norm(np.diff(self.poses[:, :3, 3], axis=0), axis=1)
        self._way = np.concatenate([[0.0], np.cumsum(steps)])
        some = np.concatenate([one[:: max(1, len(one) // 50)] for one in self.points])
        reach = float(np.quantile(np.linalg.norm(some, axis=1), _FAR)) if len(some) else 0.0
        self._every, self._cell = np.clip(reach / 2, *_EVERY), float(np.clip(reach / 100, *_CELL))
        numbers = np.floor(self._way / self._every)
        self.keys = np.flatnonzero(np.diff(numbers, prepend=-1.0) > 0)
        self._weights = np.zeros(0)
        self._matched = self.poses

    def close(self, progress: Progress = no_progress) -> None:
        """Look for all local maps in older ones, and move the poses to where all relations fit best."""
        from small_gicp import voxelgrid_sampling

        maps: list[tuple[Any, Patches]] = []  # Points of local maps, and their flat patches.
        for newer in range(len(self.keys)):
            points = voxelgrid_sampling(self._around(newer), self._cell / 2).points()[:, :3]
            maps.append((points, Patches.of([points])))
            candidates, before = self._candidates(newer), len(self.loops)
            for older in candidates:
                self._test(maps, older, newer, is_wide=False)
            if len(self.loops) == before and candidates:
                self._test(maps, candidates[0], newer, is_wide=True)
            if len(self.loops) > before:
                self._solve()
            progress("closing loops", newer + 1, len(self.keys))

    def _candidates(self, newer: int) -> list[int]:
        """Older key scans that may be near, the nearest first."""
        places = self.poses[self.keys, :3, 3]
        older = np.arange(max(0, newer - _APART + 1))
        away = np.linalg.norm(places[older] - places[newer], axis=1)
        ways = self._way[self.keys[newer]] - self._way[self.keys[older]]
        near = away < self._every + np.minimum(_DRIFT[0] + _DRIFT[1] * ways, _LARGEST)
        order = np.argsort(away[near], kind="stable")[:_MOST]
        return [int(one) for one in older[near][order]]

    @property
    def contradicted(self) -> int:
        """Loops that others contradict, and that hardly count."""
        return int(np.count_nonzero(self._weights < _CONTRADICTED))

    def _test(self, maps: Sequence[tuple[Any, Patches]], older: int, newer: int, *, is_wide: bool) -> None:
        """Add a loop if it is surely one: where the poses have it, or as far as they may have drifted."""
        from small_gicp import align

        self.tested += not is_wide
        a, b = self.keys[older], self.keys[newer]
        by_poses = np.linalg.inv(self.poses[a]) @ self.poses[b]
        way = self._way[b] - self._way[a]
        (points, one), (others, other) = maps[older], maps[newer]
        begins = _around_guess(by_poses, way) if is_wide else [by_poses]
        guesses = [one.matched(other, begin)[0] for begin in begins]
        guess = max(guesses, key=lambda at: one.agreement(other, at))
        found = align(
            points, others, guess, downsampling_resolution=self._cell,
            max_correspondence_distance=4 * self._cell, num_threads=1,
        )  # fmt: skip
        relation = np.array(found.T_target_source)
        if found.num_inliers < _FEWEST or not _may_drift(by_poses, relation, way):
            return
        if not self._agree(older, newer, relation):
            return
        order = [3, 4, 5, 0, 1, 2]  # GICP has rotations first.
        variance = found.error / found.num_inliers * max(1.0, found.num_inliers / _INDEPENDENT)
        told = variance * np.linalg.pinv(np.asarray(found.H))[np.ix_(order, order)]
        least = np.diag(np.repeat([_LEAST, _LEAST_ANGLE], 3) ** 2)
        root = np.linalg.cholesky(np.linalg.inv(told + least)).T
        by_patches = covariance_of(one.matched(other, relation)[1])[:3, :3]
        is_told = bool(np.linalg.eigvalsh(by_patches).max() < self._cell**2)
        self.loops.append(SpatialLoop(older, newer, relation, root, is_told))

    def _agree(self, older: int, newer: int, relation: Floats) -> bool:
        """Whether hardly an end point of each local map lies where the other saw through."""
        return self._seen_by(older, newer, relation) and self._seen_by(newer, older, np.linalg.inv(relation))

    def _seen_by(self, one: int, other: int, relation: Floats) -> bool:
        theirs = _core.AdaptiveMap(dim=3, min_cell_size=2 * self._cell, max_cell_size=32 * self._cell)
        for pose, points in self._placed(one):
            theirs.insert(points @ pose[:3, :3].T + pose[:3, 3], pose[:3, 3])
        ours = self._around(other)[::7]
        at = ours @ relation[:3, :3].T + relation[:3, 3]
        known = theirs.probability(at)[theirs.state(at) != -1]
        return len(known) >= _FEWEST and float(np.mean(known >= _THROUGH)) >= _AGREE

    def _placed(self, number: int) -> list[tuple[Floats, Floats]]:
        """Scans of a local map: their poses seen from its key scan, and their points."""
        at = self.keys[number]
        which = np.flatnonzero(np.abs(self._way - self._way[at]) <= self._every)
        which = which[:: -(-len(which) // _SCANS)]
        seen_from = np.linalg.inv(self.poses[at])
        return [(seen_from @ self.poses[i], np.asarray(self.points[i], dtype=np.float64)) for i in which]

    def _around(self, number: int) -> Floats:
        """Points of a local map, seen from its key scan."""
        placed = [points @ pose[:3, :3].T + pose[:3, 3] for pose, points in self._placed(number)]
        return np.concatenate(placed)

    def _solve(self) -> None:
        """Poses of the key scans that fit all relations best; those between follow them."""
        before = self._matched[self.keys]
        pairs, relations, roots = self._edges(before)
        count = len(self.keys) - 1
        self._weights, after = np.ones(len(self.loops)), self.poses[self.keys]
        for _ in range(_ROUNDS):
            scaled = roots.copy()
            scaled[count:] *= np.sqrt(self._weights)[:, None, None]
            after = _fitted(after, pairs, relations, scaled)
            errors = np.einsum("nij,nj->ni", roots[count:], _errors(after, pairs[count:], relations[count:]))
            self._weights = 1.0 / (1.0 + (errors**2).sum(axis=1) / _KERNEL**2)
        self.poses = _carried(self._matched, self._way, self.keys, after @ np.linalg.inv(before))

    def _edges(self, at: Floats) -> tuple[Any, Floats, Floats]:
        """Pairs of key scans, their relations and roots of information: odometry's, then the loops'."""
        steps = np.diff(self._way[self.keys])
        deviations = np.repeat(
            np.column_stack((_STEP[0] + _STEP[1] * steps, _STEP_ANGLE[0] + _STEP_ANGLE[1] * steps)), 3, axis=1
        )
        numbers = np.arange(len(steps))
        pairs = [np.column_stack((numbers, numbers + 1))] + [[(one.older, one.newer)] for one in self.loops]
        relations = [np.linalg.inv(at[:-1]) @ at[1:]] + [one.relation[None] for one in self.loops]
        variances = deviations[:, :, None] ** 2 * np.eye(6)
        summed = np.cumsum(self.untold, axis=0)[self.keys]
        turn = at[:-1, :3, :3].transpose(0, 2, 1)
        variances[:, :3, :3] += turn @ np.diff(summed, axis=0) @ turn.transpose(0, 2, 1)
        steps_of = np.linalg.cholesky(np.linalg.inv(variances)).transpose(0, 2, 1)
        roots = [steps_of] + [one.root[None] for one in self.loops]
        return np.concatenate(pairs), np.concatenate(relations), np.concatenate(roots)


def require_libraries() -> None:
    """Raises ImportError where what finds poses is not installed: what to install."""
    with needs("finding poses in space needs small-gicp and SciPy", "lidar"):
        import scipy  # noqa: F401
        import small_gicp  # noqa: F401


def _around_guess(guess: Floats, way: float) -> list[Floats]:
    """Poses around a guess, as far as it may have drifted after a way [m]."""
    far = min(_DRIFT[0] + _DRIFT[1] * way, _LARGEST)
    steps = _BASIN * np.arange(-int(far / _BASIN), int(far / _BASIN) + 1)
    poses = [guess.copy() for _ in range(len(steps) ** 2)]
    for pose, x, y in zip(poses, np.repeat(steps, len(steps)), np.tile(steps, len(steps))):
        pose[:2, 3] += x, y
    return poses


def _may_drift(by_odometry: Floats, found: Floats, way: float) -> bool:
    """Whether odometry may be so wrong after a way [m]."""
    off = np.linalg.inv(by_odometry) @ found
    angle = np.arccos(np.clip((np.trace(off[:3, :3]) - 1.0) / 2.0, -1.0, 1.0))
    near = np.linalg.norm(off[:3, 3]) <= _DRIFT[0] + _DRIFT[1] * way
    return bool(near and angle <= _DRIFT_ANGLE[0] + _DRIFT_ANGLE[1] * way)


def _errors(at: Floats, pairs: Any, relations: Floats) -> Floats:
    """(n, 6): How far poses are from relations between them: translations [m], rotation vectors [rad]."""
    from scipy.spatial.transform import Rotation

    off = np.linalg.inv(relations) @ np.linalg.inv(at[pairs[:, 0]]) @ at[pairs[:, 1]]
    return np.hstack((off[:, :3, 3], Rotation.from_matrix(off[:, :3, :3]).as_rotvec()))


def _fitted(start: Floats, pairs: Any, relations: Floats, roots: Floats) -> Floats:
    """Poses that fit relations best, in least squares; the first stays."""
    from scipy.optimize import least_squares
    from scipy.sparse import lil_matrix

    def moved(changes: Floats) -> Floats:
        from scipy.spatial.transform import Rotation

        result = start.copy()
        each = changes.reshape(-1, 6)
        result[1:, :3, 3] += each[:, :3]
        result[1:, :3, :3] = Rotation.from_rotvec(each[:, 3:]).as_matrix() @ start[1:, :3, :3]
        return result

    def residuals(changes: Floats) -> Floats:
        return np.einsum("nij,nj->ni", roots, _errors(moved(changes), pairs, relations)).ravel()

    reads = lil_matrix((6 * len(pairs), 6 * (len(start) - 1)), dtype=int)
    for row, pair in enumerate(pairs):
        for one in pair:
            if one:
                reads[6 * row : 6 * row + 6, 6 * one - 6 : 6 * one] = 1
    return moved(least_squares(residuals, np.zeros(reads.shape[1]), jac_sparsity=reads, max_nfev=20).x)


def _carried(poses: Floats, way: Floats, keys: Any, corrections: Floats) -> Floats:
    """Poses of all scans: corrections (n, 4, 4) of the key scans, between two by the way from both."""
    from scipy.spatial.transform import Rotation, Slerp

    last = np.minimum(way, way[keys[-1]])
    turns = Slerp(way[keys], Rotation.from_matrix(corrections[:, :3, :3]))(last).as_matrix()
    # Between two key scans the correction of a pose is that of its place, not of the log's origin.
    places = poses[:, :3, 3]
    turned = np.einsum("nij,nj->ni", corrections[:, :3, :3], places[keys])
    shifts = corrections[:, :3, 3] + turned - places[keys]
    moved = poses.copy()
    moved[:, :3, :3] = turns @ poses[:, :3, :3]
    moved[:, :3, 3] = places + np.column_stack([np.interp(last, way[keys], one) for one in shifts.T])
    behind = way > way[keys[-1]]
    moved[behind] = corrections[-1] @ poses[behind]
    return moved
