# SPDX-License-Identifier: BSD-3-Clause
"""KITTI: sequences of its odometry benchmark, with poses of a camera, and drives of its raw data."""

from __future__ import annotations

import datetime
import math
import os
import shlex
from functools import cached_property

import numpy as np

from ndtree.logs.core.arrays import Floats, Points
from ndtree.logs.core.failures import NotALog, at_place
from ndtree.logs.core.plain_file import text_lines, wrong_line
from ndtree.logs.core.source import Format, Source
from ndtree.logs.folders.cloud_files import WIDTHS, bin_points, floats_a_point
from ndtree.logs.folders.folder import FolderLog, PosesOfFiles, number_in, stem_of
from ndtree.logs.poses.pose import Pose, about_axes

_SCANS, _POSES, _TIMES, _CALIBRATION = "velodyne", "poses.txt", "times.txt", "calib.txt"
_RAW_SCANS = os.path.join("velodyne_points", "data")
_RAW_TIMES = os.path.join("velodyne_points", "timestamps.txt")
_OXTS, _IMU = os.path.join("oxts", "data"), "calib_imu_to_velo.txt"
_EARTH = 6378137.0  # Radius that the data set's own tools take [m].
#: A pose begins with latitude, longitude [deg], altitude [m], roll, pitch and yaw [rad].
_FIELDS = 6


class VelodyneFolderLog(FolderLog):
    """Files of float32 x y z intensity.

    Other data sets have such folders with a ring, a time or both behind the intensity: whether a point has
    3 to 8 numbers is told from the content (`floats_a_point`).
    """

    may_be_cut_off = True
    _folder: str

    def __init__(self, source: Source) -> None:
        folder = source.inside(self._folder)
        names = sorted(name for name in os.listdir(folder) if name.endswith(".bin"))
        if not names:
            raise ValueError(f"{folder}: no scans, expected 000000.bin and so on")
        super().__init__(source.path, [os.path.join(folder, name) for name in names])

    def _points(self, i: int) -> Points:
        return bin_points(self._files[i], self._width)

    @cached_property
    def _width(self) -> int:
        """How many numbers a point has, in all files."""
        width = floats_a_point(self._files)
        if width != 4:
            said = f"{width} numbers a point in {self._folder}, as the content tells: {WIDTHS[width]}"
            self._decided.append(said)
        return width

    @classmethod
    def recognises(cls, source: Source) -> bool:
        """Whether a folder has such files."""
        folder = source.inside(cls._folder)
        return os.path.isdir(folder) and any(name.endswith(".bin") for name in os.listdir(folder))


class KittiLog(VelodyneFolderLog):
    """``velodyne/000000.bin`` and so on, with ``times.txt`` if it is there.

    ``poses.txt`` has the poses of the camera, and ``calib.txt`` where the Velodyne sits beside it (``Tr``,
    from the Velodyne to the camera); the map's frame is where the Velodyne would be at the pose that changes
    nothing, so that z points up. Without ``poses.txt``, the poses are looked for where the benchmark has
    them: ``../../poses/NN.txt``. Instead of both, `trajectory` has poses of the Velodyne itself, at the
    scans' times plus `time_offset` [s].
    """

    format = "kitti"
    _folder = _SCANS

    def __init__(self, source: Source, trajectory: str | None = None, time_offset: float = 0.0) -> None:
        super().__init__(source)
        times = source.inside(_TIMES) if _TIMES in source.names else None
        self._calibration: str | None = None
        if trajectory is None:
            trajectory = _poses_of(source)
            self._calibration = _calibration_of(source, trajectory)
        self._poses = PosesOfFiles(trajectory, self._files, times, time_offset)

    @cached_property
    def _T_camera_velodyne(self) -> Pose:
        return Pose.identity() if self._calibration is None else _velodyne_in(self._calibration)

    def _pose(self, i: int) -> Pose:
        T_camera_velodyne = self._T_camera_velodyne
        return T_camera_velodyne.inverse() @ self._poses.pose(i) @ T_camera_velodyne


class KittiRawLog(VelodyneFolderLog):
    """``velodyne_points/data/*.bin`` and ``oxts/data/*.txt``, with ``calib_imu_to_velo.txt``.

    The map's frame has x east, y north and z up, and begins where the GPS/IMU was at the first scan. Latitude
    and longitude are put on a plane by Mercator's projection at the latitude of the first. The calibration is
    in the drive's folder, or in the day's above it. Instead of both, `trajectory` has poses of the Velodyne
    itself, at the scans' times plus `time_offset` [s].
    """

    format = "kitti_raw"
    _folder = _RAW_SCANS

    def __init__(self, source: Source, trajectory: str | None = None, time_offset: float = 0.0) -> None:
        super().__init__(source)
        self._source = source
        self._times = source.inside(_RAW_TIMES)
        if trajectory is not None:
            self._poses = PosesOfFiles(trajectory, self._files, None, time_offset, stamps=self._stamps)
            return
        if not os.path.isdir(source.inside(_OXTS)):
            raise ValueError(f"{source.path}: no {_OXTS} in it, expected it, or a trajectory of the Velodyne")
        self._calibration = _imu_calibration_of(source)

    def _pose(self, i: int) -> Pose:
        if self._poses is not None:
            return self._poses.pose(i)
        return self._T_map_imu(i) @ self._T_imu_velodyne

    def _T_map_imu(self, i: int) -> Pose:
        latitude, longitude, altitude, roll, pitch, yaw = _read_pose(self._pose_file(i))
        first = _read_pose(self._pose_file(0))
        scale = math.cos(math.radians(first[0]))
        position = _on_plane(latitude, longitude, altitude, scale) - _on_plane(*first[:3], scale)
        about_x, about_y, about_z = about_axes(roll, pitch, yaw)
        return Pose(about_z @ about_y @ about_x, position)

    def _pose_file(self, i: int) -> str:
        return self._source.inside(_OXTS, f"{stem_of(self._files[i])}.txt")

    @cached_property
    def _T_imu_velodyne(self) -> Pose:
        return _velodyne_from_imu(self._calibration).inverse()

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
                raise ValueError(f"{file}: number {number}, but {self._times} has 0 to {len(lines) - 1}")
            stamps.append(_seconds(self._times, number, lines[number]))
        return stamps

    def _stamp(self, i: int) -> float:
        return self._stamps[i] if self._stamps else 0.0


def _poses_of(source: Source) -> str:
    here = source.inside(_POSES)
    if _POSES in source.names:
        return here
    sequence = os.path.abspath(source.path)
    dataset = os.path.dirname(os.path.dirname(sequence))
    there = os.path.join(dataset, "poses", f"{os.path.basename(sequence)}.txt")
    if os.path.isfile(there):
        return there
    path = shlex.quote(source.path)
    what = f"a KITTI sequence without poses: neither {_POSES} in it nor {there}"
    raise NotALog(source.path, what, [f"ndtree map {path} --trajectory FILE (poses of the laser)"])


def _calibration_of(source: Source, poses: str) -> str:
    if _CALIBRATION in source.names:
        return source.inside(_CALIBRATION)
    way = f"ndtree map {shlex.quote(source.path)} --trajectory {shlex.quote(poses)}"
    what = f"a KITTI sequence without {_CALIBRATION}, which says where the laser is beside the camera"
    raise NotALog(source.path, what, [f"{way} (if these are poses of the laser)"])


def _named_numbers(path: str, names: str) -> dict[str, list[float]]:
    """Of the lines of a calibration file with some names, the numbers behind them."""
    found = {}
    for number, line in text_lines(path):
        name, _, values = line.partition(":")
        if name.strip() in names.split():
            with at_place(f"{path}: line {number}: {name.strip()}", "numbers"):
                found[name.strip()] = [float(field) for field in values.split()]
    missing = next((name for name in names.split() if name not in found), None)
    if missing is not None:
        raise ValueError(f"{path}: no line {missing}, expected where the Velodyne is")
    return found


def _velodyne_in(path: str) -> Pose:
    """T_camera_velodyne of a calibration file."""
    found = _named_numbers(path, "Tr")["Tr"]
    if len(found) != 12:
        raise ValueError(f"{path}: Tr: expected a 3x4 matrix (found {len(found)} numbers)")
    with at_place(f"{path}: Tr", "a 3x4 matrix"):
        return Pose.from_matrix(np.array(found).reshape(3, 4))


def _read_pose(path: str) -> list[float]:
    fields = next((line.split() for _, line in text_lines(path) if line.strip()), [])
    with at_place(path, "latitude, longitude [deg], altitude [m], roll, pitch, yaw [rad]"):
        values = [float(field) for field in fields[:_FIELDS]]
        if len(values) < _FIELDS or not np.isfinite(values).all() or abs(values[0]) >= 90:
            raise ValueError(f"found {' '.join(fields[:_FIELDS])[:60]!r}")
    return values


def _on_plane(latitude: float, longitude: float, altitude: float, scale: float) -> Floats:
    x = scale * _EARTH * math.radians(longitude)
    y = scale * _EARTH * math.log(math.tan(math.radians(90 + latitude) / 2))
    return np.array([x, y, altitude])


def _imu_calibration_of(source: Source) -> str:
    here, above = (source.inside(_IMU), os.path.join(os.path.abspath(source.path), os.pardir, _IMU))
    for path in (here, above):
        if os.path.isfile(path):
            return path
    raise ValueError(f"{source.path}: no {_IMU} in it or above it, expected where the Velodyne is")


def _velodyne_from_imu(path: str) -> Pose:
    """T_velodyne_imu of a calibration file: lines R and T."""
    found = _named_numbers(path, "R T")
    with at_place(path, "9 numbers of R and 3 of T"):
        rotation, position = np.array(found["R"]).reshape(3, 3), np.array(found["T"]).reshape(3, 1)
        return Pose.from_matrix(np.hstack([rotation, position]))


def _seconds(path: str, line: int, text: str) -> float:
    """Of "2011-09-26 13:02:25.594360375", in UTC; nanoseconds have no room in a date."""
    whole, _, part = text.partition(".")
    try:
        day = datetime.datetime.strptime(whole, "%Y-%m-%d %H:%M:%S").replace(tzinfo=datetime.timezone.utc)
        return day.timestamp() + (float(f"0.{part}") if part else 0.0)
    except ValueError:
        raise wrong_line(path, line + 1, text, "a time as 2011-09-26 13:02:25.594360375") from None


_OPTIONS = ("trajectory", "time_offset")
KITTI = Format("kitti", "a KITTI odometry sequence", KittiLog.recognises, KittiLog, _OPTIONS, "folder")
_RAW = "a drive of KITTI's raw data"
KITTI_RAW = Format("kitti_raw", _RAW, KittiRawLog.recognises, KittiRawLog, _OPTIONS, "folder")
