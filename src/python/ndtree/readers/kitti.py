# SPDX-License-Identifier: BSD-3-Clause
"""Sequences of KITTI's odometry benchmark: scans of a Velodyne, and the poses of a camera beside it."""

from __future__ import annotations

import os
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ndtree.readers.failures import one_line
from ndtree.readers.folder import TIME_OFFSET, FolderLog, PosesOfFiles
from ndtree.readers.plain_file import open_regular, text_lines
from ndtree.readers.pose import Pose
from ndtree.readers.row_length import row_lengths
from ndtree.readers.source import Format, Source, require_dim
from ndtree.readers.trajectory_files import TRAJECTORY

SCANS = "velodyne"
CALIBRATION = "calib.txt"
POSES = "poses.txt"
TIMES = "times.txt"
#: Numbers of a file that tell how many a point has.
_LOOKED_AT = 840 * 1000


class KittiLog(FolderLog):
    """``velodyne/000000.bin`` and so on (float32 x y z intensity), with ``times.txt`` if it is there.

    Points of other lengths, as those of nuScenes (x y z intensity ring), are told from the numbers; what is
    behind x y z is not used.

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

    def __init__(self, source: Source, trajectory: str | None = None, time_offset: float = 0.0) -> None:
        folder = source.inside(SCANS)
        names = sorted(name for name in os.listdir(folder) if name.endswith(".bin"))
        if not names:
            raise ValueError(f"{folder}: no scans, expected 000000.bin and so on")
        super().__init__(source.path, [os.path.join(folder, name) for name in names])
        times = source.inside(TIMES) if TIMES in source.names else None
        self._calibration = source.inside(CALIBRATION) if trajectory is None else None
        self._poses = PosesOfFiles(
            trajectory if trajectory is not None else _poses_of(source), self._files, times, time_offset
        )

    @cached_property
    def _T_camera_velodyne(self) -> Pose:
        return Pose.identity() if self._calibration is None else _velodyne_in(self._calibration)

    def _pose(self, i: int) -> Pose:
        T_camera_velodyne = self._T_camera_velodyne
        return T_camera_velodyne.inverse() @ self._poses.pose(i) @ T_camera_velodyne

    def _points(self, i: int) -> NDArray[np.floating]:
        path, length = self._files[i], self._floats_a_point
        with open_regular(path) as file:
            size = os.fstat(file.fileno()).st_size
            if size % (4 * length):
                columns = "x y z intensity" if length == 4 else f"{length} numbers a point"
                raise ValueError(
                    f"{path}: {size} bytes, expected a multiple of {4 * length} (float32 {columns})"
                )
            return np.fromfile(file, dtype="<f4").reshape(-1, length)[:, :3]

    @cached_property
    def _floats_a_point(self) -> int:
        """Numbers of a point, as the first and the largest files say.

        Where they leave it open, as files of a few points do, it is what fits the most files' sizes; among
        several, 4 if it is the likeliest.
        """
        sizes = [(_size(path), path) for path in self._files]
        chosen = [path for _, path in sizes[:1] + sorted(sizes, reverse=True)[:2]]
        streams = [_floats(path) for path in dict.fromkeys(chosen)]
        allowed = row_lengths(streams)
        if len(allowed) == 1:
            return allowed[0]
        fits = {n: sum(size % (4 * n) == 0 for size, _ in sizes) for n in allowed}
        best = [n for n in allowed if fits[n] == max(fits.values())]
        if len(best) == 1 or best[0] == 4 or (4 in best and fits[4] == 0):
            return best[0] if len(best) == 1 else 4
        raise ValueError(
            f"{self._files[0]}: {_size(self._files[0])} bytes may be points of "
            f"{' or '.join(str(n) for n in sorted(best))} numbers, "
            "expected 4 (float32 x y z intensity)"
        )

    def _stamp(self, i: int) -> float:
        return self._poses.stamp(i)


def _size(path: str) -> int:
    with open_regular(path) as file:
        return os.fstat(file.fileno()).st_size


def _floats(path: str) -> NDArray[np.float32]:
    with open_regular(path) as file:
        return np.fromfile(file, dtype="<f4", count=_LOOKED_AT)


def _poses_of(source: Source) -> str:
    here = source.inside(POSES)
    if POSES in source.names:
        return here
    sequence = os.path.abspath(source.path)
    dataset = os.path.dirname(os.path.dirname(sequence))
    there = os.path.join(dataset, "poses", f"{os.path.basename(sequence)}.txt")
    if os.path.isfile(there):
        return there
    raise ValueError(f"{source.path}: no poses, expected {POSES} in it, {there}, or a trajectory")


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
