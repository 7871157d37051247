# SPDX-License-Identifier: BSD-3-Clause
"""Folders as Open3D and Redwood have them: depth images in ``depth/``, and a pose of the camera for each."""

from __future__ import annotations

import contextlib
import json
import math
import os
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ndtree._errors import key
from ndtree.logs.core.failures import NotALog, one_line
from ndtree.logs.core.plain_file import open_regular, text_lines
from ndtree.logs.core.source import TIME_OFFSET, Format, Source, require_dim
from ndtree.logs.folders.depth_image import (
    CAMERA,
    ENDINGS,
    PIXEL_STRIDE,
    Camera,
    camera_of,
    check_stride,
    load_depth,
    points_of,
)
from ndtree.logs.folders.folder import FolderLog, PosesOfFiles, number_in, stem_of
from ndtree.logs.folders.scan_folder import several_trajectories
from ndtree.logs.poses.pose import Pose
from ndtree.logs.poses.trajectory_files import TRAJECTORY, trajectory_kind

IMAGES = "depth"
#: Names under which the camera's poses are, the best first; else the only trajectory of the folder.
_POSES = ("trajectory.log", "scene/trajectory.log", "livingroom.log", "odometry.log")
_ENDINGS = (".log", ".txt", ".freiburg", ".tum", ".csv")
#: Open3D's own where no file says another: a PrimeSense at 640 x 480, millimetres.
DEFAULT_CAMERA = Camera(525.0, 525.0, 319.5, 239.5, scale=1000.0)
#: The largest value is what drivers write where they have none.
NO_DEPTH = 65535
_CAMERA_FILE = 1 << 20
#: Lists of images with their times.
_LISTS = ("associations.txt", "association.txt", "associate.txt", "associated.txt", "assoc.txt")


class DepthFolderLog(FolderLog):
    """``depth/*.png`` or ``.pgm`` (16 bits, millimetres; 0 and 65535 are no depth) and ``trajectory.log``.

    Times of images are their names, or in a list ``associations.txt``. The camera is `camera`, else the
    intrinsic matrix in a JSON of the folder, as Open3D writes it, else Open3D's default, with a note.
    """

    is_depth_camera = is_raw = True
    format = "depth_folder"

    def __init__(
        self,
        source: Source,
        camera: str | None = None,
        pixel_stride: int = 1,
        trajectory: str | None = None,
        time_offset: float = 0.0,
    ) -> None:
        check_stride(pixel_stride)
        self._pixel_stride = pixel_stride
        folder = source.inside(IMAGES)
        names = sorted(
            (name for name in os.listdir(folder) if name.lower().endswith(ENDINGS)),
            key=lambda name: (number_in(stem_of(name)) or 0, name),
        )
        super().__init__(source.path, [os.path.join(folder, name) for name in names])
        if trajectory is None:
            trajectory = _trajectory_in(source)
        if trajectory is None:
            raise NotALog(
                source.path,
                f"{len(names)} depth images without poses",
                [f"ndtree map {source.path} --trajectory FILE (poses of the camera)"],
            )
        self._camera = DEFAULT_CAMERA
        if camera is not None:
            self._camera = camera_of(camera, scale=DEFAULT_CAMERA.scale)
        elif (found := _camera_in(source)) is not None:
            self._camera = found
        else:
            self._decided.append(
                "the camera is taken for a PrimeSense: 525,525,319.5,239.5,1000; "
                f"{key('camera')} sets another"
            )
        self._poses = PosesOfFiles(trajectory, self._files, None, time_offset, _times_in(source, names))

    def _pose(self, i: int) -> Pose:
        return self._poses.pose(i)

    def _points(self, i: int) -> NDArray[np.floating]:
        image = load_depth(self._files[i])
        return points_of(image, self._camera, pixel_stride=self._pixel_stride, no_depth=(NO_DEPTH,))

    def _stamp(self, i: int) -> float:
        return self._poses.stamp(i)


def _trajectory_in(source: Source) -> str | None:
    for name in _POSES:
        path = source.inside(*name.split("/"))
        if os.path.isfile(path) and trajectory_kind(path) is not None:
            return path
    found = [
        name
        for name in source.names
        if name.lower().endswith(_ENDINGS) and trajectory_kind(source.inside(name))
    ]
    if len(found) > 1:
        raise several_trajectories(source.path, found)
    return source.inside(found[0]) if found else None


def _times_in(source: Source, names: Sequence[str]) -> list[float]:
    """Times of images [s] by a list as of TUM's tools, ``time depth/name time rgb/name`` in either order.

    None where there is no such list, or it leaves some out.
    """
    for name in _LISTS:
        if name not in source.names:
            continue
        times: dict[str, float] = {}
        for _, line in text_lines(source.inside(name)):
            fields = line.split("#", 1)[0].split()
            for time, image in zip(fields[::2], fields[1::2]):
                with contextlib.suppress(ValueError):
                    times[os.path.normpath(image)] = float(time)
        found = [times.get(os.path.join(IMAGES, image), math.nan) for image in names]
        if all(map(math.isfinite, found)):
            return found
    return []


def _camera_in(source: Source) -> Camera | None:
    """Of the only JSON with an intrinsic matrix, which Open3D writes column by column."""
    for name in source.names:
        if not name.lower().endswith(".json") or not os.path.isfile(source.inside(name)):
            continue
        path = source.inside(name)
        with open_regular(path) as file:
            content = file.read(_CAMERA_FILE)
        try:
            found = json.loads(content)
        except (ValueError, RecursionError):
            continue
        if not isinstance(found, dict) or "intrinsic_matrix" not in found:
            continue
        try:
            matrix = np.array(found["intrinsic_matrix"], dtype=np.float64).reshape(3, 3).T
            fx, fy, cx, cy = matrix[[0, 1, 0, 1], [0, 1, 2, 2]].tolist()
            scale = float(found.get("depth_scale", DEFAULT_CAMERA.scale))
            return Camera(fx, fy, cx, cy, scale)
        except (TypeError, ValueError) as error:
            raise ValueError(
                f"{path}: intrinsic_matrix: expected the 9 numbers of a camera's matrix ({one_line(error)})"
            ) from None
    return None


def _recognises(source: Source) -> bool:
    if IMAGES not in source.names or not os.path.isdir(source.inside(IMAGES)):
        return False
    return any(name.lower().endswith(ENDINGS) for name in os.listdir(source.inside(IMAGES)))


def _open(
    source: Source,
    *,
    dim: int | None = None,
    camera: str | None = None,
    pixel_stride: int = 1,
    trajectory: str | None = None,
    time_offset: float = 0.0,
) -> DepthFolderLog:
    require_dim(source, DEPTH_FOLDER, 3, dim)
    return DepthFolderLog(source, camera, pixel_stride, trajectory, time_offset)


DEPTH_FOLDER = Format(
    "depth_folder",
    "a folder of depth images with a trajectory, as Open3D's",
    _recognises,
    _open,
    (CAMERA, PIXEL_STRIDE, TRAJECTORY, TIME_OFFSET),
    stored_as="folder",
)
