# SPDX-License-Identifier: BSD-3-Clause
"""Clouds of lidars and scans of planar lasers as flat patches of surface, and how one lies to another.

Strategy: points are put into cubes of four sizes. Where those of a cube spread as on a plane, it holds a
patch: their mean, and the normal. Patches of one cloud are moved onto the planes of another's, of large
cubes first (Gauss-Newton, with Student's weights). A plane says nothing along itself, so that the pattern of
the rings does not count, and what a corridor does not tell has a large covariance.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndtree.alignment.planar import Floats
from ndtree.base.scan import Scan

_SHELL = 0.1  # Before the largest range [m].
_MOST_POINTS = 6000  # Of a cloud, about.
_SIZES = (0.25, 0.5, 1.0, 2.0)  # Edges of cubes [m]; the first of scans in the plane alone.
_ROUNDS, _STILL = 8, 1e-3  # Of each; until nothing is moved farther [m, rad].
_LEAST_POINTS, _LEAST_BEAMS = 6, 4  # Of a patch in space and in the plane.
_FLAT, _WIDE = 0.02, 0.1  # Variances of a plane: the least to the middle one; its root to the edge.
FITS = 0.3  # Of the patches, in clouds that fit each other.
_FEWEST = 12  # Patches that tell how a cloud lies.
_EDGE = 0.04  # What a sensor sees edge-on are beams to a post, not a surface: their plane is so near [m].
_PARALLEL = 0.9  # Cosine of normals of the same surface.
_ERROR = 0.02  # Of a patch, beside half of its thickness [m].
_SLANT = math.sqrt(_FLAT)  # What is flat enough may be turned by that [rad].
_FREEDOM = 2.0  # Of Student's t.
_START = np.array([1.0, 1.0, 1.0, 0.35, 0.35, 0.35])  # How far patches are from their places [m, rad].
_BESIDE = 0.1  # Of its plane, a patch is on it [m].
_BEHIND = 1.5  # Times as far, a point is behind another.
_BEAMS = 180  # The next beam of a scan of 180 shows how a surface is turned.
_CUBES = 2048  # On each side of the sensor.
_NONE = 1e-4  # Information that is none [1/m², 1/rad²].
_USUAL = 5.0  # Range for which cubes have these sizes [m].


@dataclass(frozen=True)
class _Patches:
    """Flat patches of a cloud, in the order of their `keys`: by size, then by side, then by cube."""

    keys: NDArray[np.int64]
    level: NDArray[np.int64]  # Of the size.
    mean: Floats
    normal: Floats
    variance: Floats  # Along the normal [m²].
    slant: Floats  # Of the normal's angle, at most: thickness over width, squared [rad²].
    sides: int

    @classmethod
    def of(cls, parts: list[Floats], has_walls: bool) -> _Patches:
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
        return cls(keys[order], *(one[order] for one in columns), len(parts))


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


@dataclass(frozen=True)
class Cloud:
    """Some beams of a lidar's cloud or of a planar laser's scan, and the sensor's pose (4, 4) in the map."""

    scan: Scan
    pose: Floats

    @classmethod
    def of(cls, scan: Scan) -> Cloud | None:
        """Beams of all rings, in the map's axes where a scan's log does not say how the sensor is turned.

        None of points without a sensor, or where it is nowhere.
        """
        origins = np.atleast_2d(scan.origin)
        rotation = scan.rotation if scan.rotation is not None else np.eye(3)
        if scan.dim == 2 and scan.heading is not None:
            rotation = turned_by(np.array([0.0, 0.0, scan.heading]))
        if scan.points_only or not len(origins):
            return None
        pose = np.eye(4)
        pose[:3, :3], pose[: scan.dim, 3] = rotation, origins.mean(axis=0, dtype=np.float64)
        if not np.isfinite(pose).all():
            return None
        step = len(scan) // _MOST_POINTS | 1  # Rings are even in number.
        return cls(scan.only(slice(None, None, step if step % 5 else step + 2)), pose)

    def times(self, scale: float) -> Cloud:
        """With all lengths that many times as large."""
        scan, pose = self.scan, self.pose.copy()
        pose[:3, 3] *= scale
        return Cloud(replace(scan, endpoints=scan.endpoints * scale, origin=scan.origin * scale), pose)

    def at(self, stamp: float) -> Cloud:
        """With another time."""
        return replace(self, scan=replace(self.scan, stamp=stamp))

    def cut(self, rule: Callable[[Scan], Scan]) -> Cloud:
        """With beams as a rule has them, by which some have not returned."""
        return replace(self, scan=rule(self.scan))

    @property
    def stamp(self) -> float:
        return self.scan.stamp

    @property
    def is_turned(self) -> bool:
        """Whether the log says how the sensor is turned."""
        return (self.scan.rotation if self.scan.dim == 3 else self.scan.heading) is not None

    @property
    def ranges(self) -> Floats:
        """Of the beams that met something [m]."""
        lengths: Floats = np.linalg.norm(self.scan.endpoints - self.scan.origin, axis=1)
        return lengths[self.scan.hits()]

    @cached_property
    def points(self) -> Floats:
        """In the sensor's frame; at the largest range may be beams without echo."""
        dim = self.scan.dim
        ways = self.scan.endpoints[self.scan.did_return].astype(np.float64) - self.pose[:dim, 3]
        ways = ways[np.isfinite(ways).all(axis=1)]
        ranges = np.linalg.norm(ways, axis=1)
        points: Floats = ways[ranges < ranges.max(initial=0.0) - _SHELL] @ self.pose[:dim, :3]
        return points

    @cached_property
    def patches(self) -> _Patches:
        """In the sensor's frame."""
        is_planar = self.scan.dim == 2
        return _Patches.of(_sides(self.points) if is_planar else [self.points], is_planar)

    def hidden_less(self) -> float:
        """How much less of the points is far behind others if the eye is at the pose's place in their own
        frame, as it is for points in the map's frame; 0 if that is farther from them.
        """
        shares, usual = [], []
        for eye in (np.zeros(3), self.pose[:3, 3]):
            ways = self.points - eye
            ranges = np.linalg.norm(ways, axis=1).clip(1e-9)
            up, around = np.arcsin(ways[:, 2] / ranges), np.arctan2(ways[:, 1], ways[:, 0])
            _, which = np.unique(
                np.rint(np.degrees(up)) + 1000 * np.rint(np.degrees(around)), return_inverse=True
            )
            nearest = np.full(len(ranges), np.inf)
            np.minimum.at(nearest, which, ranges)
            shares.append(float(np.mean(ranges > _BEHIND * nearest[which])) if len(ranges) else 0.0)
            usual.append(float(np.median(ranges)) if len(ranges) else 0.0)
        return shares[0] - shares[1] if usual[1] <= usual[0] else 0.0

    def agreement(self, other: Cloud, motion: Floats) -> float:
        """Which part of another's patches lies on planes of this one, with its pose as seen from here."""
        off = self._met(other, motion)[1]
        return float(np.exp(-0.5 * (off / _BESIDE) ** 2).sum()) / max(len(other.patches.keys), 1)

    @cached_property
    def reach(self) -> float:
        """The usual range [m]; 0 without points."""
        return float(np.median(np.linalg.norm(self.points, axis=1))) if len(self.points) else 0.0

    @cached_property
    def middle(self) -> Floats:
        """Of its points, in the map [m]."""
        result: Floats = self.pose[:3, :3] @ self.points.mean(axis=0) + self.pose[:3, 3]
        return result

    def displacement(self, other: Cloud) -> tuple[Floats, Floats] | None:
        """By how much another cloud lies otherwise than the poses say, and the covariance of that.

        By the patches that meet where the poses have them, and by no others: what repeats nearby, as rails or
        the pattern of the rings, would fit, too. Nor does it lie otherwise along what only seems to be told,
        by normals that err. None if few meet.

        Returns (6,) place and turn, on the left, and (6, 6), huge where nothing tells.
        """
        normal, off, arm, variance, slant, which = self._met(other, np.linalg.inv(self.pose) @ other.pose)
        faces = np.abs(np.einsum("ni,ni->n", normal, arm)) > _EDGE
        normal, off, arm, variance, slant, which = (
            one[faces] for one in (normal, off, arm, variance, slant, which)
        )
        if len(np.unique(which)) < max(_FEWEST, FITS * len(other.patches.keys)):
            return None
        rows = np.hstack((normal, _crossed(arm, normal)))
        change = np.zeros(6)
        for is_near in _ROUNDS * [False] + _ROUNDS * [True]:  # At first, all that is far off seems wrong.
            weights = (_FREEDOM + 1) / (_FREEDOM * variance + (off + rows @ change) ** 2)
            information = (rows * weights[:, None]).T @ rows
            change = -np.linalg.solve(information + np.diag(_START**-2), rows.T @ (weights * off))
            seem = _of_points(arm, weights * slant)
            if is_near:
                root, axes, times = _times(information, seem)
                change = np.linalg.solve(root.T, (axes * (times > 1.0)) @ axes.T @ root.T @ change)
        return change, _covariance(information, seem, len(_levels(self.scan.dim == 2)))

    def matched(self, other: Cloud, motion: Floats) -> tuple[Floats, Floats]:
        """The pose of another cloud as seen from this one, (4, 4), near a guess of it; and its covariance.

        That is (6, 6), of its place and of a turn on the left of its rotation; huge where nothing tells.
        """
        pose = motion.copy()
        levels = _levels(self.scan.dim == 2)
        for level in reversed(levels):
            for _ in range(_ROUNDS):
                normal, off, arm, variance, slant, _ = self._met(other, pose, level)
                rows = np.hstack((normal, _crossed(arm, normal)))
                weights = (_FREEDOM + 1) / (_FREEDOM * variance + off**2)
                information = (rows * weights[:, None]).T @ rows
                away = np.append(pose[:3, 3] - motion[:3, 3], turn_of(pose[:3, :3] @ motion[:3, :3].T))
                slope = rows.T @ (weights * off) + away / _START**2
                change = -np.linalg.solve(information + np.diag(_START**-2), slope).clip(-_START, _START)
                pose[:3, 3] += change[:3]
                pose[:3, :3] = turned_by(change[3:]) @ pose[:3, :3]
                if np.abs(change).max() < _STILL:
                    break
        return pose, _covariance(information, _of_points(arm, weights * slant), len(levels))

    def _met(
        self, other: Cloud, motion: Floats, level: int = 0
    ) -> tuple[Floats, Floats, Floats, Floats, Floats, NDArray[np.int64]]:
        """Another's patches, of a size and larger ones, that meet planes.

        Returns (n, 3) normals of these, (n,) how far they are off, (n, 3) whence they are seen, (n,)
        variances of being off and of the normal's angle, and (n,) their numbers.
        """
        one, two = self.patches, other.patches
        which = np.arange(int(np.searchsorted(two.keys, _key(level, 0))), len(two.keys))
        arm = two.mean @ motion[:3, :3].T
        cubes = _cubes((arm + motion[:3, 3])[which], np.array(_SIZES)[two.level[which], None])
        keys = np.concatenate([cubes + _key(two.level[which], side) for side in range(one.sides)])
        which = np.tile(which, one.sides)
        at = np.searchsorted(one.keys, keys).clip(max=max(len(one.keys) - 1, 0))
        met = one.keys[at] == keys if len(one.keys) else np.zeros(len(keys), bool)
        at, which = at[met], which[met]
        cosine = np.einsum("ni,ni->n", one.normal[at], two.normal[which] @ motion[:3, :3].T)
        use = np.abs(cosine) > _PARALLEL
        at, which = at[use], which[use]
        normal, arm = one.normal[at], arm[which]
        off = np.einsum("ni,ni->n", normal, arm + motion[:3, 3] - one.mean[at])
        variance = _ERROR**2 + 0.25 * (one.variance[at] + two.variance[which])
        return normal, off, arm, variance, one.slant[at] + _SLANT**2, which


def unit_of(clouds: Sequence[Cloud]) -> float:
    """What lengths of clouds are multiplied by: 1 but for absurd ones, which have hardly any patches."""
    clouds = clouds[::64]
    usual = float(np.median(np.concatenate([*(one.ranges for one in clouds), [_USUAL]])))
    if 0.1 * _USUAL < usual < 10 * _USUAL:
        return 1.0
    told, scaled = (sum(len(one.times(by).patches.keys) for one in clouds) for by in (1.0, _USUAL / usual))
    return 1.0 if 4 * told > scaled else _USUAL / usual


def _sides(points: Floats) -> list[Floats]:
    """Points of a planar laser by whether their surface lies rather along its x or its y axis.

    So the sides of a corner are patches of their own, as of a recess in a corridor, which alone tells how far
    the sensor moved along.
    """
    beams = 1 + len(points) // _BEAMS
    low, high = (np.arange(len(points)) + by for by in (-beams, beams))
    along = np.abs(points[high.clip(max=len(points) - 1)] - points[low.clip(0)])
    is_x = along[:, 0] > along[:, 1]
    return [points[is_x], points[~is_x]]


def _covariance(information: Floats, seem: Floats, levels: int) -> Floats:
    """Of a match whose patches tell that much, of which a part only seems so, by normals that err.

    Directions are told by how many times as much as that, whatever their units.
    `levels`: Of patches that each surface has.
    """
    root, axes, times = _times(information, seem)
    told = root @ (axes * (times - 1.0).clip(0.0)) @ axes.T @ root.T / levels
    covariance: Floats = np.linalg.inv(told + _NONE * np.eye(6))
    return covariance


def _crossed(ones: Floats, others: Floats) -> Floats:
    """(n, 3) cross products."""
    (a, b, c), (x, y, z) = ones.T, others.T
    return np.stack((b * z - c * y, c * x - a * z, a * y - b * x), axis=-1)


def _times(information: Floats, seem: Floats) -> tuple[Floats, Floats, Floats]:
    """How many times as much as only seems so is told, along which axes, in units whose root comes first."""
    root = np.linalg.cholesky(seem + _NONE * np.eye(6))
    inverse = np.linalg.inv(root)
    times, axes = np.linalg.eigh(inverse @ information @ inverse.T)
    return root, axes, times


def _of_points(arm: Floats, weights: Floats) -> Floats:
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
