# SPDX-License-Identifier: BSD-3-Clause
"""Drives of KITTI's raw data: scans of a Velodyne, and the poses of a GPS/IMU beside it."""

from __future__ import annotations

import datetime
import math
import os
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ndtree.logs.core.failures import one_line
from ndtree.logs.core.plain_file import text_lines
from ndtree.logs.core.source import TIME_OFFSET, Format, Source, require_dim
from ndtree.logs.folders.bin_files import WIDTHS, bin_points, floats_a_point
from ndtree.logs.folders.folder import FolderLog, PosesOfFiles, number_in, stem_of
from ndtree.logs.poses.pose import Pose
from ndtree.logs.poses.trajectory_files import TRAJECTORY

SCANS = os.path.join("velodyne_points", "data")
POSES = os.path.join("oxts", "data")
CALIBRATION = "calib_imu_to_velo.txt"
TIMES = os.path.join("velodyne_points", "timestamps.txt")
_EARTH = 6378137.0  # Radius that the data set's own tools take [m].
#: A pose begins with latitude, longitude [deg], altitude [m], roll, pitch and yaw [rad].
_FIELDS = 6


class KittiRawLog(FolderLog):
    """``velodyne_points/data/*.bin`` and ``oxts/data/*.txt``, with ``calib_imu_to_velo.txt``.

    The map's frame has x east, y north and z up, and begins where the GPS/IMU was at the first scan. Latitude
    and longitude are put on a plane by Mercator's projection at the latitude of the first. The calibration is
    in the drive's folder, or in the day's above it.

    Parameters
    ----------
    source : Source
    trajectory : str, optional
        Poses of the Velodyne itself; oxts and the calibration are not read then.
    time_offset : float
        Added to the times of the scans before poses of a trajectory are looked up [s].
    """

    format = "kitti_raw"
    may_be_cut_off = True

    def __init__(self, source: Source, trajectory: str | None = None, time_offset: float = 0.0) -> None:
        folder = source.inside(SCANS)
        names = sorted(name for name in os.listdir(folder) if name.endswith(".bin"))
        super().__init__(source.path, [os.path.join(folder, name) for name in names])
        self._source = source
        self._times = source.inside(TIMES)
        self._poses: PosesOfFiles | None = None
        if trajectory is not None:
            self._poses = PosesOfFiles(trajectory, self._files, None, time_offset, stamps=self._stamps)
            return
        if not os.path.isdir(source.inside(POSES)):
            raise ValueError(
                f"{source.path}: no poses, expected {POSES} in it, or a trajectory of the Velodyne"
            )
        self._calibration = _calibration_of(source)

    def _pose(self, i: int) -> Pose:
        if self._poses is not None:
            return self._poses.pose(i)
        return self._T_map_imu(i) @ self._T_imu_velodyne

    def _T_map_imu(self, i: int) -> Pose:
        latitude, longitude, altitude, roll, pitch, yaw = _read_pose(self._pose_file(i))
        first = _read_pose(self._pose_file(0))
        scale = math.cos(math.radians(first[0]))
        position = _on_plane(latitude, longitude, altitude, scale) - _on_plane(*first[:3], scale)
        return Pose(_turned(roll, pitch, yaw), position)

    def _pose_file(self, i: int) -> str:
        return self._source.inside(POSES, f"{stem_of(self._files[i])}.txt")

    @cached_property
    def _T_imu_velodyne(self) -> Pose:
        return _velodyne_from_imu(self._calibration).inverse()

    def _points(self, i: int) -> NDArray[np.floating]:
        return bin_points(self._files[i], self._width)

    @cached_property
    def _width(self) -> int:
        width = floats_a_point(self._files)
        if width != 4:
            self._decided.append(f"{width} numbers a point in {SCANS}, as the content tells: {WIDTHS[width]}")
        return width

    @cached_property
    def _stamps(self) -> list[float]:
        """Times of the scans [s]; none where there is no file of them."""
        if not os.path.isfile(self._times):
            return []
        lines = [line.strip() for _, line in text_lines(self._times) if line.strip()]
        numbers = [number_in(stem_of(file)) for file in self._files]
        stamps = []
        for file, number in zip(self._files, numbers):
            if number is None or number >= len(lines):
                raise ValueError(
                    f"{file}: number {number}, but {self._times} has times 0 to {len(lines) - 1}"
                )
            stamps.append(_seconds(self._times, number, lines[number]))
        return stamps

    def _stamp(self, i: int) -> float:
        return self._stamps[i] if self._stamps else 0.0


def _read_pose(path: str) -> list[float]:
    fields = next((line.split() for _, line in text_lines(path) if line.strip()), [])
    try:
        values = [float(field) for field in fields[:_FIELDS]]
        if len(values) < _FIELDS or not np.isfinite(values).all() or abs(values[0]) >= 90:
            raise ValueError(f"found {' '.join(fields[:_FIELDS])[:60]!r}")
    except ValueError as error:
        raise ValueError(
            f"{path}: expected latitude, longitude [deg], altitude [m], "
            f"roll, pitch, yaw [rad] ({one_line(error)})"
        ) from None
    return values


def _on_plane(latitude: float, longitude: float, altitude: float, scale: float) -> NDArray[np.float64]:
    x = scale * _EARTH * math.radians(longitude)
    y = scale * _EARTH * math.log(math.tan(math.radians(90 + latitude) / 2))
    return np.array([x, y, altitude])


def _turned(roll: float, pitch: float, yaw: float) -> NDArray[np.float64]:
    (sx, cx), (sy, cy), (sz, cz) = ((math.sin(a), math.cos(a)) for a in (roll, pitch, yaw))
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


def _calibration_of(source: Source) -> str:
    here, above = (
        source.inside(CALIBRATION),
        os.path.join(os.path.abspath(source.path), os.pardir, CALIBRATION),
    )
    for path in (here, above):
        if os.path.isfile(path):
            return path
    raise ValueError(f"{source.path}: no {CALIBRATION} in it or above it, expected where the Velodyne is")


def _velodyne_from_imu(path: str) -> Pose:
    """T_velodyne_imu of a calibration file: lines R and T."""
    found = {}
    for _, line in text_lines(path):
        name, _, values = line.partition(":")
        found[name.strip()] = values.split()
    try:
        rotation = np.array([float(field) for field in found["R"]]).reshape(3, 3)
        position = np.array([float(field) for field in found["T"]]).reshape(3, 1)
        return Pose.from_matrix(np.hstack([rotation, position]))
    except KeyError as error:
        raise ValueError(f"{path}: no line {error}, expected R and T") from None
    except ValueError as error:
        raise ValueError(f"{path}: expected 9 numbers of R and 3 of T ({one_line(error)})") from None


def _seconds(path: str, line: int, text: str) -> float:
    """Of "2011-09-26 13:02:25.594360375", in UTC; nanoseconds have no room in a date."""
    whole, _, part = text.partition(".")
    try:
        day = datetime.datetime.strptime(whole, "%Y-%m-%d %H:%M:%S").replace(tzinfo=datetime.timezone.utc)
        return day.timestamp() + (float(f"0.{part}") if part else 0.0)
    except ValueError:
        raise ValueError(
            f"{path}: line {line + 1}: found {text[:40]!r}, expected a time as 2011-09-26 13:02:25.594360375"
        ) from None


def _recognises(source: Source) -> bool:
    folder = source.inside(SCANS)
    return os.path.isdir(folder) and any(name.endswith(".bin") for name in os.listdir(folder))


def _open(
    source: Source, *, dim: int | None = None, trajectory: str | None = None, time_offset: float = 0.0
) -> KittiRawLog:
    require_dim(source, KITTI_RAW, 3, dim)
    return KittiRawLog(source, trajectory, time_offset)


KITTI_RAW = Format(
    "kitti_raw",
    "a drive of KITTI's raw data",
    _recognises,
    _open,
    (TRAJECTORY, TIME_OFFSET),
    stored_as="folder",
)
