# SPDX-License-Identifier: BSD-3-Clause
"""Folders of depth images with the camera's poses, as 7-Scenes, TUM's benchmark, and Open3D have them."""

from __future__ import annotations

import contextlib
import json
import math
import os
import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from ndtree._errors import key
from ndtree.logs.core.arrays import Points
from ndtree.logs.core.failures import NotALog, at_place, one_line
from ndtree.logs.core.plain_file import open_regular, text_lines, wrong_line
from ndtree.logs.core.source import Format, Source
from ndtree.logs.folders.depth_image import ENDINGS, Camera, camera_of, load_depth, points_of
from ndtree.logs.folders.folder import FolderLog, PosesOfFiles, number_in, stem_of
from ndtree.logs.folders.scan_folder import only_trajectory
from ndtree.logs.poses.pose import Pose
from ndtree.logs.poses.trajectory_files import read_pose, trajectory_kind

#: What drivers write where they have no depth, beside 0.
NO_DEPTH = 65535
#: Cameras where neither folder nor user names one: of 7-Scenes; that for which all of TUM's images are made;
#: Open3D's own, a PrimeSense at 640 x 480; and that of ICL-NUIM, whose poses have a name of their own.
SEVEN_SCENES_CAMERA = Camera(585.0, 585.0, 320.0, 240.0, scale=1000.0)
TUM_CAMERA = Camera(525.0, 525.0, 319.5, 239.5, scale=5000.0)
OPEN3D_CAMERA = Camera(525.0, 525.0, 319.5, 239.5, scale=1000.0)
ICL_CAMERA, _OF_ICL = Camera(481.2, -480.0, 319.5, 239.5, scale=5000.0), ".gt.freiburg"

_FRAME = re.compile(r"frame-\d+\.depth\.png")
_INTRINSICS = "camera-intrinsics.txt"
_TUM_IMAGES, _GROUND_TRUTH = "depth.txt", "groundtruth.txt"
IMAGES = "depth"
#: Names under which the camera's poses are, the best first; else the only trajectory of the folder.
_POSES = ("trajectory.log", "scene/trajectory.log", "livingroom.log", "odometry.log")
_CAMERA_FILE = 1 << 20
#: Lists of images with their times.
_LISTS = ("associations.txt", "association.txt", "associate.txt", "associated.txt", "assoc.txt")


class DepthLog(FolderLog):
    """Depth images of 16 bits, each from where its camera was; options are those of the table.

    `usual`: The camera where neither a user nor the folder says one, and what a metre is where a user does
        not; `whose`: such images.
    """

    is_depth_camera = True
    no_depth: tuple[int, ...] = (NO_DEPTH,)
    usual: Camera
    whose: str

    def __init__(
        self,
        source: Source,
        files: Sequence[str],
        camera: str | None,
        pixel_stride: int,
        found: Camera | None = None,
    ) -> None:
        super().__init__(source.path, files)
        self._pixel_stride, known = pixel_stride, self.usual
        if camera is not None:
            found = camera_of(camera, scale=known.scale)
        self._camera = found or known
        if found is None:
            numbers = f"{known.fx:g},{known.fy:g},{known.cx:g},{known.cy:g},{known.scale:g}"
            said = f"the camera is taken as {self.whose}: {numbers}"
            self._decided.append(f"{said}; {key('camera')} sets another")
        elif camera is not None and camera.count(",") < 4:
            said = f"depths are taken as {known.scale:g} a metre"
            self._decided.append(f"{said}; a fifth number in {key('camera')} sets another")

    def _points(self, i: int) -> Points:
        image = load_depth(self._files[i])
        return points_of(image, self._camera, pixel_stride=self._pixel_stride, no_depth=self.no_depth)


class SevenScenesLog(DepthLog):
    """``frame-000000.depth.png`` in millimetres, and beside each ``frame-000000.pose.txt`` (camera to world).

    The camera is `camera`, else the 3x3 matrix in the folder's ``camera-intrinsics.txt`` if there is one,
    else the one of 7-Scenes.
    """

    format = "seven_scenes"
    usual, whose = SEVEN_SCENES_CAMERA, "that of 7-Scenes"

    def __init__(self, source: Source, camera: str | None = None, pixel_stride: int = 1) -> None:
        names = [name for name in source.names if _FRAME.fullmatch(name)]
        if not names:
            raise ValueError(f"{source.path}: no depth image, expected frame-000000.depth.png and so on")
        there = camera is None and _INTRINSICS in source.names
        found = _camera_in_text(source.inside(_INTRINSICS)) if there else None
        super().__init__(source, [source.inside(name) for name in names], camera, pixel_stride, found)

    def _pose(self, i: int) -> Pose:
        return read_pose(self._files[i][: -len("depth.png")] + "pose.txt")


class TumRgbdLog(DepthLog):
    """``depth.txt`` (a time and a PNG of 5000 a metre a line), and ``groundtruth.txt`` or `trajectory`, whose
    poses are interpolated at the images' times plus `time_offset` [s].
    """

    format = "tum_rgbd"
    no_depth = ()
    usual, whose = TUM_CAMERA, "that of TUM's images"

    def __init__(
        self,
        source: Source,
        camera: str | None = None,
        pixel_stride: int = 1,
        trajectory: str | None = None,
        time_offset: float = 0.0,
    ) -> None:
        stamps, names = _images(source.inside(_TUM_IMAGES))
        super().__init__(source, [source.inside(name) for name in names], camera, pixel_stride)
        trajectory = source.inside(_GROUND_TRUTH) if trajectory is None else trajectory
        self._poses = PosesOfFiles(trajectory, self._files, None, time_offset, stamps)


class DepthFolderLog(DepthLog):
    """``depth/*.png`` or ``.pgm`` in millimetres, and ``trajectory.log``; or images of ICL-NUIM.

    Times of images are their names, or in a list ``associations.txt``. The camera is `camera`, else the
    intrinsic matrix in a JSON of the folder, as Open3D writes it, else Open3D's default, with a note.
    """

    format = "depth_folder"
    usual, whose = OPEN3D_CAMERA, "a PrimeSense"

    def __init__(
        self,
        source: Source,
        camera: str | None = None,
        pixel_stride: int = 1,
        trajectory: str | None = None,
        time_offset: float = 0.0,
    ) -> None:
        folder = source.inside(IMAGES)
        names = sorted(_images_in(folder), key=lambda name: (number_in(stem_of(name)) or 0, name))
        trajectory = trajectory or _trajectory_in(source)
        if trajectory is None:
            way = f"ndtree map {source.path} --trajectory FILE (poses of the camera)"
            raise NotALog(source.path, f"{len(names)} depth images without poses", [way])
        if trajectory.endswith(_OF_ICL):
            self.usual, self.whose = ICL_CAMERA, "that of ICL-NUIM"
        found = _camera_in_json(source) if camera is None else None
        files = [os.path.join(folder, name) for name in names]
        super().__init__(source, files, camera, pixel_stride, found)
        self._poses = PosesOfFiles(trajectory, self._files, None, time_offset, _times_in(source, names))


def _images_in(folder: str) -> list[str]:
    return [name for name in os.listdir(folder) if name.lower().endswith(ENDINGS)]


def _matrix_camera(values: Any, scale: float) -> Camera:
    """Of the 9 numbers of a camera's matrix, row by row."""
    matrix = np.array(values, dtype=np.float64).reshape(3, 3)
    return Camera(*matrix[[0, 1, 0, 1], [0, 1, 2, 2]].tolist(), scale)


def _camera_in_text(path: str) -> Camera:
    with at_place(path, "a camera's 3x3 matrix"):
        fields = [float(field) for _, line in text_lines(path) for field in line.split()]
        return _matrix_camera(fields, SEVEN_SCENES_CAMERA.scale)


def _camera_in_json(source: Source) -> Camera | None:
    """Of the only JSON with an intrinsic matrix, which Open3D writes column by column."""
    for name in source.names:
        path = source.inside(name)
        if not name.lower().endswith(".json") or not os.path.isfile(path):
            continue
        with open_regular(path) as file:
            content = file.read(_CAMERA_FILE)
        try:
            found = json.loads(content)
        except (ValueError, RecursionError):
            continue
        if not isinstance(found, dict) or "intrinsic_matrix" not in found:
            continue
        try:
            columns = np.array(found["intrinsic_matrix"], dtype=np.float64).reshape(3, 3)
            return _matrix_camera(columns.T, float(found.get("depth_scale", OPEN3D_CAMERA.scale)))
        except (TypeError, ValueError) as error:
            expected = f"expected the 9 numbers of a camera's matrix ({one_line(error)})"
            raise ValueError(f"{path}: intrinsic_matrix: {expected}") from None
    return None


def _trajectory_in(source: Source) -> str | None:
    for name in _POSES:
        path = source.inside(*name.split("/"))
        if os.path.isfile(path) and trajectory_kind(path) is not None:
            return path
    return only_trajectory(source.path, source.names)


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


def _images(path: str) -> tuple[list[float], list[str]]:
    stamps, names = [], []
    for number, line in text_lines(path):
        fields = line.split("#", 1)[0].split(maxsplit=1)
        if fields:
            try:
                stamp, name = fields
                stamps.append(float(stamp))
                if not math.isfinite(stamps[-1]):
                    raise ValueError
            except ValueError:
                raise wrong_line(path, number, line, "a time [s] and the name of an image") from None
            names.append(name.strip())
    if not names:
        raise ValueError(f"{path}: no images, expected a line each with a time [s] and the name of an image")
    return stamps, names


def _is_depth_folder(source: Source) -> bool:
    folder = source.inside(IMAGES)
    return IMAGES in source.names and os.path.isdir(folder) and bool(_images_in(folder))


def _is_scenes(source: Source) -> bool:
    return any(map(_FRAME.fullmatch, source.names))


def _is_tum(source: Source) -> bool:
    return _TUM_IMAGES in source.names and not {_GROUND_TRUTH, "depth"}.isdisjoint(source.names)


_OF_CAMERA, _OF_POSES = ("camera", "pixel_stride"), ("trajectory", "time_offset")
_ALL, _OPEN3D = (*_OF_CAMERA, *_OF_POSES), "a folder of depth images with a trajectory, as Open3D's"
SEVEN_SCENES = Format("seven_scenes", "a 7-Scenes folder", _is_scenes, SevenScenesLog, _OF_CAMERA, "folder")
TUM_RGBD = Format("tum_rgbd", "a TUM RGB-D folder", _is_tum, TumRgbdLog, _ALL, "folder")
DEPTH_FOLDER = Format("depth_folder", _OPEN3D, _is_depth_folder, DepthFolderLog, _ALL, "folder")
