# SPDX-License-Identifier: BSD-3-Clause
"""Folders of point clouds, a file each scan, with a trajectory, a pose for each file, or a pose in each."""

from __future__ import annotations

import os

import numpy as np
from numpy.typing import NDArray

from ndtree.logs.core.padding import without_zeros
from ndtree.logs.core.source import Format, ReaderOption, Source, require_dim
from ndtree.logs.folders.cloud_files import kind_of_file, kind_of_name, pcd_viewpoint, points_of_file
from ndtree.logs.folders.folder import TIME_OFFSET, FolderLog, PosesOfFiles, number_in, stamps_in, stem_of
from ndtree.logs.poses.pose import Pose
from ndtree.logs.poses.trajectory_files import TRAJECTORY, read_pose, trajectory_kind

POINTS_IN = ReaderOption("points_in", str, "Frame of the points of point clouds: sensor or map; else sensor.")
FRAMES = ("sensor", "map")

TIMES = "times.txt"
POSE_ENDINGS = (".pose.txt", ".txt")

_EXPECTED = (
    "a trajectory file in the folder (or the option trajectory), a pose beside each file (000000.pose.txt), "
    "or VIEWPOINT in PCD files"
)


class PointCloudLog(FolderLog):
    """PCD, PLY, LAS or LAZ files, ordered by the number or time that is their name.

    Poses come from one of these, the first that is there:

    - ``trajectory``;
    - a pose beside each file, 3x4 or 4x4 numbers in ``000000.pose.txt`` or ``000000.txt``;
    - the only trajectory file in the folder, TUM or KITTI, whatever its name (``times.txt`` has the times of
      numbered files); see `PosesOfFiles` for which pose is whose;
    - VIEWPOINT of PCD files, unless it is the identity in all of several.

    Parameters
    ----------
    source : Source
        A folder, or one file.
    trajectory : str, optional
        A trajectory file.
    time_offset : float
        Added to the files' times before their poses are looked up [s].
    points_in : {"sensor", "map"}
        Frame of the points. "map": only the positions of the poses are used, as origins of the beams.
    """

    format = "point_clouds"
    may_be_cut_off = True

    def __init__(
        self,
        source: Source,
        trajectory: str | None = None,
        time_offset: float = 0.0,
        points_in: str = "sensor",
    ) -> None:
        if points_in not in FRAMES:
            raise ValueError(f"points_in = {points_in!r}: must be one of {', '.join(FRAMES)}")
        self._points_in = points_in
        if source.is_folder:
            names = _in_order([name for name in source.names if kind_of_name(name)])
            super().__init__(source.path, [source.inside(name) for name in names])
            _require_one_kind(source.path, names)
            neighbours = source.names
        else:
            super().__init__(source.path, [source.path])
            neighbours = tuple(os.listdir(os.path.dirname(source.path) or "."))
        self._stamps = stamps_in([stem_of(file) for file in self._files])
        folder = source.path if source.is_folder else os.path.dirname(source.path)
        self._beside: list[str | None] = [None] * len(self._files)
        self._trajectory: PosesOfFiles | None = None
        if trajectory is None:
            self._beside = [_pose_beside(os.path.basename(file), neighbours) for file in self._files]
            if any(self._beside):
                self._beside = [name and os.path.join(folder, name) for name in self._beside]
                return
            trajectory = _trajectory_in(source)
        if trajectory is not None:
            times = os.path.join(folder, TIMES) if TIMES in neighbours else None
            self._trajectory = PosesOfFiles(trajectory, self._files, times, time_offset)
        else:
            self._require_viewpoints()

    def _require_viewpoints(self) -> None:
        """Several identities are no poses: the header has them where none was given."""
        path = self._files[0]
        said = f"{self.path}: no poses, expected {_EXPECTED}"
        if kind_of_name(path) is not kind_of_name("a.pcd"):
            raise ValueError(said)
        if len(self) == 1:
            return
        for path in self._files:
            try:
                pose = pcd_viewpoint(path)
            except ValueError:
                return  # Said by somebody; the error is that of the scan.
            if pose.position.any() or not np.array_equal(pose.rotation, np.eye(3)):
                return
        raise ValueError(f"{said} (it is the identity in all)")

    def _pose(self, i: int) -> Pose:
        if self._trajectory is not None:
            return self._trajectory.pose(i)
        if not any(self._beside):
            return pcd_viewpoint(self._files[i])
        beside = self._beside[i]
        if beside is None:
            wanted = f"{stem_of(self._files[i])}.pose.txt"
            raise ValueError(f"{self._files[i]}: no pose beside it as others have, expected {wanted}")
        return read_pose(beside)

    def _points(self, i: int) -> NDArray[np.floating]:
        return points_of_file(self._files[i])

    def _stamp(self, i: int) -> float:
        return self._trajectory.stamp(i) if self._trajectory else self._stamps[i] or 0.0

    def _in_map(self, points: NDArray[np.floating], T_map_sensor: Pose) -> NDArray[np.floating]:
        return T_map_sensor.apply(points) if self._points_in == "sensor" else without_zeros(points)


def _in_order(names: list[str]) -> list[str]:
    """Names by the times that they are, else by their numbers."""
    stems = [stem_of(name) for name in names]
    keys = [
        (stamp if stamp is not None else float(number_in(stem) or 0), name)
        for stamp, stem, name in zip(stamps_in(stems), stems, names)
    ]
    return [name for _, name in sorted(keys)]


def _require_one_kind(path: str, names: list[str]) -> None:
    kinds = sorted({kind.name for kind in map(kind_of_name, names) if kind})
    if len(kinds) != 1:
        raise ValueError(
            f"{path}: found {' and '.join(kinds) or 'no'} files, "
            "expected PCD, PLY, LAS or LAZ files of one kind"
        )


def _pose_beside(name: str, names: tuple[str, ...]) -> str | None:
    for ending in POSE_ENDINGS:
        beside = os.path.splitext(name)[0] + ending
        if beside in names:
            return beside
    return None


def _trajectory_in(source: Source) -> str | None:
    """The only trajectory file of a folder."""
    found = [
        name
        for name in source.names
        if name.lower().endswith((".txt", ".tum", ".kitti", ".csv")) and trajectory_kind(source.inside(name))
    ]
    if len(found) > 1:
        raise ValueError(
            f"{source.path}: {len(found)} trajectories, {' and '.join(found)}: "
            "say which by the option trajectory"
        )
    return source.inside(found[0]) if found else None


def _recognises(source: Source) -> bool:
    if source.is_folder:
        return any(kind_of_name(name) for name in source.names)
    return kind_of_file(source.head) is not None


def _open(
    source: Source,
    *,
    dim: int | None = None,
    trajectory: str | None = None,
    time_offset: float = 0.0,
    points_in: str = "sensor",
) -> PointCloudLog:
    require_dim(source, POINT_CLOUDS, 3, dim)
    return PointCloudLog(source, trajectory, time_offset, points_in)


POINT_CLOUDS = Format(
    "point_clouds",
    "a folder of PCD, PLY, LAS or LAZ files",
    _recognises,
    _open,
    (TRAJECTORY, TIME_OFFSET, POINTS_IN),
    stored_as="either",
)
