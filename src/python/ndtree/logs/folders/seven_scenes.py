# SPDX-License-Identifier: BSD-3-Clause
"""Folders as 7-Scenes has them: a depth image and a pose of the camera for each frame."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from ndtree.logs.core.failures import one_line
from ndtree.logs.core.plain_file import text_lines
from ndtree.logs.core.source import Format, Source, require_dim
from ndtree.logs.folders.depth_image import (
    CAMERA,
    PIXEL_STRIDE,
    Camera,
    camera_of,
    check_stride,
    load_depth,
    points_of,
)
from ndtree.logs.folders.folder import FolderLog
from ndtree.logs.poses.pose import Pose
from ndtree.logs.poses.trajectory_files import read_pose

#: Where the folder has no camera-intrinsics.txt.
DEFAULT_CAMERA = Camera(585.0, 585.0, 320.0, 240.0, scale=1000.0)
INTRINSICS = "camera-intrinsics.txt"
NO_DEPTH = 65535

_DEPTH = re.compile(r"frame-\d+\.depth\.png")


class SevenScenesLog(FolderLog):
    """``frame-000000.depth.png`` (16 bits, millimetres; 0 and 65535 are no depth) and, beside each,
    ``frame-000000.pose.txt`` (4x4, camera to world).

    The camera is `camera`, else the 3x3 matrix in the folder's ``camera-intrinsics.txt`` if there is one,
    else the one of 7-Scenes.
    """

    is_depth_camera = is_raw = True
    format = "seven_scenes"

    def __init__(self, source: Source, camera: str | None = None, pixel_stride: int = 1) -> None:
        check_stride(pixel_stride)
        names = [name for name in source.names if _DEPTH.fullmatch(name)]
        super().__init__(source.path, [source.inside(name) for name in names])
        if not names:
            raise ValueError(f"{source.path}: no depth image, expected frame-000000.depth.png and so on")
        self._pixel_stride = pixel_stride
        if camera is not None:
            self._camera = camera_of(camera, scale=DEFAULT_CAMERA.scale)
        elif INTRINSICS in source.names:
            self._camera = _camera_in(source.inside(INTRINSICS))
        else:
            self._camera = DEFAULT_CAMERA

    def _pose(self, i: int) -> Pose:
        return read_pose(self._files[i][: -len("depth.png")] + "pose.txt")

    def _points(self, i: int) -> NDArray[np.floating]:
        image = load_depth(self._files[i])
        return points_of(image, self._camera, pixel_stride=self._pixel_stride, no_depth=(NO_DEPTH,))


def _camera_in(path: str) -> Camera:
    try:
        fields = [field for _, line in text_lines(path) for field in line.split()]
        matrix = np.array([float(field) for field in fields]).reshape(3, 3)
        fx, fy, cx, cy = matrix[[0, 1, 0, 1], [0, 1, 2, 2]].tolist()
        return Camera(fx, fy, cx, cy, DEFAULT_CAMERA.scale)
    except ValueError as error:
        raise ValueError(f"{path}: expected a camera's 3x3 matrix ({one_line(error)})") from None


def _recognises(source: Source) -> bool:
    return any(_DEPTH.fullmatch(name) for name in source.names)


def _open(
    source: Source, *, dim: int | None = None, camera: str | None = None, pixel_stride: int = 1
) -> SevenScenesLog:
    require_dim(source, SEVEN_SCENES, 3, dim)
    return SevenScenesLog(source, camera, pixel_stride)


SEVEN_SCENES = Format(
    "seven_scenes", "a 7-Scenes folder", _recognises, _open, (CAMERA, PIXEL_STRIDE), stored_as="folder"
)
