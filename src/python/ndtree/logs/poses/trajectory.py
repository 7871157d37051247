# SPDX-License-Identifier: BSD-3-Clause
"""Poses over time, interpolated, and where none is known."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from ndtree.logs.core.arrays import Bools, Floats
from ndtree.logs.core.failures import NoPose, at_place
from ndtree.logs.poses.pose import (
    STRAIGHT,
    Pose,
    matrix_of,
    nearest_rotations,
    quaternions_of,
    slerp,
    unit_quaternions,
)

#: Stamps so far outside a trajectory still get its first or last pose [s].
STAMP_TOLERANCE = 0.01
#: Between two poses further apart in time than this [s], and than GAP_TIMES times the usual,
GAP_SECONDS, GAP_TIMES = 1.0, 10.0
#: the pose is unknown if it changed by more than this [m], [rad] meanwhile.
GAP_DISTANCE, GAP_TURN = 0.1, 0.1
#: A leap makes surfaces double [m], and is a motion that takes more than gravity [m/s²].
LEAP, GRAVITY = 0.12, 9.81
#: Poses that leap there and back are of another writer if there are several.
SEVERAL = 3


class Trajectory:
    """Poses over time: positions are interpolated along lines, rotations along great circles.

    `stamps` (array_like, (n,)): Rising times [s], at least one.
    `positions` (array_like, (n, 3)): Where the sensor was in the map [m].
    `rotations` (array_like, (n, 4) or (n, 3, 3)): Quaternions (x, y, z, w), or matrices.
    `name`: How errors call it.
    `is_numbered`: Stamps are the poses' numbers, not times.
    Raises ValueError if shapes do not fit together, stamps do not rise, or something is no rotation.
    """

    def __init__(
        self,
        stamps: ArrayLike,
        positions: ArrayLike,
        rotations: ArrayLike,
        *,
        name: str = "trajectory",
        is_numbered: bool = False,
    ) -> None:
        self.name = name
        self.is_numbered = is_numbered
        self.stamps: Floats = np.asarray(stamps, dtype=np.float64)
        self.positions: Floats = np.asarray(positions, dtype=np.float64)
        turned = np.asarray(rotations, dtype=np.float64)
        n = len(self.stamps) if self.stamps.ndim == 1 else 0
        shapes = (self.stamps.shape, self.positions.shape, turned.shape)
        if n == 0 or shapes[1] != (n, 3) or shapes[2] not in ((n, 4), (n, 3, 3)):
            raise ValueError(
                f"{name}: stamps, positions and rotations have shapes {shapes[0]}, {shapes[1]} and "
                f"{shapes[2]}: must be (n,), (n, 3) and (n, 4) or (n, 3, 3), with n > 0"
            )
        for values, what in ((self.stamps, "stamps"), (self.positions, "positions"), (turned, "rotations")):
            bad = ~np.isfinite(values).reshape(n, -1).all(axis=1)
            if bad.any():
                raise ValueError(f"{name}: {what}: pose {int(bad.argmax())} is not finite")
        falls = np.flatnonzero(np.diff(self.stamps) <= 0)
        if falls.size:
            i = int(falls[0])
            said = f"{self.stamps[i + 1]:.6f} s follows {self.stamps[i]:.6f} s"
            raise ValueError(f"{name}: pose {i + 1}: stamp {said}, expected stamps that rise")
        with at_place(name):
            if turned.ndim == 3:
                turned = quaternions_of(nearest_rotations(turned))
            self.quaternions: Floats = unit_quaternions(turned)
        self._gaps = self._found_gaps()

    def __len__(self) -> int:
        return len(self.stamps)

    def pose_at(self, stamp: float) -> Pose:
        """The pose at a time [s]: as `poses_at`, without the cost of arrays for one."""
        first, last = float(self.stamps[0]), float(self.stamps[-1])
        if not first - STAMP_TOLERANCE <= stamp <= last + STAMP_TOLERANCE:
            raise self._unknown(stamp)
        stamp = min(max(float(stamp), first), last)
        after = max(int(self.stamps.searchsorted(stamp)), min(1, len(self) - 1))
        before = max(after - 1, 0)
        if self._gaps is not None and self._gaps[before] and self._is_inside(stamp, before):
            raise self._unknown(stamp, before)
        begin, end = float(self.stamps[before]), float(self.stamps[after])
        share = (stamp - begin) / (end - begin) if end > begin else 0.0
        position = self.positions[before] + share * (self.positions[after] - self.positions[before])
        one, other = self.quaternions[before].tolist(), self.quaternions[after].tolist()
        if sum(a * b for a, b in zip(one, other)) < 0:
            other = [-b for b in other]
        apart = math.sqrt(sum((b - a) ** 2 for a, b in zip(one, other)))
        angle = 2 * math.atan2(apart, math.sqrt(sum((a + b) ** 2 for a, b in zip(one, other))))
        sine = math.sin(angle)
        u, v = 1 - share, share
        if sine >= STRAIGHT:
            u, v = math.sin(u * angle) / sine, math.sin(v * angle) / sine
        between = [u * a + v * b for a, b in zip(one, other)]
        length = math.sqrt(sum(a * a for a in between))
        return Pose(matrix_of(*(a / length for a in between)), position)

    def poses_at(self, stamps: ArrayLike) -> tuple[Floats, Floats]:
        """Interpolated poses.

        `stamps` (array_like, (n,)): Times [s], in any order.
        Returns positions (n, 3) float64; quaternions (n, 4) float64: Unit quaternions (x, y, z, w).
        Raises ValueError: a `NoPose`, if a time lies more than ``STAMP_TOLERANCE`` before the first or after
        the last pose; closer, it gets that pose. Or if it lies in a gap: between poses that are more than 1 s
        and 10 times the usual interval apart, and more than 0.1 m or 0.1 rad in place.
        """
        wanted = np.atleast_1d(np.asarray(stamps, dtype=np.float64))
        first, last = self.stamps[0], self.stamps[-1]
        outside = ~((wanted >= first - STAMP_TOLERANCE) & (wanted <= last + STAMP_TOLERANCE))
        if outside.any():
            raise self._unknown(wanted[outside.argmax()])
        wanted = np.clip(wanted, first, last)
        after = np.clip(np.searchsorted(self.stamps, wanted), 1, max(len(self) - 1, 1))
        before = after - 1
        if self._gaps is not None:
            for i in np.flatnonzero(self._gaps[before]):
                if self._is_inside(wanted[i], before[i]):
                    raise self._unknown(wanted[i], before[i])
        after = np.minimum(after, len(self) - 1)
        span = self.stamps[after] - self.stamps[before]
        share = np.divide(wanted - self.stamps[before], span, out=np.zeros_like(wanted), where=span > 0)
        start, end = self.positions[before], self.positions[after]
        positions = start + share[:, None] * (end - start)
        return positions, slerp(self.quaternions[before], self.quaternions[after], share)

    def leaps(self) -> str | None:
        """What is said of positions that leap; None where none do.

        Some lie far beside the way from the pose before to the one behind, or a step is much faster than
        both the one before and the one behind.
        """
        times, steps = np.diff(self.stamps), np.linalg.norm(np.diff(self.positions, axis=0), axis=1)
        across = np.linalg.norm(self.positions[2:] - self.positions[:-2], axis=1)
        beside = (steps[:-1] + steps[1:] - across) / 2
        found = beside > LEAP + GRAVITY * (times[:-1] + times[1:]) ** 2
        if np.count_nonzero(found) >= SEVERAL:
            said, sizes = "jump back and forth", beside
            why = "two nodes seem to publish them, expected one"
        else:
            fast = np.pad(steps / times, 1)
            sizes = steps - np.maximum(fast[:-2], fast[2:]) * times
            found = sizes > LEAP + GRAVITY * times**2
            said, why = "jump", "surfaces seen before and after may lie apart"
        if not found.any():
            return None
        count, first = int(np.count_nonzero(found)), self.stamps[1 + int(found.argmax())]
        often = "once" if count == 1 else f"{count} times, first"
        name = self.name.replace("transform", "transforms", 1)
        return f"{name} {said} by up to {sizes[found].max():.2f} m ({often} at {first:.3f} s): {why}"

    def _found_gaps(self) -> Bools | None:
        """Which of the intervals between poses are gaps; None if there are none."""
        if self.is_numbered or len(self) < 3:
            return None
        apart = np.diff(self.stamps)
        long = apart > max(GAP_SECONDS, GAP_TIMES * float(np.median(apart)))
        if not long.any():
            return None
        way = np.linalg.norm(np.diff(self.positions, axis=0), axis=1)
        same = np.abs((self.quaternions[1:] * self.quaternions[:-1]).sum(axis=1))
        turn = 2 * np.arccos(np.minimum(same, 1.0))
        gaps = long & ((way > GAP_DISTANCE) | (turn > GAP_TURN))
        return gaps if gaps.any() else None

    def _is_inside(self, stamp: float, before: int) -> bool:
        """Whether a time is really between two poses, not that of one of them."""
        begin, end = self.stamps[before], self.stamps[before + 1]
        return bool(begin + STAMP_TOLERANCE < stamp < end - STAMP_TOLERANCE)

    def _unknown(self, stamp: float, before: int | None = None) -> NoPose:
        first, last = float(self.stamps[0]), float(self.stamps[-1])
        if before is not None:
            begin, end = float(self.stamps[before]), float(self.stamps[before + 1])
            message = f"no pose at {stamp:.6f} s, it is in a gap from {begin:.6f} to {end:.6f} s"
            return NoPose(f"{self.name}: {message}", "in a gap", end - begin)
        message = f"no pose at {stamp:.6f} s, expected a time from {first:.6f} to {last:.6f} s"
        if stamp > last:
            return NoPose(f"{self.name}: {message}", "after", float(stamp) - last)
        return NoPose(f"{self.name}: {message}", "before", first - float(stamp))
