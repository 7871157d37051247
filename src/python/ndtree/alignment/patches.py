# SPDX-License-Identifier: BSD-3-Clause
"""Points of a sensor as flat patches of surface, and how one sensor's lie to another's.

Strategy: points are put into cubes of four sizes. Where those of a cube spread as on a plane, it holds a
patch: their mean, and the normal. Patches of one cloud are moved onto the planes of another's, of large
cubes first (Gauss-Newton, with Student's weights). A plane says nothing along itself, so that the pattern of
the rings does not count, and what a corridor does not tell has no information.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndtree.alignment.planar import Floats

_SIZES = (0.25, 0.5, 1.0, 2.0)  # Edges of cubes [m]; the first of scans in the plane alone.
_ROUNDS, _STILL = 8, 1e-3  # Of each; until nothing is moved farther [m, rad].
_LEAST_POINTS, _LEAST_BEAMS = 6, 4  # Of a patch in space and in the plane.
_FLAT, _WIDE = 0.02, 0.1  # Variances of a plane: the least to the middle one; its root to the edge.
_PARALLEL = 0.9  # Cosine of normals of the same surface.
_ERROR = 0.02  # Of a patch, beside half of its thickness [m].
_SLANT = math.sqrt(_FLAT)  # What is flat enough may be turned by that [rad].
FREEDOM = 2.0  # Of Student's t.
START = np.array([1.0, 1.0, 1.0, 0.35, 0.35, 0.35])  # How far patches are from their places [m, rad].
_BESIDE = 0.1  # Of its plane, a patch is on it [m].
_CROWD = 1.0  # Edge of cubes in which points are among others [m].
_CUBES = 2048  # On each side of the sensor.
NONE = 1e-4  # Information that is none [1/m², 1/rad²].


@dataclass(frozen=True)
class Patches:
    """Flat patches of a cloud, in the order of their `keys`: by size, then by side, then by cube."""

    keys: NDArray[np.int64]
    level: NDArray[np.int64]  # Of the size.
    mean: Floats
    normal: Floats
    variance: Floats  # Along the normal [m²].
    slant: Floats  # Of the normal's angle, at most: thickness over width, squared [rad²].
    sides: int
    levels: int  # Patches that each surface has: one of each size.

    @classmethod
    def of(cls, parts: list[Floats], *, has_walls: bool = False) -> Patches:
        """Of the points on each side.

        `has_walls`: All points are at one height, of walls that stand.
        """
        found = [
            (_key(level, side) + cubes, np.full(len(cubes), level), *flat)
            for side, points in enumerate(parts)
            for level, cubes, *flat in _flat(points, has_walls)
        ]
        keys, *columns = map(np.concatenate, zip(*found))
        order = np.argsort(keys)
        return cls(keys[order], *(one[order] for one in columns), len(parts), len(_levels(has_walls)))

    def matched(
        self, other: Patches, motion: Floats, start: Floats = START, odd: float = 0.0
    ) -> tuple[Floats, Floats]:
        """The pose of another cloud as seen from this one, (4, 4), near a guess of it; and what tells it.

        That is information (6, 6), of its place and of a turn on the left of its rotation; 0 where nothing
        tells, or only seems to, by normals that err.
        `start` (6,): How near the guess may be, as deviations.
        `odd`: Part of the patches that may be of no surface, a third of it along each axis: where a ring goes
            from the floor to a wall, its points lie on a plane across both.
        """
        pose = motion.copy()
        for level in reversed(range(len(_SIZES) - self.levels, len(_SIZES))):
            for _ in range(_ROUNDS):
                normal, off, arm, variance, slant, _ = self.met(other, pose, level)
                rows = np.hstack((normal, crossed(arm, normal)))
                weights = (FREEDOM + 1) / (FREEDOM * variance + off**2)
                information = (rows * weights[:, None]).T @ rows
                away = off_by(motion, pose)
                slope = rows.T @ (weights * off) + away / start**2
                change = -np.linalg.solve(information + np.diag(start**-2), slope).clip(-start, start)
                pose[:3, 3] += change[:3]
                pose[:3, :3] = turned_by(change[3:]) @ pose[:3, :3]
                if np.abs(change).max() < _STILL:
                    break
        return pose, told(information, of_points(arm, weights * (slant + odd / 3.0)), self.levels)

    def agreement(self, other: Patches, motion: Floats) -> float:
        """Which part of another's patches lies on planes of this one, with its pose as seen from here."""
        off = self.met(other, motion)[1]
        return float(np.exp(-0.5 * (off / _BESIDE) ** 2).sum()) / max(len(other.keys), 1)

    def holds(self, points: Floats) -> NDArray[np.bool_]:
        """Which of points (n, 3), as seen from here, lie on planes."""
        is_on = np.zeros(len(points), bool)
        for level in range(len(_SIZES) - self.levels, len(_SIZES)):
            at, which = self._at(_cubes(points, _SIZES[level]) + _key(level, 0))
            off = np.einsum("ni,ni->n", self.normal[at], points[which] - self.mean[at])
            is_on[which] |= np.abs(off) < _BESIDE
        return is_on

    def _at(self, keys: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Numbers of the patches that have keys, and which of the keys these are."""
        at = np.searchsorted(self.keys, keys)
        which = np.flatnonzero(np.append(self.keys, -1)[at] == keys)
        return at[which], which

    def met(
        self, other: Patches, motion: Floats, level: int = 0
    ) -> tuple[Floats, Floats, Floats, Floats, Floats, NDArray[np.int64]]:
        """Another's patches, of a size and larger ones, that meet planes.

        Returns (n, 3) normals of these, (n,) how far they are off, (n, 3) whence they are seen, (n,)
        variances of being off and of the normal's angle, and (n,) their numbers.
        """
        one, two = self, other
        which = np.arange(int(np.searchsorted(two.keys, _key(level, 0))), len(two.keys))
        arm = two.mean @ motion[:3, :3].T
        cubes = _cubes((arm + motion[:3, 3])[which], np.array(_SIZES)[two.level[which], None])
        keys = np.concatenate([cubes + _key(two.level[which], side) for side in range(one.sides)])
        at, met = one._at(keys)
        which = np.tile(which, one.sides)[met]
        cosine = np.einsum("ni,ni->n", one.normal[at], two.normal[which] @ motion[:3, :3].T)
        use = np.abs(cosine) > _PARALLEL
        at, which = at[use], which[use]
        normal, arm = one.normal[at], arm[which]
        off = np.einsum("ni,ni->n", normal, arm + motion[:3, 3] - one.mean[at])
        variance = _ERROR**2 + 0.25 * (one.variance[at] + two.variance[which])
        return normal, off, arm, variance, one.slant[at] + _SLANT**2, which


def among(points: Floats, others: Floats) -> NDArray[np.bool_]:
    """Which of points (n, 3) lie among enough others to tell whether they are on a plane."""
    cubes, count = np.unique(_cubes(others, _CROWD), return_counts=True)
    return np.isin(_cubes(points, _CROWD), cubes[count >= _LEAST_POINTS])


def _flat(points: Floats, has_walls: bool) -> Iterator[tuple[Any, ...]]:
    """Of each size, its level and patches: of the smallest cubes by points, of others by these cubes."""
    counts: Floats = np.ones(len(points))
    sums = points
    squares = points[:, [0, 0, 0, 1, 1, 2]] * points[:, [0, 1, 2, 1, 2, 2]]
    for level in _levels(has_walls):
        size = _SIZES[level]
        cubes, which = np.unique(_cubes(points, size), return_inverse=True)
        columns = (counts, *sums.T, *squares.T)
        counts, *both = (np.bincount(which, one, len(cubes)).astype(float) for one in columns)
        sums, squares = np.stack(both[:3], axis=-1), np.stack(both[3:], axis=-1)
        points = sums / np.maximum(counts, 1)[:, None]  # Of a cube, its mean stands for it.
        use = counts >= (_LEAST_POINTS if not has_walls else _LEAST_BEAMS)
        mean = points[use]
        spread = (squares[use] / counts[use, None])[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
        spread = spread - mean[:, :, None] * mean[:, None]
        spread[:, 2, 2] += has_walls * size**2 / 12  # From the cube's floor to its top.
        values, axes = np.linalg.eigh(spread)
        flat = (values[:, 0] < _FLAT * values[:, 1]) & (values[:, 1] > (_WIDE * size) ** 2)
        values = values[flat].clip(0.0)
        yield level, cubes[use][flat], mean[flat], axes[flat, :, 0], values[:, 0], values[:, 0] / values[:, 1]


def _levels(has_walls: bool) -> range:
    return range(0 if has_walls else 1, len(_SIZES))


def _cubes(points: Floats, size: float | Floats) -> NDArray[np.int64]:
    """That points are in; the sensor is in the middle of one."""
    x, y, z = (np.rint(points / size).clip(-_CUBES, _CUBES - 1) + _CUBES).astype(np.int64).T
    return (x << 24) + (y << 12) + z


def _key(level: int | NDArray[np.int64], side: int) -> int | NDArray[np.int64]:
    return (level << 37) + (side << 36)


def told(information: Floats, seem: Floats, levels: int) -> Floats:
    """Information of patches (6, 6), less that which normals that err would give.

    Directions have as many times as much as that, whatever their units.
    `levels`: Of patches that each surface has.
    """
    root, axes, times = times_of(information, seem)
    result: Floats = root @ (axes * (times - 1.0).clip(0.0)) @ axes.T @ root.T / levels
    return result


def covariance_of(information: Floats) -> Floats:
    """Of what is told so much, huge where nothing is."""
    covariance: Floats = np.linalg.inv(information + NONE * np.eye(6))
    return covariance


def off_by(motion: Floats, pose: Floats) -> Floats:
    """By how much a pose is elsewhere than another (6,): the place, and a turn on the left."""
    return np.append(pose[:3, 3] - motion[:3, 3], turn_of(pose[:3, :3] @ motion[:3, :3].T))


def crossed(ones: Floats, others: Floats) -> Floats:
    """(n, 3) cross products."""
    (a, b, c), (x, y, z) = ones.T, others.T
    return np.stack((b * z - c * y, c * x - a * z, a * y - b * x), axis=-1)


def times_of(information: Floats, seem: Floats) -> tuple[Floats, Floats, Floats]:
    """How many times as much as only seems so is told, along which axes, in units whose root comes first."""
    root = np.linalg.cholesky(seem + NONE * np.eye(6))
    inverse = np.linalg.inv(root)
    times, axes = np.linalg.eigh(inverse @ information @ inverse.T)
    return root, axes, times


def of_points(arm: Floats, weights: Floats) -> Floats:
    """The information (6, 6) of points that were known in all directions, seen from (n, 3)."""
    x, y, z = weights @ arm
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    square = (arm * weights[:, None]).T @ arm
    return np.block([[weights.sum() * np.eye(3), -cross], [cross, np.trace(square) * np.eye(3) - square]])


def turn_of(rotation: Floats) -> Floats:
    """The axis of a rotation times its angle (3,), up to pi."""
    axis = 0.5 * np.array(
        [rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]]
    )
    sine, cosine = float(np.linalg.norm(axis)), 0.5 * (float(np.trace(rotation)) - 1.0)
    if cosine < 0.0 and sine < 1e-6:  # Half a turn: turn + 1 = 2 axis axis^T.
        column = (rotation + np.eye(3))[:, int(np.argmax(np.diag(rotation)))]
        half: Floats = math.pi * column / np.linalg.norm(column)
        return half
    turn: Floats = axis * (math.atan2(sine, cosine) / sine if sine > 1e-12 else 1.0)
    return turn


def turned_by(turn: Floats) -> Floats:
    """The rotation of `turn_of`."""
    angle = float(np.linalg.norm(turn))
    x, y, z = turn
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sine = math.sin(angle) / angle if angle > 1e-12 else 1.0
    versine = (1.0 - math.cos(angle)) / angle**2 if angle > 1e-6 else 0.5
    rotation: Floats = np.eye(3) + sine * cross + versine * cross @ cross
    return rotation
