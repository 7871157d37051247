# SPDX-License-Identifier: BSD-3-Clause
"""Sequences of KITTI's odometry benchmark: scans of a Velodyne, and the poses of a camera beside it."""

from __future__ import annotations

import os
import shlex
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ndtree.logs.core.failures import NotALog, one_line
from ndtree.logs.core.plain_file import text_lines
from ndtree.logs.core.source import TIME_OFFSET, Format, Source, require_dim
from ndtree.logs.folders.bin_files import WIDTHS, bin_points, floats_a_point
from ndtree.logs.folders.folder import FolderLog, PosesOfFiles
from ndtree.logs.poses.pose import Pose
from ndtree.logs.poses.trajectory_files import TRAJECTORY

SCANS = "velodyne"
CALIBRATION = "calib.txt"
POSES = "poses.txt"
TIMES = "times.txt"


class KittiLog(FolderLog):
    """``velodyne/000000.bin`` and so on (float32 x y z intensity), with ``times.txt`` if it is there.

    Other data sets have such folders with a ring, a time or both behind the intensity: whether a point has
    3 to 8 numbers is told from the content (`floats_a_point`).

    ``poses.txt`` has the poses of the camera, and ``calib.txt`` where the Velodyne sits beside it (``Tr``,
    from the Velodyne to the camera); the map's frame is where the Velodyne would be at the pose that changes
    nothing, so that z points up. Without ``poses.txt``, the poses are looked for where the benchmark has
    them: ``../../poses/NN.txt``.

    Parameters
    ----------
    source : Source
    trajectory : str, optional
        Poses of the Velodyne itself, TUM or KITTI; ``poses.txt`` and ``calib.txt`` are not read then.
    time_offset : float
        Added to ``times.txt`` before poses of a TUM trajectory are looked up [s].
    """

    format = "kitti"
    may_be_cut_off = True

    def __init__(self, source: Source, trajectory: str | None = None, time_offset: float = 0.0) -> None:
        folder = source.inside(SCANS)
        names = sorted(name for name in os.listdir(folder) if name.endswith(".bin"))
        if not names:
            raise ValueError(f"{folder}: no scans, expected 000000.bin and so on")
        super().__init__(source.path, [os.path.join(folder, name) for name in names])
        times = source.inside(TIMES) if TIMES in source.names else None
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

    def _points(self, i: int) -> NDArray[np.floating]:
        return bin_points(self._files[i], self._width)

    @cached_property
    def _width(self) -> int:
        """How many numbers a point has, in all files."""
        width = floats_a_point(self._files)
        if width != 4:
            self._decided.append(f"{width} numbers a point in {SCANS}, as the content tells: {WIDTHS[width]}")
        return width

    def _stamp(self, i: int) -> float:
        return self._poses.stamp(i)


def _poses_of(source: Source) -> str:
    here = source.inside(POSES)
    if POSES in source.names:
        return here
    sequence = os.path.abspath(source.path)
    dataset = os.path.dirname(os.path.dirname(sequence))
    there = os.path.join(dataset, "poses", f"{os.path.basename(sequence)}.txt")
    if os.path.isfile(there):
        return there
    path = shlex.quote(source.path)
    raise NotALog(
        source.path,
        f"a KITTI sequence without poses: neither {POSES} in it nor {there}",
        [f"ndtree map {path} --trajectory FILE (poses of the laser)"],
    )


def _calibration_of(source: Source, poses: str) -> str:
    if CALIBRATION in source.names:
        return source.inside(CALIBRATION)
    way = f"ndtree map {shlex.quote(source.path)} --trajectory {shlex.quote(poses)}"
    raise NotALog(
        source.path,
        f"a KITTI sequence without {CALIBRATION}, which says where the laser is beside the camera",
        [f"{way} (if these are poses of the laser)"],
    )


def _velodyne_in(path: str) -> Pose:
    """T_camera_velodyne of a calibration file."""
    for number, line in text_lines(path):
        name, _, values = line.partition(":")
        if name.strip() != "Tr":
            continue
        try:
            return Pose.from_matrix(np.array([float(field) for field in values.split()]).reshape(3, 4))
        except ValueError as error:
            raise ValueError(
                f"{path}: line {number}: Tr: expected a 3x4 matrix ({one_line(error)})"
            ) from None
    raise ValueError(f"{path}: no line Tr, expected where the Velodyne sits beside the camera")


def _recognises(source: Source) -> bool:
    if SCANS not in source.names or not os.path.isdir(source.inside(SCANS)):
        return False
    return any(name.endswith(".bin") for name in os.listdir(source.inside(SCANS)))


def _open(
    source: Source, *, dim: int | None = None, trajectory: str | None = None, time_offset: float = 0.0
) -> KittiLog:
    require_dim(source, KITTI, 3, dim)
    return KittiLog(source, trajectory, time_offset)


KITTI = Format(
    "kitti", "a KITTI odometry sequence", _recognises, _open, (TRAJECTORY, TIME_OFFSET), stored_as="folder"
)
