# SPDX-License-Identifier: BSD-3-Clause
"""Files of one point cloud: PCD, PLY, LAS and LAZ, text, and bare numbers."""

from __future__ import annotations

import codecs
import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndtree.logs.core.plain_file import open_regular
from ndtree.logs.folders import text_clouds
from ndtree.logs.folders.bin_files import bin_points, floats_a_point
from ndtree.logs.folders.las_files import las_note, las_points
from ndtree.logs.folders.pcd_files import pcd_columns
from ndtree.logs.folders.ply_files import ply_camera, ply_columns
from ndtree.logs.folders.text_clouds import text_points
from ndtree.logs.poses.pose import Pose

Points = NDArray[np.floating[Any]]


@dataclass(frozen=True)
class CloudFile:
    """One kind of file: its endings, how its content begins, and how its points are read.

    ``points`` makes (n, 3) of a path, float32 where the file has no more [m]; it raises ValueError that says
    what is wrong with the file. ``viewpoint`` makes the pose of the sensor, the identity where the file says
    none; None: such files never do. ``note`` makes a line that a user should know of a file, or none.
    """

    name: str
    endings: tuple[str, ...]
    magic: tuple[bytes, ...]
    points: Callable[[str], Points]
    viewpoint: Callable[[str], Pose] | None = None
    note: Callable[[str], str] | None = None


def pcd_points(path: str) -> Points:
    """Points of a PCD: ascii, binary or binary_compressed; NaN where the sensor measured nothing."""
    return _columns(*pcd_columns(path))


def pcd_viewpoint(path: str) -> Pose:
    """Pose of the sensor in a PCD's header; the identity where the header has none."""
    with open_regular(path) as file:
        for _ in range(100):
            line = file.readline(4096)
            if not line or line.startswith(b"DATA"):
                break
            if line.startswith(b"VIEWPOINT"):
                fields = line.decode("ascii", "replace").split()[1:]
                try:
                    x, y, z, qw, qx, qy, qz = (float(field) for field in fields)
                    return Pose.from_quaternion((x, y, z), (qx, qy, qz, qw))
                except ValueError as error:
                    raise ValueError(
                        f"{path}: VIEWPOINT: found {' '.join(fields)!r}, expected x y z qw qx qy qz ({error})"
                    ) from None
    return Pose.identity()


def ply_viewpoint(path: str) -> Pose:
    """Pose of the sensor in a PLY's element camera, as PCL writes it; the identity where there is none."""
    found = ply_camera(path)
    if found is None:
        return Pose.identity()
    position, rotation = found
    try:
        return Pose.from_matrix(np.column_stack([rotation, position]))
    except ValueError as error:
        raise ValueError(f"{path}: element camera: expected a position and a rotation ({error})") from None


def ply_points(path: str) -> Points:
    """Vertices of a PLY, ascii or binary, with or without faces."""
    return _columns(*ply_columns(path))


def points_of_numbers(path: str) -> Points:
    """Points of a file of float32 numbers; how many a point has is told from the content."""
    return bin_points(path, floats_a_point([path]))


#: Those without first bytes of their own come last, and only their names tell them.
CLOUD_FILES = (
    CloudFile(
        "PCD", (".pcd",), (b"# .PCD", b"# .pcd", b"VERSION", b"FIELDS", b"COLUMNS"), pcd_points, pcd_viewpoint
    ),
    CloudFile("PLY", (".ply",), (b"ply\n", b"ply\r"), ply_points, ply_viewpoint),
    CloudFile("LAS", (".las", ".laz"), (b"LASF",), las_points, note=las_note),
    CloudFile("text", text_clouds.ENDINGS, (), text_points),
    CloudFile("bin", (".bin",), (), points_of_numbers),
)
TEXT_CLOUD, BIN_CLOUD = CLOUD_FILES[-2:]


#: A PCD's header may begin with any comments and blank lines; bytes of a file that are looked at for it.
_PCD_HEADER = re.compile(
    rb"\s*#[ \t]*\.PCD\b|(?:\s*#[^\n]*\n)*\s*(?:VERSION|FIELDS|COLUMNS)[ \t]", re.IGNORECASE
)
_LOOKED_AT = 4096


def kind_of_file(head: bytes) -> CloudFile | None:
    """What a file is by its first bytes."""
    head = head.removeprefix(codecs.BOM_UTF8)
    for kind in CLOUD_FILES:
        if kind.magic and head.startswith(kind.magic):
            return kind
    return kind_of_name("a.pcd") if _PCD_HEADER.match(head[:_LOOKED_AT]) else None


def kind_of_name(name: str) -> CloudFile | None:
    """What a file should be by the ending of its name."""
    ending = os.path.splitext(name)[1].lower()
    for kind in CLOUD_FILES:
        if ending in kind.endings:
            return kind
    return None


def points_of_file(path: str, among: CloudFile | None = None) -> Points:
    """(n, 3) points of a file: by its content, else of the kind that its name says."""
    with open_regular(path) as file:
        kind = kind_of_file(file.read(_LOOKED_AT))
    if kind is None and among in (TEXT_CLOUD, BIN_CLOUD):
        kind = among
    if kind is None:
        raise ValueError(
            f"{path}: expected a PCD, PLY, LAS or LAZ file, points in text, or float32 numbers (.bin)"
        )
    return kind.points(path)


def _columns(*columns: NDArray[Any]) -> Points:
    small = all(column.dtype.newbyteorder("=") == np.float32 for column in columns)
    return np.stack([column.astype(np.float32 if small else np.float64) for column in columns], axis=1)
