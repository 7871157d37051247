# SPDX-License-Identifier: BSD-3-Clause
"""Scans of a 3-D sensor matched one after the other with those before.

Strategy: flat patches of a scan are moved onto those of the last key scans together. What they tell is joined
with what odometry says, each by its covariance. Where that leaves a direction open, as along a street, GICP
(small_gicp) says how far the sensor moved by all points; but points of the same beams on a smooth surface fit
best where the sensor stood still, so what it says counts only if that is not why: else odometry alone does.
Where odometry stalls, jumps or slips, the sensor moved about as before: the likelier of both is taken.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ndtree.alignment.motion import ANYHOW, AS_BEFORE, SIGMAS, Motion
from ndtree.alignment.patches import START, Patches, among, off_by, turn_of, turned_by
from ndtree.alignment.planar import Floats
from ndtree.alignment.sensor_scans import Step

_KEY_WAY, _KEY_ANGLE = 0.1, 0.2  # Between key scans: of the usual range [1], and [rad];
_KEY_WAYS = (0.2, 3.0)  # the way in these bounds [m].
_MAP_SCANS = 12  # Key scans that scans are matched with.
#: Of the usual agreement: below the first, a scan sees what is new, or odometry is wrong anyhow; below the
#: second, it does not match.
_POOR, _LOST = 0.75, 0.5
_FEWEST = 50  # Points of a scan that says something.
_HARDLY = 0.1  # Where so little agrees, as among leaves, less tells nothing.
_REMEMBERED = 30  # Scans whose agreements are usual.
#: Points say little of what flat surfaces leave open if more lie on these, and fewer are rough among others.
_FLAT, _ROUGH = 2 / 3, 1 / 6
_OPEN = 0.5  # Of the variance of a usual odometry: what leaves more of it does not tell.
_ODD = 0.06  # Part of the patches of few rings that are of no surface.
_MOVES = 0.01  # Shorter steps do not tell odometry's scale [m].
_CELL = (0.1, 0.5)  # Between points for GICP: a fiftieth of the reach, in these bounds [m];
_NEAR = (8.0, 3.0)  # and how many cells apart points may be that belong together, at first and then.
_OF_CELL, _OF_ANGLE = 0.05, 0.005  # What GICP may be wrong by: of a cell, and [rad].
_BY_POINTS = 0.05  # A turn by GICP alone is against odometry from here on, a place from a cell on [rad].
_USUAL = Motion()


@dataclass(frozen=True)
class CloudScan:
    """One scan of a 3-D log: what it saw, and where the log has its sensor.

    `points` (n, 3) float32: In the sensor's frame [m]; along the log's axes where it does not say how the
        sensor is turned.
    `pose` (4, 4) float64: Not turned there.
    """

    points: Any
    pose: Floats


@dataclass
class SpatialTrack:
    """Where scans were, each as it was matched with those before."""

    poses: list[Floats] = field(default_factory=list)  # Of all scans (4, 4).
    covariances: list[Floats] = field(default_factory=list)  # In what was seen shortly before (6, 6).
    keys: list[int] = field(default_factory=list)  # Scans that are key scans.
    lost: int = 0  # Scans that did not match.
    broken: list[int] = field(default_factory=list)  # Key scans that did not.
    against: list[Step] = field(default_factory=list)  # Odometry.
    unfixed: list[float] = field(default_factory=list)  # Way of each scan that only odometry tells [m].
    ratios: list[float] = field(default_factory=list)  # Of ways that scans say, to those of odometry.

    @property
    def untold(self) -> Floats:
        """(n, 3, 3) float64: covariances of places whose way only odometry tells, else 0 [m²]."""
        return np.array(self.covariances)[:, :3, :3] * (np.array(self.unfixed) > 0.0)[:, None, None]


@dataclass(frozen=True)
class _Match:
    """How a sensor may have moved: a pose and its covariance (6, 6), by the place and a turn on the left."""

    pose: Floats
    covariance: Floats
    agreement: float  # Of the usual one; 0 where nothing matches.
    posterior: float  # Logarithm, but for a constant.

    def open_axes(self, least: float) -> Floats:
        """Directions (3, k) in which the place has more than a variance."""
        variances, axes = np.linalg.eigh(self.covariance[:3, :3])
        result: Floats = axes[:, variances > least]
        return result


class _Usual:
    """How well scans agreed lately."""

    def __init__(self) -> None:
        self._last: deque[float] = deque(maxlen=_REMEMBERED)

    @property
    def value(self) -> float:
        return float(np.median(self._last)) if self._last else 1.0

    def share(self, agreement: float) -> float:
        """What part of the usual one an agreement is, all where hardly any is usual; it is remembered."""
        share = min(1.0, agreement / self.value) if self.value > _HARDLY else 1.0
        self._last.append(agreement)
        return share


class SpatialTracker:
    """Places scans one by one.

    `motion`: How wrong odometry may be.
    `has_odometry`: Whether origins of scans say how the sensor moved.
    `scale`: What odometry's ways are to be multiplied by: -1 where it counts backwards.
    """

    def __init__(self, motion: Motion, has_odometry: bool, scale: float = 1.0) -> None:
        self.track = SpatialTrack()
        self._motion, self._has_odometry, self._scale = motion, has_odometry, scale
        self._near: deque[tuple[Floats, Any]] = deque(maxlen=_MAP_SCANS)  # Key scans: poses and points.
        self._by_kind = _Usual(), _Usual()  # Agreements of patches, and of points.
        self._last: CloudScan | None = None
        self._step = np.eye(4)  # What the last scan moved.
        self._by_odometry = np.eye(4)  # Where odometry has it, seen from the last key scan.

    def add(self, scan: CloudScan) -> None:
        """Place the next scan."""
        track, last, self._last = self.track, self._last, scan
        if last is None:
            self._place(scan.pose, np.zeros((6, 6)), 0.0)
            self._keep(scan, scan.pose)
            return
        told = np.linalg.inv(last.pose) @ scan.pose
        told[:3, 3] *= self._scale
        step = told if self._has_odometry else self._step
        self._by_odometry = self._by_odometry @ step
        before, key = track.poses[-1], track.poses[track.keys[-1]]
        best = self._matched(scan, before, step)
        moved = best.pose[:3, 3] - before[:3, 3]
        is_open = best.open_axes(_OPEN * _sigmas(_USUAL, step)[0] ** 2)
        self._place(best.pose, best.covariance, float(np.linalg.norm(moved @ is_open)))
        self._step = np.linalg.inv(before) @ best.pose
        if not is_open.size:
            since = len(track.poses) - 1 - track.keys[-1]
            track.unfixed[-since:] = [0.0] * since  # It is where it is in the map, whatever was before.
            square = float(told[:3, 3] @ told[:3, 3])
            if self._has_odometry and square > _MOVES**2:
                track.ratios.append(float(told[:3, 3] @ self._step[:3, 3]) * self._scale / square)
        relation = np.linalg.inv(key) @ best.pose
        is_far = np.linalg.norm(relation[:3, 3]) > self._key_way or _angle(relation) > _KEY_ANGLE
        if is_far or best.agreement < _POOR:
            if best.agreement == 0.0 and self._map is not None:
                track.broken.append(len(track.poses) - 1)
            self._keep(scan, best.pose)

    def _place(self, pose: Floats, covariance: Floats, unfixed: float) -> None:
        self.track.poses.append(pose)
        self.track.covariances.append(covariance)
        self.track.unfixed.append(unfixed)

    def _keep(self, scan: CloudScan, pose: Floats) -> None:
        """Take the last scan as a key scan: the map is seen from it."""
        self._near.append((pose, scan.points))
        reach = float(np.median(np.linalg.norm(scan.points, axis=1))) if len(scan.points) else 0.0
        self._key_way = float(np.clip(_KEY_WAY * reach, *_KEY_WAYS))
        self._cell = float(np.clip(reach / 50, *_CELL))
        from_here = np.linalg.inv(pose)
        seen = [from_here @ at for at, _ in self._near]
        self._points = np.concatenate([p @ at[:3, :3].T + at[:3, 3] for at, (_, p) in zip(seen, self._near)])
        self._map = Patches.of([self._points]) if len(self._points) >= _FEWEST else None
        self._target: Any = None
        self._by_odometry = np.eye(4)
        self.track.keys.append(len(self.track.poses) - 1)

    def _matched(self, scan: CloudScan, before: Floats, step: Floats) -> _Match:
        """Pose and covariance of a scan."""
        guess, sigmas, track = before @ step, _sigmas(self._motion, step), self.track
        by_odometry = _Match(guess, np.diag(sigmas**2), 0.0, -np.inf)
        if len(scan.points) < _FEWEST:  # It says nothing, nor that something is wrong.
            track.lost += 1
            return replace(by_odometry, agreement=1.0)
        if self._map is None:
            return by_odometry
        patches, window = Patches.of([scan.points.astype(np.float64)]), SIGMAS * sigmas
        best = self._by_patches(patches, guess, sigmas, 0.0)
        as_before = before @ self._step
        if self._has_odometry and _is_outside(as_before, guess, window):
            other = self._by_patches(patches, as_before, sigmas, AS_BEFORE)
            best = max(best, other, key=lambda one: one.posterior)
        usual_fits = self._by_kind[0]
        if best.agreement < _POOR * usual_fits.value:
            other = self._by_patches(patches, guess, START, ANYHOW)
            best = max(best, other, key=lambda one: one.posterior)
        best = replace(best, agreement=usual_fits.share(best.agreement))
        is_poor = best.agreement < _LOST
        best = by_odometry if is_poor else best
        usual, by_patches = _sigmas(_USUAL, step), best
        is_open = np.linalg.eigvalsh(best.covariance[:3, :3]).max() > _OPEN * usual[0] ** 2
        is_open = is_open or np.linalg.eigvalsh(best.covariance[3:, 3:]).max() > _OPEN * usual[3] ** 2
        if is_open or is_poor:
            best = self._by_points(scan, best, usual)
        if best.agreement == 0.0:
            track.lost += 1
            return by_odometry
        if self._has_odometry and _is_outside(best.pose, guess, window):
            is_told = _is_outside(by_patches.pose, guess, window)
            is_told = is_told and not _is_outside(best.pose, by_patches.pose, window)
            if is_told or _is_outside(best.pose, guess, window + np.repeat([self._cell, _BY_POINTS], 3)):
                track.against.append(Step(len(track.poses), is_told))
        return best

    def _by_patches(self, patches: Patches, guess: Floats, sigmas: Floats, weight: float) -> _Match:
        """Where a scan's flat patches lie on those of the map, and a guess with its deviations, together."""
        key = self._near[-1][0]
        there, known = np.linalg.inv(key) @ guess, np.diag(sigmas**-2)
        found, told = self._map.matched(patches, there, np.minimum(SIGMAS * sigmas, START), _ODD)
        covariance = np.linalg.inv(told + known)
        change = covariance @ told @ off_by(there, found)
        pose = there.copy()
        pose[:3, 3] += change[:3]
        pose[:3, :3] = turned_by(change[3:]) @ pose[:3, :3]
        fits = self._map.agreement(patches, pose)
        off = change / sigmas
        prior = weight - float(np.log(sigmas).sum()) - 0.5 * float(off @ off)
        posterior = len(patches.keys) / patches.levels * fits + prior
        turn = np.kron(np.eye(2), key[:3, :3])
        return _Match(key @ pose, turn @ covariance @ turn.T, fits, posterior)

    def _is_smooth(self, points: Floats) -> bool:
        """Whether points, as seen from the last key scan, say little of what flat surfaces leave open."""
        is_on = self._map.holds(points)
        if is_on.mean() <= _FLAT:
            return False
        return float(np.mean(~is_on & among(points, self._points))) < _ROUGH

    def _by_points(self, scan: CloudScan, best: _Match, usual: Floats) -> _Match:
        """The same, moved as all points say in directions that are open, if they say more than to stand."""
        from small_gicp import align, preprocess_points

        if self._target is None:
            self._target = preprocess_points(self._points, downsampling_resolution=self._cell, num_threads=1)
        source, _ = preprocess_points(
            scan.points.astype(np.float64), downsampling_resolution=self._cell, num_threads=1
        )
        key = self._near[-1][0]
        pose = np.linalg.inv(key) @ best.pose
        for cells in _NEAR:
            found = align(
                *(self._target[0], source, self._target[1], pose),
                max_correspondence_distance=cells * self._cell, num_threads=1,
            )  # fmt: skip
            pose = np.array(found.T_target_source)
        fits = self._by_kind[1].share(found.num_inliers / max(source.size(), 1))
        is_smooth = self._is_smooth(scan.points @ pose[:3, :3].T + pose[:3, 3])
        off = off_by(best.pose, key @ pose)
        if fits < _LOST or is_smooth or np.linalg.norm(off[:3]) > _NEAR[0] * self._cell:
            return best
        axes = best.open_axes(_OPEN * usual[0] ** 2)
        in_map = axes.T @ key[:3, :3]
        way = float(np.linalg.norm(in_map @ pose[:3, 3]))
        told = float(np.linalg.norm(in_map @ self._by_odometry[:3, 3]))
        least = SIGMAS * _sigmas(_USUAL, self._by_odometry)[0]
        if self._has_odometry and way < max(told - least, least):
            return replace(best, agreement=fits) if best.agreement else best
        covariance = best.covariance.copy()
        covariance[:3, 3:] = covariance[3:, :3] = 0.0
        known = (_OF_CELL * self._cell) ** 2 * np.eye(axes.shape[1])
        covariance[:3, :3] += axes @ (known - axes.T @ covariance[:3, :3] @ axes) @ axes.T
        covariance[3:, 3:] = _OF_ANGLE**2 * np.eye(3)
        return replace(best, pose=key @ pose, covariance=covariance, agreement=fits)


def _sigmas(motion: Motion, step: Floats) -> Floats:
    """Deviations (6,) of a motion: of its place, and of its turn."""
    place, _, angle = motion.sigmas(np.array([np.linalg.norm(step[:3, 3]), 0.0, _angle(step)]), True)
    return np.repeat([place, angle], 3)


def _is_outside(pose: Floats, guess: Floats, window: Floats) -> bool:
    return bool((np.abs(off_by(guess, pose)) > window).any())


def _angle(pose: Floats) -> float:
    return float(np.linalg.norm(turn_of(pose[:3, :3])))
