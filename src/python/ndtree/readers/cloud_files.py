# SPDX-License-Identifier: BSD-3-Clause
"""Files of one point cloud: PCD, PLY, LAS and LAZ, each read by the library that is kept for it."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndtree.readers.failures import one_line
from ndtree.readers.las_files import INSTALL, las_points
from ndtree.readers.plain_file import open_regular
from ndtree.readers.pose import Pose

Points = NDArray[np.floating[Any]]


@dataclass(frozen=True)
class CloudFile:
    """One kind of file: its endings, how its content begins, and how its points are read.

    ``points`` makes (n, 3) of a path, float32 where the file has no more [m]; it raises ValueError that says
    what is wrong with the file.
    """

    name: str
    endings: tuple[str, ...]
    magic: tuple[bytes, ...]
    points: Callable[[str], Points]


def pcd_points(path: str) -> Points:
    """Points of a PCD: ascii, binary or binary_compressed; NaN where the sensor measured nothing."""
    pypcd4 = _pypcd4()
    with open_regular(path) as file:
        try:
            cloud = pypcd4.PointCloud.from_fileobj(file)
            data = np.atleast_1d(cloud.pc_data)
        except (OSError, MemoryError):
            raise
        except Exception as error:  # The library has no error of its own: anything may come from below it.
            raise _damaged(path, "PCD", error) from None
    if len(data) != cloud.metadata.points:
        raise _fewer(path, len(data), cloud.metadata.points)
    missing = [name for name in "xyz" if name not in data.dtype.names]
    if missing:
        raise ValueError(f"{path}: no field {' and no '.join(missing)}, found {', '.join(data.dtype.names)}")
    return _columns(data["x"], data["y"], data["z"])


def pcd_viewpoint(path: str) -> Pose:
    """Pose of the sensor in a PCD's header; what changes nothing where nobody said anything."""
    with open_regular(path) as file:
        for _ in range(100):
            line = file.readline(4096)
            if not line or line.startswith(b"DATA"):
                break
            if line.startswith(b"VIEWPOINT"):
                fields = line.decode("ascii", "replace").split()[1:]
                try:
                    x, y, z, qw, qx, qy, qz = (float(field) for field in fields)
                    if not np.isfinite((x, y, z)).all():
                        raise ValueError("not finite")
                    return Pose.from_quaternion((x, y, z), (qx, qy, qz, qw))
                except ValueError as error:
                    raise ValueError(
                        f"{path}: VIEWPOINT: found {' '.join(fields)!r}, expected x y z qw qx qy qz ({error})"
                    ) from None
    return Pose.identity()


def ply_points(path: str) -> Points:
    """Vertices of a PLY, ascii or binary, with or without faces."""
    try:
        import trimesh
    except ImportError as error:
        raise ImportError(f"PLY files need trimesh ({error}); {INSTALL}") from None
    with open_regular(path) as file:
        try:
            loaded = trimesh.load(file, file_type="ply", process=False)
            points = np.asarray(loaded.vertices)
        except (OSError, MemoryError):
            raise
        except Exception as error:  # As above.
            raise _damaged(path, "PLY", error) from None
    return points.reshape(-1, 3)


CLOUD_FILES = (
    CloudFile("PCD", (".pcd",), (b"# .PCD", b"VERSION", b"FIELDS"), pcd_points),
    CloudFile("PLY", (".ply",), (b"ply\n", b"ply\r"), ply_points),
    CloudFile("LAS", (".las", ".laz"), (b"LASF",), las_points),
)


def kind_of_file(head: bytes) -> CloudFile | None:
    """What a file is by its first bytes."""
    for kind in CLOUD_FILES:
        if head.startswith(kind.magic):
            return kind
    return None


def kind_of_name(name: str) -> CloudFile | None:
    """What a file should be by the ending of its name."""
    ending = os.path.splitext(name)[1].lower()
    for kind in CLOUD_FILES:
        if ending in kind.endings:
            return kind
    return None


def points_of_file(path: str) -> Points:
    """(n, 3) points of a file that is one of these by its content."""
    with open_regular(path) as file:
        kind = kind_of_file(file.read(16))
    if kind is None:
        raise ValueError(f"{path}: expected a {', '.join(kind.name for kind in CLOUD_FILES)} or LAZ file")
    return kind.points(path)


def _pypcd4() -> Any:
    try:
        import pypcd4
    except ImportError as error:
        raise ImportError(f"PCD files need pypcd4 ({error}); {INSTALL}") from None
    return pypcd4


def _damaged(path: str, kind: str, error: Exception) -> ValueError:
    return ValueError(f"{path}: cannot be read as {kind}, cut off or damaged ({one_line(error)})")


def _fewer(path: str, found: int, expected: int) -> ValueError:
    return ValueError(f"{path}: found {found} points, expected {expected} as its header says")


def _columns(*columns: NDArray[Any]) -> Points:
    small = all(column.dtype == np.float32 for column in columns)
    return np.stack([column.astype(np.float32 if small else np.float64) for column in columns], axis=1)
