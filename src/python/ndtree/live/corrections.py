# SPDX-License-Identifier: BSD-3-Clause
"""A live map that follows a SLAM: scans move when the poses are corrected that they were mapped by.

Strategy: a `ScanHistory` keeps the scans; of each it is known where odometry had the robot's body, and where
the sensor is on it. A correction says where the body was at some times. A scan between two of these is moved
on from the one before and back from the one after, by odometry, and lies between both by its time; a scan at
one of these times lies where the correction says. Scans before the first and after the last stay.

Invariants: while it maps, no scan within the span of a correction is farther from where it belongs than the
tolerance, but for corrections that wait; after `settle` each is where the newest correction that concerns it
says, so that the map does not depend on when corrections came. Memory is bounded: of more bytes of scans
than that, the oldest tenth is frozen, and moves no more.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ndtree._native._core import AdaptiveMap, InsertReport, ScanHistory
from ndtree.base.options import default_of
from ndtree.base.scan import Scan
from ndtree.logs.poses.pose import (
    Pose,
    matrices_of,
    multiplied,
    quaternions_of,
    rotated,
    slerp,
    unit_quaternions,
)

Floats = NDArray[np.float64]

#: Scans stay where they are if they would move by no more than this [m], and turn by no more [rad].
TOLERANCE = 0.01, math.radians(0.1)
#: Bytes of scans that can move.
MEMORY = int(default_of("follow_memory") * 2**20)
#: The share of the oldest scans that are frozen where there are too many bytes.
_FREEZES = 0.1
#: The next correction waits for new scans: as many as this share of the scans that the last one mapped anew.
_REST = 0.2
#: Bytes of a beam, of its own origin or standard deviation beside it, and of a scan.
_BEAM, _SIGMA, _SCAN = 8, 4, 1000
#: A sensor so near to where beams start is there [m]: what is less is rounding.
_ROUNDING = 1e-9


@dataclass(frozen=True)
class Motion:
    """Where a scan's sensor was."""

    stamp: float  # [s]
    sensor: Pose  # In the map, as it was mapped.
    odometry: Pose  # The body's, in a frame in which it does not jump.
    mount: Pose  # The sensor's, on the body.


class Correction:
    """Where the body of a robot was at some times, as is known now.

    `stamps` (n,): [s], in any order; of equal ones the last counts.
    `positions` (n, 3): In the map [m].
    `quaternions` (n, 4): x, y, z, w.
    `of` ({"body", "odometry", "sensor"}): Whose poses they are: the body's, the frame's of its odometry, or
        the sensor's, each of one scan.
    Raises ValueError if a number is not finite, or a quaternion not of length 1.
    """

    def __init__(
        self, stamps: ArrayLike, positions: ArrayLike, quaternions: ArrayLike, *, of: str = "body"
    ) -> None:
        times = np.asarray(stamps, dtype=np.float64)
        places = np.asarray(positions, dtype=np.float64).reshape(-1, 3)
        turns = np.asarray(quaternions, dtype=np.float64).reshape(-1, 4)
        if of not in ("body", "odometry", "sensor"):
            raise ValueError(f"of = {of!r}: must be 'body', 'odometry' or 'sensor'")
        if not len(times) == len(places) == len(turns):
            raise ValueError(
                f"{len(times)} stamps, {len(places)} positions and {len(turns)} quaternions: "
                "must be one of each for each pose"
            )
        if not (np.isfinite(times).all() and np.isfinite(places).all() and np.isfinite(turns).all()):
            raise ValueError("a correction: stamps, positions and quaternions must be finite")
        order = np.argsort(times, kind="stable")
        order = order[np.append(times[order][1:] != times[order][:-1], True)] if len(order) else order
        self.stamps, self.positions = times[order], places[order]
        self.rotations = matrices_of(unit_quaternions(turns[order])) if len(order) else np.zeros((0, 3, 3))
        self.of = of


class Jumps:
    """What changes of the transform from the map to the odometry's frame tell of earlier poses.

    From one change to the next the error of the odometry has grown, evenly, as nothing else is known. Of what
    was before the last change, nothing is told.
    """

    def __init__(self) -> None:
        self._stamps: list[float] = []
        self._poses: list[Pose] = []

    def add(self, stamp: float, pose: Pose) -> Correction | None:
        """The transform at a time [s]; a correction if it has changed by more than the tolerance."""
        if self._stamps and stamp <= self._stamps[-1]:
            return None
        if self._poses:
            now, last = _stacked([pose]), _stacked([self._poses[-1]])
            if not _differ(now, last, 3, TOLERANCE)[0]:
                return None
        self._stamps.append(stamp)
        self._poses.append(pose)
        if len(self._stamps) < 2:
            return None
        rotations, positions = _stacked(self._poses)
        return Correction(self._stamps, positions, quaternions_of(rotations), of="odometry")


class Corrections:
    """A map whose scans move when poses are corrected.

    `tolerance` (float, float): Scans that would move by no more than this [m], and turn by no more [rad],
        stay until the end.
    `memory`: Bytes of scans that can move; of more, the oldest are frozen.
    `threads`: That map, as for `OccupancyMap.insert`.
    Attributes:
    `applied`, `moved`, `frozen`: Corrections that moved something, scans that were moved, counted each time,
        and scans that move no more.
    `seconds`: Spent on moving and freezing.
    Raises ValueError if a number is out of its limits.
    """

    def __init__(
        self, *, tolerance: tuple[float, float] = TOLERANCE, memory: int = MEMORY, threads: int = 0
    ) -> None:
        if not all(0 <= one < math.inf for one in tolerance):
            raise ValueError(f"tolerance = {tolerance}: must be >= 0 [m] and >= 0 [rad]")
        if memory < 1:
            raise ValueError(f"memory = {memory} bytes: must be >= 1")
        self._tolerance, self._memory, self._threads = tolerance, memory, threads
        self.applied = self.moved = self.frozen = 0
        self.seconds = 0.0
        self._history: ScanHistory | None = None
        self._scan_bytes: list[int] = []
        self._bytes = 0
        self._next = 0
        self._motions: list[Motion] = []
        self._wanted: dict[str, Correction] = {}
        self._debt = 0.0

    def begin(self, dim: int, options: dict[str, float]) -> None:
        """Begin with an empty map of these options."""
        self._history = ScanHistory(dim=dim, **options)  # type: ignore[arg-type]
        self._scan_bytes, self._motions, self._bytes = [], [], 0
        self._wanted, self._debt, self._next = {}, 0.0, 0

    @property
    def map(self) -> AdaptiveMap:
        """The map as it is now, a copy that shares its cells."""
        return self._made().map

    def scans(self) -> Iterator[tuple[Motion, Scan]]:
        """All scans where they are now, with where their sensors are; ValueError if some are frozen."""
        if self.frozen:
            raise ValueError(f"{self.frozen} scans are frozen: expected all of them")
        history = self._made()
        for key, motion in zip(history.keys(), self._motions):
            yield motion, history.scan(key)

    def _made(self) -> ScanHistory:
        if self._history is None:
            raise RuntimeError("there is no map yet: call begin() first")
        return self._history

    def insert(self, scan: Scan, motion: Motion, max_range: float = math.inf) -> InsertReport:
        """Map a scan, and keep it."""
        history = self._made()
        planar = history.dim == 2
        pose = motion.sensor.level() if planar else motion.sensor
        back = pose.inverse()
        ends, origins = (_in_frame(back, part) for part in (scan.endpoints, scan.origin))
        origin = origins[0] if np.ndim(scan.origin) == 1 else origins
        report = history.insert(
            self._next,
            ends[:, : history.dim],
            pose.matrix(history.dim),
            origin=origin[..., : history.dim],
            returned=scan.returned,
            range_sigma=scan.range_sigma,
            max_range=max_range,
            threads=self._threads,
            pose_covariance=scan.pose_covariance,
        )
        of_beam = _BEAM + (_BEAM if np.ndim(scan.origin) > 1 else 0)
        of_beam += 0 if scan.range_sigma is None and scan.pose_covariance is None else _SIGMA
        self._scan_bytes.append(_SCAN + of_beam * len(ends))
        self._next += 1
        self._motions.append(motion)
        self._debt = max(self._debt - 1.0, 0.0)
        self._bytes += self._scan_bytes[-1]
        if self._bytes > self._memory:
            self._freeze()
        return report

    def correct(self, correction: Correction) -> None:
        """Take note of a correction; of two of one kind the later counts.

        Scans are moved at once, unless the last time took so long that new ones would wait.
        """
        self._wanted[correction.of] = correction
        if self._debt <= 0.0:
            self._apply(self._tolerance)

    def settle(self) -> None:
        """Move all scans to where the newest corrections say."""
        self._apply((0.0, 0.0))

    def _apply(self, tolerance: tuple[float, float]) -> None:
        if not self._motions:
            return
        begin = time.perf_counter()
        history = self._made()
        for correction in self._wanted.values():
            at, rotations, positions = self._placed(correction)
            now = self._poses("sensor", at)
            moves = np.flatnonzero(_differ((rotations, positions), now, history.dim, tolerance))
            if not len(moves):
                continue
            first = self._next - len(self._motions)
            poses = {int(at[k]): Pose(rotations[k], positions[k]) for k in moves}
            report = history.move(
                {
                    first + i: (pose.level() if history.dim == 2 else pose).matrix(history.dim)
                    for i, pose in poses.items()
                },
                threads=self._threads,
            )
            for i, pose in poses.items():
                self._motions[i] = replace(self._motions[i], sensor=pose)
            self.applied += 1
            self.moved += len(moves)
            self._debt = _REST * report.replayed
        self.seconds += time.perf_counter() - begin

    def _freeze(self) -> None:
        self._apply((0.0, 0.0))
        begin = time.perf_counter()
        count = max(int(_FREEZES * len(self._motions)), 1)
        self._made().freeze(count, threads=self._threads)
        self._bytes -= sum(self._scan_bytes[:count])
        del self._scan_bytes[:count], self._motions[:count]
        self.frozen += count
        self.seconds += time.perf_counter() - begin

    def _placed(self, correction: Correction) -> tuple[NDArray[np.intp], Floats, Floats]:
        """Which scans a correction is about, and where their sensors belong: rotations and positions."""
        keys, stamps = correction.stamps, self._stamps()
        if not len(keys):
            return np.zeros(0, np.intp), np.zeros((0, 3, 3)), np.zeros((0, 3))
        before = np.searchsorted(keys, stamps, side="right") - 1
        if correction.of == "sensor":
            at = np.flatnonzero((before >= 0) & (keys[before] == stamps))
            return at, correction.rotations[before[at]], correction.positions[before[at]]
        is_inside = (stamps >= keys[0]) & (stamps <= keys[-1])
        at = np.flatnonzero(is_inside)
        before = before[at]
        after = np.minimum(before + 1, len(keys) - 1)
        span = keys[after] - keys[before]
        share = (stamps[at] - keys[before]) / np.where(span > 0, span, 1.0)
        odometry = self._poses("odometry", at)
        key_poses = correction.rotations, correction.positions
        if correction.of == "body":
            known, inverse = self._odometry_at(keys)
            key_poses = _joined(key_poses, inverse)  # Of the odometry's frame, then.
            is_known = known[before] | known[after]
            share = np.where(known[before], np.where(known[after], share, 0.0), 1.0)
            is_exact = stamps[at] == keys[before]
        else:
            is_known = np.ones(len(at), dtype=bool)
            is_exact = np.zeros(len(at), dtype=bool)
        first = _joined(_taken(key_poses, before), odometry)
        second = _joined(_taken(key_poses, after), odometry)
        turns, places = _between(first, second, share)
        turns[is_exact] = correction.rotations[before[is_exact]]
        places[is_exact] = correction.positions[before[is_exact]]
        sensors = _joined((turns, places), self._poses("mount", at))
        chosen = is_known | is_exact
        return at[chosen], sensors[0][chosen], sensors[1][chosen]

    def _stamps(self) -> Floats:
        return np.array([one.stamp for one in self._motions])

    def _poses(self, name: str, at: NDArray[np.intp]) -> tuple[Floats, Floats]:
        """One of the poses of some scans' motions."""
        return _stacked([getattr(self._motions[i], name) for i in at])

    def _odometry_at(self, keys: Floats) -> tuple[NDArray[np.bool_], tuple[Floats, Floats]]:
        """Whether odometry knows where the body was at times (k,) [s], and the inverse of where."""
        stamps = self._stamps()
        order = np.argsort(stamps, kind="stable")
        stamps, poses = stamps[order], self._poses("odometry", order)
        after = np.clip(np.searchsorted(stamps, keys, side="left"), 0, len(stamps) - 1)
        before = np.where(stamps[after] == keys, after, np.maximum(after - 1, 0))
        span = stamps[after] - stamps[before]
        share = np.clip((keys - stamps[before]) / np.where(span > 0, span, 1.0), 0.0, 1.0)
        turned, moved = _between(_taken(poses, before), _taken(poses, after), share)
        back = np.swapaxes(turned, -1, -2)
        return (keys >= stamps[0]) & (keys <= stamps[-1]), (back, -rotated(back, moved))


def _differ(
    a: tuple[Floats, Floats], b: tuple[Floats, Floats], dim: int, tolerance: tuple[float, float]
) -> NDArray[np.bool_]:
    """Which of n poses are farther from others than a tolerance [m] and [rad], or with 0 differ at all."""
    moved = np.linalg.norm((a[1] - b[1])[:, :dim], axis=1)
    if dim == 2:
        turned = np.abs(_yaws(a[0]) - _yaws(b[0]))
        turned = np.minimum(turned, 2 * math.pi - turned)
    else:
        chord = np.linalg.norm(a[0] - b[0], axis=(1, 2)) / math.sqrt(8.0)
        turned = 2.0 * np.arcsin(np.minimum(chord, 1.0))
    differ: NDArray[np.bool_] = (moved > tolerance[0]) | (turned > tolerance[1])
    return differ


def _yaws(rotations: Floats) -> Floats:
    yaws: Floats = np.arctan2(rotations[:, 1, 0], rotations[:, 0, 0])
    return yaws


def _in_frame(back: Pose, points: ArrayLike) -> Floats:
    """Points of the map (n, 2) or (n, 3) in another frame, (n, 3); what is 0 but for rounding is 0."""
    given = np.atleast_2d(np.asarray(points, dtype=np.float64))
    spatial = np.concatenate([given, np.zeros((len(given), 3 - given.shape[1]))], axis=1)
    moved = back.apply(spatial)
    with np.errstate(invalid="ignore"):
        moved[np.abs(moved) < _ROUNDING] = 0.0
    return moved


def _stacked(poses: Sequence[Pose]) -> tuple[Floats, Floats]:
    """Rotations (n, 3, 3) and positions (n, 3)."""
    if not len(poses):
        return np.zeros((0, 3, 3)), np.zeros((0, 3))
    return np.stack([one.rotation for one in poses]), np.stack([one.position for one in poses])


def _joined(left: tuple[Floats, Floats], right: tuple[Floats, Floats]) -> tuple[Floats, Floats]:
    """As ``left @ right`` of poses, of many."""
    return multiplied(left[0], right[0]), rotated(left[0], right[1]) + left[1]


def _between(
    one: tuple[Floats, Floats], other: tuple[Floats, Floats], share: Floats
) -> tuple[Floats, Floats]:
    """Poses from some to others, by shares (n,) of the way."""
    turns = matrices_of(slerp(quaternions_of(one[0]), quaternions_of(other[0]), share))
    return turns, (1 - share)[:, None] * one[1] + share[:, None] * other[1]


def _taken(poses: tuple[Floats, Floats], at: NDArray[np.intp]) -> tuple[Floats, Floats]:
    return poses[0][at], poses[1][at]
