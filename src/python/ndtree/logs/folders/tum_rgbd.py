# SPDX-License-Identifier: BSD-3-Clause
"""Folders as the TUM RGB-D benchmark has them: depth images with times, and the camera's trajectory."""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ndtree.logs.core.plain_file import text_lines
from ndtree.logs.core.source import TIME_OFFSET, Format, Source, require_dim
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
from ndtree.logs.poses.trajectory import Trajectory
from ndtree.logs.poses.trajectory_files import TRAJECTORY, read_trajectory

#: Depth images of the benchmark are made for this camera, whichever recorded them.
DEFAULT_CAMERA = Camera(525.0, 525.0, 319.5, 239.5, scale=5000.0)
IMAGES = "depth.txt"
GROUND_TRUTH = "groundtruth.txt"


class TumRgbdLog(FolderLog):
    """``depth.txt`` (a time and a PNG of 16 bits a line, 5000 a metre, 0 is no depth) and
    ``groundtruth.txt`` (t x y z qx qy qz qw), interpolated at the images' times.

    Parameters
    ----------
    source : Source
    camera : str, optional
        ``fx,fy,cx,cy[,scale]``; left out, the benchmark's.
    pixel_stride : int
        As for `points_of`.
    trajectory : str, optional
        Instead of ``groundtruth.txt``.
    time_offset : float
        Added to the images' times before their poses are looked up [s].
    """

    is_depth_camera = is_raw = True
    format = "tum_rgbd"

    def __init__(
        self,
        source: Source,
        camera: str | None = None,
        pixel_stride: int = 1,
        trajectory: str | None = None,
        time_offset: float = 0.0,
    ) -> None:
        check_stride(pixel_stride)
        self._camera = DEFAULT_CAMERA if camera is None else camera_of(camera, scale=DEFAULT_CAMERA.scale)
        self._pixel_stride = pixel_stride
        self._time_offset = time_offset
        self._stamps, names = _images(source.inside(IMAGES))
        self._trajectory_path = source.inside(GROUND_TRUTH) if trajectory is None else trajectory
        super().__init__(source.path, [source.inside(name) for name in names])

    @cached_property
    def _trajectory(self) -> Trajectory:
        return read_trajectory(self._trajectory_path)

    def _pose(self, i: int) -> Pose:
        return self._trajectory.pose_at(self._stamps[i] + self._time_offset)

    def _points(self, i: int) -> NDArray[np.floating]:
        return points_of(load_depth(self._files[i]), self._camera, pixel_stride=self._pixel_stride)

    def _stamp(self, i: int) -> float:
        return self._stamps[i]


def _images(path: str) -> tuple[list[float], list[str]]:
    """Times [s] and names of the images that a list has."""
    stamps, names = [], []
    for number, line in text_lines(path):
        fields = line.split("#", 1)[0].split(maxsplit=1)
        if not fields:
            continue
        try:
            stamp = float(fields[0])
        except ValueError:
            stamp = math.nan
        if len(fields) != 2 or not math.isfinite(stamp):
            raise ValueError(
                f"{path}: line {number}: found {line.strip()[:40]!r}, "
                "expected a time [s] and the name of an image"
            )
        stamps.append(stamp)
        names.append(fields[1].strip())
    if not names:
        raise ValueError(f"{path}: no images, expected a line each with a time [s] and the name of an image")
    return stamps, names


def _recognises(source: Source) -> bool:
    return IMAGES in source.names and (GROUND_TRUTH in source.names or "depth" in source.names)


def _open(
    source: Source,
    *,
    dim: int | None = None,
    camera: str | None = None,
    pixel_stride: int = 1,
    trajectory: str | None = None,
    time_offset: float = 0.0,
) -> TumRgbdLog:
    require_dim(source, TUM_RGBD, 3, dim)
    return TumRgbdLog(source, camera, pixel_stride, trajectory, time_offset)


TUM_RGBD = Format(
    "tum_rgbd",
    "a TUM RGB-D folder",
    _recognises,
    _open,
    (CAMERA, PIXEL_STRIDE, TRAJECTORY, TIME_OFFSET),
    stored_as="folder",
)
