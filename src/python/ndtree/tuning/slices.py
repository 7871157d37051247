# SPDX-License-Identifier: BSD-3-Clause
"""Clouds of lidars as scans of a planar laser: what stands beside a robot, without the ground it drives on.

Strategy: the lowest points of columns around the sensor are the ground, and a plane fits them. What ends
between half and one and a half times the sensor's height above that is a planar scan, turned as the cloud.
It is the same part of the world however the sensor is tilted, and on ramps. Where no such plane is, the
sensor does not drive, or its poses do not say what is up: there is no slice.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ndtree.alignment.planar import Floats, wrapped
from ndtree.alignment.sensor_scans import SensorScan
from ndtree.base.scan import Scan
from ndtree.evaluation.pose_tilt import Columns, ground_of, plane_of
from ndtree.tuning.revisits import MOST_RANGE

_MOST_POINTS = 6000  # Of a cloud, about.
_LEAST_COLUMNS = 20  # Of ground.
_OFF = 0.1  # Of the plane, ground is that near to it [m], in at least _SHARE of the columns.
_SHARE = 0.4
_STEEPEST = 0.5  # Of the ground, by the poses.
_LOWEST = 0.15  # Of a sensor above the ground [m].
_BEAM = math.radians(1.0)  # Between beams of a slice; the nearest point of each counts.
_NEAREST = 0.3  # Points are the robot's own [m].


@dataclass(frozen=True)
class Cloud:
    """A cloud of a lidar in its sensor's frame, and its pose."""

    points: Floats  # (n, 3) of beams that returned [m].
    rotation: Floats  # (3, 3), into the map.
    position: Floats  # (3,) [m].
    stamp: float

    @classmethod
    def of(cls, scan: Scan, *, with_points: bool = True) -> Cloud | None:
        """Some beams of a scan, of all rings of a lidar; None if its log does not say where and how it is."""
        origins = np.atleast_2d(scan.origin)
        if scan.dim != 3 or scan.rotation is None or scan.points_only or not len(origins):
            return None
        origin = origins.mean(axis=0, dtype=np.float64)
        step = len(scan) // _MOST_POINTS | 1  # Rings are even in number.
        scan = scan.only(slice(None, None if with_points else 0, step if step % 5 else step + 2))
        ways = scan.endpoints[scan.did_return].astype(np.float64) - origin
        ways = ways[np.isfinite(ways).all(axis=1)]
        return cls(ways @ scan.rotation, scan.rotation, origin, scan.stamp)

    def _pose(self, first: Floats) -> Floats:
        """(3,) x, y and yaw, by how it is turned from a first rotation, whatever looks up in that."""
        since = self.rotation @ first.T
        yaw = math.atan2(first[1, 0], first[0, 0]) + math.atan2(
            since[1, 0] - since[0, 1], since[0, 0] + since[1, 1]
        )
        return np.append(self.position[:2], wrapped(np.array([yaw])))

    def sliced(self, first: Floats) -> SensorScan:
        """What stands beside the robot, in the order of angles; no points where no ground is seen.

        `first`: Rotation of the log's first cloud, from which yaw is counted.
        """
        pose, nothing = self._pose(first), np.empty((0, 2))
        if not len(self.points):
            return SensorScan(nothing, nothing, pose, self.stamp)
        c, s = math.cos(pose[2]), math.sin(pose[2])
        level = self.points @ self.rotation.T @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        level = level[np.hypot(level[:, 0], level[:, 1]) < MOST_RANGE]
        plane = _ground_plane(level)
        if plane is None:
            return SensorScan(nothing, nothing, pose, self.stamp)
        height = level[:, 2] - level[:, :2] @ plane[:2] - plane[2]
        far = np.hypot(level[:, 0], level[:, 1])
        use = (np.abs(height + plane[2]) < -0.5 * plane[2]) & (far > _NEAREST)
        beside, far = level[use, :2], far[use]
        beam = np.floor(np.arctan2(beside[:, 1], beside[:, 0]) / _BEAM)
        order = np.lexsort((far, beam))
        beside = beside[order[np.diff(beam[order], prepend=np.nan) != 0]]
        return SensorScan(beside, beside, pose, self.stamp)

    def ground(self) -> Columns:
        """Columns of the map, and the lowest point in each."""
        return ground_of(self.points @ self.rotation.T + self.position)


def _ground_plane(level: Floats) -> Floats | None:
    """Slopes along x and y, and the height at the sensor [m]; None if none is below."""
    _, lowest = ground_of(level[level[:, 2] < -_LOWEST])
    if len(lowest) < _LEAST_COLUMNS:
        return None
    plane = plane_of(lowest[:, :2], lowest[:, 2])
    off = np.abs(lowest[:, 2] - lowest[:, :2] @ plane[:2] - plane[2])
    is_ground = float(np.mean(off < _OFF)) > _SHARE and float(np.abs(plane[:2]).max()) < _STEEPEST
    return plane if is_ground and plane[2] < -_LOWEST else None
