# SPDX-License-Identifier: BSD-3-Clause
"""Poses of a sensor: one, and many over time; trajectory files of TUM and KITTI."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ndtree.readers.plain_file import text_lines
from ndtree.readers.source import ReaderOption

Floats = NDArray[np.float64]

#: Stamps so far outside a trajectory still get its first or last pose [s].
STAMP_TOLERANCE = 0.01
#: Larger departures from a rotation are mistakes, smaller ones rounding.
ROTATION_TOLERANCE = 0.02
#: Sine of an angle below which an arc is its chord to the last bit.
STRAIGHT = 1e-9

#: Between two poses further apart in time than this [s], and than so many times the usual, ...
GAP_SECONDS, GAP_TIMES = 1.0, 10.0
#: ... nobody knows the pose if it changed by more than this [m], [rad] meanwhile.
GAP_DISTANCE, GAP_TURN = 0.1, 0.1

TRAJECTORY = ReaderOption("trajectory", str, "File of poses, TUM (t x y z qx qy qz qw) or KITTI (3x4).")

EXPECTED = "expected 8 numbers a line (t x y z qx qy qz qw) or 12 (3x4 matrix)"


class NoPose(ValueError):
    """A time at which a pose is not known.

    Attributes
    ----------
    where : {"before", "after", "in a gap"}
        On which side of the poses that are known.
    seconds : float
        How far outside of them, or how long the gap is.
    """

    def __init__(self, message: str, where: str, seconds: float) -> None:
        super().__init__(message)
        self.where, self.seconds = where, seconds


@dataclass(frozen=True, eq=False)
class Pose:
    """A rigid transform, as in ``T_map_sensor``: from sensor coordinates to the map's.

    Attributes
    ----------
    rotation : (3, 3) float64
    position : (3,) float64
        Where the sensor's origin lies in the map [m].
    """

    rotation: Floats
    position: Floats

    @staticmethod
    def identity() -> Pose:
        """The transform that changes nothing."""
        return Pose(np.eye(3), np.zeros(3))

    @staticmethod
    def from_matrix(matrix: ArrayLike) -> Pose:
        """From a (3, 4) or (4, 4) matrix; ValueError if its left part is no rotation."""
        values = np.asarray(matrix, dtype=np.float64)
        if values.shape not in ((3, 4), (4, 4)):
            raise ValueError(f"a pose has shape {values.shape}: must be (3, 4) or (4, 4)")
        return Pose(nearest_rotations(values[None, :3, :3])[0], values[:3, 3])

    @staticmethod
    def from_quaternion(position: ArrayLike, quaternion: ArrayLike) -> Pose:
        """From (3,) metres and a quaternion (x, y, z, w); ValueError if its length is not 1."""
        rotation = matrices_of(unit_quaternions(np.asarray(quaternion, dtype=np.float64)[None]))[0]
        return Pose(rotation, np.asarray(position, dtype=np.float64))

    def apply(self, points: ArrayLike) -> Floats:
        """Points (n, 3) in the map frame, float64 whatever they were [m]; not finite where they were not."""
        with np.errstate(invalid="ignore", over="ignore"):
            return np.asarray(points, dtype=np.float64) @ self.rotation.T + self.position

    def inverse(self) -> Pose:
        """The transform back."""
        return Pose(self.rotation.T, -self.rotation.T @ self.position)

    def __matmul__(self, other: Pose) -> Pose:
        """First `other`, then this one: ``T_map_body @ T_body_sensor``."""
        return Pose(self.rotation @ other.rotation, self.rotation @ other.position + self.position)


class Trajectory:
    """Poses over time: positions are interpolated along lines, rotations along great circles.

    Parameters
    ----------
    stamps : array_like, (n,)
        Rising times [s], at least one.
    positions : array_like, (n, 3)
        Where the sensor was in the map [m].
    rotations : array_like, (n, 4) or (n, 3, 3)
        Quaternions (x, y, z, w), or matrices.
    name : str
        How errors call it.
    is_numbered : bool
        Stamps are the poses' numbers, not times.

    Raises
    ------
    ValueError
        If shapes do not fit together, stamps do not rise, or something is no rotation.
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
            raise ValueError(
                f"{name}: pose {i + 1}: stamp {self.stamps[i + 1]:.6f} s follows {self.stamps[i]:.6f} s, "
                "expected stamps that rise"
            )
        try:
            if turned.ndim == 3:
                turned = quaternions_of(nearest_rotations(turned))
            self.quaternions: Floats = unit_quaternions(turned)
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from None
        self._gaps = self._found_gaps()

    def __len__(self) -> int:
        """Number of poses."""
        return len(self.stamps)

    def __repr__(self) -> str:
        return (
            f"<Trajectory {self.name!r}, {len(self)} poses, {self.stamps[0]:.3f} to {self.stamps[-1]:.3f} s>"
        )

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
        return Pose(_matrix_of(*(a / length for a in between)), position)

    def poses_at(self, stamps: ArrayLike) -> tuple[Floats, Floats]:
        """Interpolated poses.

        Parameters
        ----------
        stamps : array_like, (n,)
            Times [s], in any order.

        Returns
        -------
        positions : (n, 3) float64
        quaternions : (n, 4) float64
            Unit quaternions (x, y, z, w).

        Raises
        ------
        ValueError
            A `NoPose`, if a time lies more than ``STAMP_TOLERANCE`` before the first or after the last pose;
            closer, it gets that pose. Or if it lies in a gap: between poses that are more than 1 s and 10
            times the usual interval apart, and more than 0.1 m or 0.1 rad in place.
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
        return positions, _slerp(self.quaternions[before], self.quaternions[after], share)

    def _found_gaps(self) -> NDArray[np.bool_] | None:
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

    def transformed(self, T_sensor_other: Pose) -> Trajectory:
        """The trajectory of something that is fixed to the sensor."""
        matrices = matrices_of(self.quaternions)
        return Trajectory(
            self.stamps,
            matrices @ T_sensor_other.position + self.positions,
            matrices @ T_sensor_other.rotation,
            name=self.name,
            is_numbered=self.is_numbered,
        )


def read_trajectory(
    path: str | os.PathLike[str], *, times: str | os.PathLike[str] | None = None
) -> Trajectory:
    """Read a trajectory file of TUM or KITTI; blank lines and comments behind # are passed over.

    Parameters
    ----------
    path : str or path
        8 numbers a line are a time [s], a position [m] and a quaternion (x, y, z, w); 12 are the upper three
        rows of a pose's matrix.
    times : str or path, optional
        Times of the poses of a KITTI file, one a line [s]. Left out, a pose's time is its number, from 0.

    Returns
    -------
    Trajectory

    Raises
    ------
    OSError
        If a file cannot be read.
    ValueError
        If a line is not as it should be: which, what was found, and what was expected.
    """
    name = os.fspath(path)
    rows = [(number, values) for number, values in _numbers(name)]
    if not rows:
        raise ValueError(f"{name}: no poses, {EXPECTED}")
    columns = len(rows[0][1])
    for number, values in rows:
        if columns not in (8, 12) or len(values) != columns:
            expected = EXPECTED if columns not in (8, 12) else f"expected {columns} as in the line before"
            raise ValueError(f"{name}: line {number}: found {len(values)} numbers, {expected}")
    table = np.array([values for _, values in rows])
    if columns == 8:
        if times is not None:
            raise ValueError(f"{name}: has times of its own, expected none in {os.fspath(times)}")
        rising = np.concatenate([[True], table[1:, 0] != table[:-1, 0]])  # A pose said twice is one.
        table = table[rising]
        return Trajectory(table[:, 0], table[:, 1:4], table[:, 4:], name=name)
    matrices = table.reshape(-1, 3, 4)
    stamps = np.arange(len(matrices), dtype=np.float64)
    if times is not None:
        stamps = read_times(times)
        if len(stamps) != len(matrices):
            raise ValueError(
                f"{os.fspath(times)}: {len(stamps)} times, "
                f"expected {len(matrices)} as there are poses in {name}"
            )
    return Trajectory(stamps, matrices[:, :, 3], matrices[:, :, :3], name=name, is_numbered=times is None)


def read_pose(path: str | os.PathLike[str]) -> Pose:
    """The pose in a file of its own: a matrix of 3x4 or 4x4 numbers, however broken into lines."""
    name = os.fspath(path)
    values = [value for _, line in _numbers(name) for value in line]
    if len(values) not in (12, 16):
        raise ValueError(f"{name}: found {len(values)} numbers, expected a matrix of 3x4 or 4x4")
    matrix = np.array(values).reshape(-1, 4)
    if not np.isfinite(matrix).all():
        raise ValueError(f"{name}: the pose is not finite")
    if len(matrix) == 4 and not np.allclose(matrix[3], (0, 0, 0, 1), atol=1e-9):
        raise ValueError(f"{name}: the last row is {matrix[3].tolist()}, expected 0 0 0 1")
    try:
        return Pose.from_matrix(matrix)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None


def trajectory_kind(path: str | os.PathLike[str]) -> str | None:
    """What the first line with anything on it looks like: "tum", "kitti", or None for neither."""
    try:
        _, values = next(_numbers(os.fspath(path)), (0, []))
    except ValueError:
        return None
    return {8: "tum", 12: "kitti"}.get(len(values))


def read_times(path: str | os.PathLike[str]) -> Floats:
    """Times of a file that has one number a line [s]."""
    name = os.fspath(path)
    stamps = []
    for number, values in _numbers(name):
        if len(values) != 1:
            raise ValueError(f"{name}: line {number}: found {len(values)} numbers, expected one, a time [s]")
        stamps.append(values[0])
    return np.array(stamps, dtype=np.float64)


def unit_quaternions(quaternions: Floats) -> Floats:
    """(n, 4) of length 1; ValueError if one is far from it."""
    with np.errstate(over="ignore"):
        length = np.linalg.norm(quaternions, axis=1)
    bad = ~(np.abs(length - 1) <= ROTATION_TOLERANCE)
    if bad.any():
        i = int(bad.argmax())
        raise ValueError(
            f"{_pose(i, bad)}quaternion {quaternions[i].tolist()} has length {length[i]:.3g}, expected 1"
        )
    return quaternions / length[:, None]


def nearest_rotations(matrices: Floats) -> Floats:
    """(n, 3, 3) freed of rounding; ValueError if one is far from a rotation."""
    departure = np.abs(matrices @ np.swapaxes(matrices, 1, 2) - np.eye(3)).max(axis=(1, 2))
    bad = ~(departure <= ROTATION_TOLERANCE) | ~(np.linalg.det(matrices) > 0)
    if bad.any():
        i = int(bad.argmax())
        raise ValueError(
            f"{_pose(i, bad)}{np.round(matrices[i], 4).tolist()} is no rotation, expected rows of length 1 "
            "at right angles"
        )
    left, _, right = np.linalg.svd(matrices)
    return left @ right


def _pose(i: int, among: NDArray[np.bool_]) -> str:
    return f"pose {i}: " if len(among) > 1 else ""


def matrices_of(quaternions: Floats) -> Floats:
    """(n, 3, 3) rotation matrices of (n, 4) unit quaternions (x, y, z, w)."""
    return np.moveaxis(_matrix_of(*quaternions.T), 2, 0)


def _matrix_of(x: Any, y: Any, z: Any, w: Any) -> Floats:
    """The rotation matrix of a unit quaternion; of arrays of them, along further axes."""
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternions_of(matrices: Floats) -> Floats:
    """(n, 4) unit quaternions (x, y, z, w) of (n, 3, 3) rotation matrices."""
    m = matrices
    trace = m[:, 0, 0] + m[:, 1, 1] + m[:, 2, 2]
    # The outer product of a quaternion with itself, times 4: its longest row is the safest to divide by.
    product = np.empty((len(m), 4, 4))
    for i in range(3):
        product[:, i, i] = 1 + 2 * m[:, i, i] - trace
        j, k = (i + 1) % 3, (i + 2) % 3
        product[:, j, k] = product[:, k, j] = m[:, j, k] + m[:, k, j]
        product[:, i, 3] = product[:, 3, i] = m[:, k, j] - m[:, j, k]
    product[:, 3, 3] = 1 + trace
    longest = np.argmax(product[:, range(4), range(4)], axis=1)
    rows = product[np.arange(len(m)), longest]
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


def _slerp(start: Floats, end: Floats, share: Floats) -> Floats:
    """Unit quaternions on the shorter way between others, with constant speed."""
    end = np.where(np.sum(start * end, axis=1, keepdims=True) < 0, -end, end)
    half = np.arctan2(np.linalg.norm(end - start, axis=1), np.linalg.norm(end + start, axis=1))
    angle = 2 * half
    sine = np.sin(angle)
    tiny = sine < STRAIGHT
    sine = np.where(tiny, 1.0, sine)
    before = np.where(tiny, 1 - share, np.sin((1 - share) * angle) / sine)
    after = np.where(tiny, share, np.sin(share * angle) / sine)
    between = before[:, None] * start + after[:, None] * end
    return between / np.linalg.norm(between, axis=1, keepdims=True)


def _numbers(path: str) -> Iterator[tuple[int, list[float]]]:
    """Numbers of each line that has any, and the line's number."""
    for number, line in text_lines(path):
        fields = line.split("#", 1)[0].replace(",", " ").split()
        if not fields:
            continue
        try:
            yield number, [float(field) for field in fields]
        except ValueError:
            found = " ".join(fields)[:40]
            raise ValueError(f"{path}: line {number}: found {found!r}, expected only numbers") from None
