# SPDX-License-Identifier: BSD-3-Clause
"""Clouds of lidars and scans of planar lasers, and how one lies to another by their flat patches."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ndtree.alignment.patches import (
    FREEDOM,
    START,
    Patches,
    covariance_of,
    crossed,
    of_points,
    times_of,
    told,
    turned_by,
)
from ndtree.alignment.planar import Floats
from ndtree.base.scan import Scan

_SHELL = 0.1  # Before the largest range [m].
_MOST_POINTS = 6000  # Of a cloud, about.
_ROUNDS = 8  # Of weighing.
FITS = 0.3  # Of the patches, in clouds that fit each other.
_FEWEST = 12  # Patches that tell how a cloud lies.
_EDGE = 0.04  # What a sensor sees edge-on are beams to a post, not a surface: their plane is so near [m].
_BEHIND = 1.5  # Times as far, a point is behind another.
_BEAMS = 180  # The next beam of a scan of 180 shows how a surface is turned.
_USUAL = 5.0  # Range for which cubes have these sizes [m].


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
    def patches(self) -> Patches:
        """In the sensor's frame."""
        is_planar = self.scan.dim == 2
        return Patches.of(_sides(self.points) if is_planar else [self.points], has_walls=is_planar)

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
        return self.patches.agreement(other.patches, motion)

    def matched(self, other: Cloud, motion: Floats) -> tuple[Floats, Floats]:
        """The pose of another cloud as seen from this one, (4, 4), near a guess of it; and its covariance.

        That is (6, 6), of its place and of a turn on the left of its rotation; huge where nothing tells.
        """
        pose, information = self.patches.matched(other.patches, motion)
        return pose, covariance_of(information)

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
        normal, off, arm, variance, slant, which = self.patches.met(
            other.patches, np.linalg.inv(self.pose) @ other.pose
        )
        faces = np.abs(np.einsum("ni,ni->n", normal, arm)) > _EDGE
        normal, off, arm, variance, slant, which = (
            one[faces] for one in (normal, off, arm, variance, slant, which)
        )
        if len(np.unique(which)) < max(_FEWEST, FITS * len(other.patches.keys)):
            return None
        rows = np.hstack((normal, crossed(arm, normal)))
        change = np.zeros(6)
        for is_near in _ROUNDS * [False] + _ROUNDS * [True]:  # At first, all that is far off seems wrong.
            weights = (FREEDOM + 1) / (FREEDOM * variance + (off + rows @ change) ** 2)
            information = (rows * weights[:, None]).T @ rows
            change = -np.linalg.solve(information + np.diag(START**-2), rows.T @ (weights * off))
            seem = of_points(arm, weights * slant)
            if is_near:
                root, axes, times = times_of(information, seem)
                change = np.linalg.solve(root.T, (axes * (times > 1.0)) @ axes.T @ root.T @ change)
        return change, covariance_of(told(information, seem, self.patches.levels))


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
