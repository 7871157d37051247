# SPDX-License-Identifier: BSD-3-Clause
"""Positions and rotations: poses, quaternions and matrices."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ndtree._errors import WrongValue, key
from ndtree._native._core import moved_points
from ndtree.logs.core.arrays import Bools, Floats

#: Larger departures from a rotation are mistakes, smaller ones rounding.
ROTATION_TOLERANCE = 0.02
#: Sine of an angle below which an arc is its chord to the last bit.
STRAIGHT = 1e-9


@dataclass(frozen=True, eq=False)
class Pose:
    """A rigid transform, as in ``T_map_sensor``: from sensor coordinates to the map's.

    `position` (3,) float64: Where the sensor's origin lies in the map [m].
    """

    rotation: Floats  # (3, 3) float64.
    position: Floats

    @staticmethod
    def identity() -> Pose:
        """The transform that changes nothing."""
        return Pose(np.eye(3), np.zeros(3))

    @staticmethod
    def from_matrix(matrix: ArrayLike) -> Pose:
        """From a (3, 4) or (4, 4) matrix; ValueError if its left part is no rotation, or it is not finite."""
        values = np.asarray(matrix, dtype=np.float64)
        if values.shape not in ((3, 4), (4, 4)):
            raise ValueError(f"a pose has shape {values.shape}: must be (3, 4) or (4, 4)")
        return Pose(nearest_rotations(values[None, :3, :3])[0], _finite(values[:3, 3]))

    @staticmethod
    def from_quaternion(position: ArrayLike, quaternion: ArrayLike) -> Pose:
        """From (3,) metres and a quaternion (x, y, z, w); ValueError if its length is not 1."""
        rotation = matrices_of(unit_quaternions(np.asarray(quaternion, dtype=np.float64)[None]))[0]
        return Pose(rotation, _finite(np.asarray(position, dtype=np.float64)))

    def apply(self, points: ArrayLike) -> Floats:
        """Points (n, 3) in the map frame, float64 whatever they were [m]; not finite where they were not."""
        return moved_points(points, self.rotation, self.position)

    def inverse(self) -> Pose:
        """The transform back."""
        return Pose(self.rotation.T, -rotated(self.rotation.T, self.position))

    @staticmethod
    def planar(x: float, y: float, yaw: float) -> Pose:
        """From a place [m] and a yaw [rad] in the plane z = 0."""
        cos, sin = math.cos(yaw), math.sin(yaw)
        rotation = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        return Pose(rotation, np.array([x, y, 0.0]))

    @property
    def is_identity(self) -> bool:
        """Whether it changes nothing."""
        return not self.position.any() and np.array_equal(self.rotation, np.eye(3))

    @property
    def yaw(self) -> float:
        """[rad]"""
        return math.atan2(self.rotation[1, 0], self.rotation[0, 0])

    def level(self) -> Pose:
        """The pose in the plane below: x, y and yaw of this one."""
        return Pose.planar(self.position[0], self.position[1], self.yaw)

    def matrix(self, dim: int) -> Floats:
        """(dim + 1, dim + 1), as maps take poses; in 2-D of a level pose."""
        whole = np.eye(dim + 1)
        whole[:dim, :dim] = self.rotation[:dim, :dim]
        whole[:dim, dim] = self.position[:dim]
        return whole

    def __matmul__(self, other: Pose) -> Pose:
        """First `other`, then this one: ``T_map_body @ T_body_sensor``."""
        position = rotated(self.rotation, other.position) + self.position
        return Pose(multiplied(self.rotation, other.rotation), position)


def rotated(rotations: Floats, points: Floats) -> Floats:
    """Points (..., 3) by rotations (..., 3, 3).

    Here and in `multiplied` terms are added in the order of axes, each rounded: a library of linear algebra
    would do what suits the processor, and the last bits of a map would differ from machine to machine.
    """
    terms = [rotations[..., j] * points[..., j, None] for j in range(3)]
    return terms[0] + terms[1] + terms[2]


def multiplied(left: Floats, right: Floats) -> Floats:
    """Matrices (..., 3, 3) by matrices."""
    terms = [left[..., j, None] * right[..., j, None, :] for j in range(3)]
    return terms[0] + terms[1] + terms[2]


def about_axes(x: float, y: float, z: float) -> tuple[Floats, Floats, Floats]:
    """The rotations about x, about y, and about z by angles [rad]."""
    (a, b), (c, d), (e, f) = ((math.cos(angle), math.sin(angle)) for angle in (x, y, z))
    about_x = np.array([[1, 0, 0], [0, a, -b], [0, b, a]])
    about_y = np.array([[c, 0, d], [0, 1, 0], [-d, 0, c]])
    return about_x, about_y, np.array([[e, -f, 0], [f, e, 0], [0, 0, 1]])


def unit_quaternions(quaternions: Floats) -> Floats:
    """(n, 4) of length 1; ValueError if one is far from it."""
    with np.errstate(over="ignore"):
        length = np.linalg.norm(quaternions, axis=1)
    bad = ~(np.abs(length - 1) <= ROTATION_TOLERANCE)
    if bad.any():
        i = int(bad.argmax())
        said = f"{_pose(i, bad)}quaternion {quaternions[i].tolist()}"
        raise ValueError(f"{said} has length {length[i]:.3g}, expected 1")
    return quaternions / length[:, None]


def nearest_rotations(matrices: Floats) -> Floats:
    """(n, 3, 3) freed of rounding; ValueError if one is far from a rotation."""
    departure = np.abs(matrices @ np.swapaxes(matrices, 1, 2) - np.eye(3)).max(axis=(1, 2))
    bad = ~(departure <= ROTATION_TOLERANCE) | ~(np.linalg.det(matrices) > 0)
    if bad.any():
        i = int(bad.argmax())
        said = f"{_pose(i, bad)}{np.round(matrices[i], 4).tolist()} is not a rotation"
        raise ValueError(f"{said}, expected rows of length 1 at right angles, and no mirror")
    left, _, right = np.linalg.svd(matrices)
    return left @ right


def _finite(position: Floats) -> Floats:
    if not np.isfinite(position).all():
        raise ValueError(f"a pose is at {position.tolist()}: must be finite")
    return position


def _pose(i: int, among: Bools) -> str:
    return f"pose {i}: " if len(among) > 1 else ""


def matrices_of(quaternions: Floats) -> Floats:
    """(n, 3, 3) rotation matrices of (n, 4) unit quaternions (x, y, z, w)."""
    return np.moveaxis(matrix_of(*quaternions.T), 2, 0)


def matrix_of(x: Any, y: Any, z: Any, w: Any) -> Floats:
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


def slerp(start: Floats, end: Floats, share: Floats) -> Floats:
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


MOUNT_EXPECTED = "expected x,y,z,roll,pitch,yaw or x,y,yaw, metres, and radians or as in 90deg"


def mount_of(text: str) -> Pose:
    """The pose of a sensor on its base.

    `text`: ``"x,y,z,roll,pitch,yaw"``, or in the plane ``"x,y,yaw"``: metres, and radians or degrees with
        "deg" behind the number. As in URDF the sensor is turned about the base's x axis (roll), then about
        its y, then about its z axis.
    Raises ValueError if it is something else. An angle in radians of more than one turn is taken as a
    mistake.
    """
    fields = text.split(",")
    if len(fields) not in (3, 6):
        raise WrongValue(f"{key('mount')} = {text!r}: {len(fields)} numbers, {MOUNT_EXPECTED}")
    lengths = fields[:2] if len(fields) == 3 else fields[:3]
    try:
        position = [float(field) for field in lengths]
        angles = [_angle(field) for field in fields[len(lengths) :]]
    except ValueError:
        raise WrongValue(f"{key('mount')} = {text!r}: {MOUNT_EXPECTED}") from None
    if not all(math.isfinite(value) for value in (*position, *angles)):
        raise WrongValue(f"{key('mount')} = {text!r}: {MOUNT_EXPECTED}, all of them finite")
    if any(abs(angle) > 2 * math.pi + 1e-9 for angle in angles):
        raise WrongValue(f"{key('mount')} = {text!r}: an angle of more than one turn, {MOUNT_EXPECTED}")
    if len(fields) == 3:
        position, angles = [*position, 0.0], [0.0, 0.0, *angles]
    about_x, about_y, about_z = about_axes(*angles)
    return Pose(about_z @ about_y @ about_x, np.array(position))


def _angle(field: str) -> float:
    field = field.strip()
    if field.endswith("deg"):
        return math.radians(float(field[:-3]))
    return float(field)
