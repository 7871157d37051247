# SPDX-License-Identifier: BSD-3-Clause
"""Models of COLMAP, binary or text: a folder of cameras, images and points3D."""

from __future__ import annotations

import math
import os
import struct
from collections.abc import Iterator
from typing import IO

import numpy as np
from numpy.typing import NDArray

from ndtree.base.scan import Scan
from ndtree.logs.core.arrays import Floats
from ndtree.logs.core.failures import at_place
from ndtree.logs.core.plain_file import open_regular, text_lines
from ndtree.logs.core.source import Format, Source
from ndtree.logs.poses.pose import Pose
from ndtree.logs.sfm.triangulation import DEFAULT_PIXEL_SIGMA, Model, SfmLog

PARTS = ("cameras", "images", "points3D")

#: Models of cameras: their number in binary files, their parameters, and how many of these are focal lengths.
CAMERA_MODELS = {
    "SIMPLE_PINHOLE": (0, 3, 1),
    "PINHOLE": (1, 4, 2),
    "SIMPLE_RADIAL": (2, 4, 1),
    "RADIAL": (3, 5, 1),
    "OPENCV": (4, 8, 2),
    "OPENCV_FISHEYE": (5, 8, 2),
    "FULL_OPENCV": (6, 12, 2),
    "FOV": (7, 5, 2),
    "SIMPLE_RADIAL_FISHEYE": (8, 4, 1),
    "RADIAL_FISHEYE": (9, 5, 1),
    "THIN_PRISM_FISHEYE": (10, 12, 2),
    "RAD_TAN_THIN_PRISM_FISHEYE": (11, 16, 2),
    "SIMPLE_DIVISION": (12, 4, 1),
    "DIVISION": (13, 5, 2),
    "SIMPLE_FISHEYE": (14, 3, 1),
    "FISHEYE": (15, 4, 2),
    "EUCM": (16, 6, 2),
    "EQUIRECTANGULAR": (17, 2, 0),
}
_NAMES = {number: name for name, (number, _, _) in CAMERA_MODELS.items()}

Identities = NDArray[np.int64]


class ColmapLog(SfmLog):
    """One scan each image, in the order of the file.

    Distances are in the unit of the model, which is not a metre unless the model was scaled.
    """

    format = "colmap"
    _damage: ValueError | None = None

    def __init__(self, source: Source, pixel_sigma: float = DEFAULT_PIXEL_SIGMA) -> None:
        super().__init__(source, pixel_sigma)
        path = source.path
        ending = _ending(source.names)
        if ending is None:
            raise ValueError(f"{path}: expected {' and '.join(PARTS)}, all with .bin or all with .txt")
        self._files: type[_Binary | _Text] = _Binary if ending == ".bin" else _Text
        self._names = {part: os.path.join(path, part + ending) for part in PARTS}

    def _read(self) -> Model:
        names, path = self._names, self._names["images"]
        focal_lengths = dict(self._files.cameras(names["cameras"]))
        identities, points = self._files.points(names["points3D"])
        order = np.argsort(identities)
        identities, points = identities[order], points[order]
        self._check_points(identities, points)
        centers: list[Floats] = []
        lengths: list[float] = []
        rows: list[NDArray[np.intp]] = []
        try:
            for where, camera, T_camera_map, seen in self._files.images(path):
                if camera not in focal_lengths:
                    raise ValueError(f"{path}: {where}: camera {camera} is not in {names['cameras']}")
                seen = np.unique(seen[seen >= 0])  # Two features of an image may be one point.
                at = np.searchsorted(identities, seen)
                known = at < len(identities)
                known[known] = identities[at[known]] == seen[known]
                if not known.all():
                    lost = seen[known.argmin()]
                    raise ValueError(f"{path}: {where}: point {lost} is not in {names['points3D']}")
                rows.append(at)
                centers.append(T_camera_map.inverse().position)
                lengths.append(focal_lengths[camera])
        except ValueError as error:
            if not self.rules.keep_going:
                raise
            self._damage = error
        return Model(points, np.array(centers).reshape(-1, 3), np.array(lengths), rows)

    def _check_points(self, identities: Identities, points: Floats) -> None:
        path = self._names["points3D"]
        twice = np.flatnonzero(np.diff(identities) == 0)
        if twice.size:
            raise ValueError(f"{path}: point {identities[twice[0]]} is there twice, expected once")
        finite = np.isfinite(points).all(axis=1)
        if not finite.all():
            raise ValueError(f"{path}: point {identities[finite.argmin()]} is not finite")

    def _scans(self) -> Iterator[Scan]:
        yield from super()._scans()
        if self._damage is not None:
            self.skip("damaged files", self._damage)


class _Text:
    """Text files; errors of this and of `_Binary` name the file and the place in it.

    ``cameras`` has of each its name and focal length [px]; ``images``, where each stands, its camera's name,
    T_camera_map, and names of points, -1 for a feature without; ``points``, names (n,), and points (n, 3).
    """

    @staticmethod
    def cameras(path: str) -> Iterator[tuple[int, float]]:
        for where, line in _lines(path):
            with at_place(f"{path}: {where}", "CAMERA_ID MODEL WIDTH HEIGHT PARAMS"):
                camera, model, _, _, *rest = line.split()
                found = int(camera), [float(field) for field in rest]
            yield found[0], _focal_length(path, where, model, found[1])

    @staticmethod
    def images(path: str) -> Iterator[tuple[str, int, Pose, Identities]]:
        lines = _lines(path, skip_blank=False)
        for where, line in lines:
            if not line.strip():
                continue
            with at_place(f"{path}: {where}", "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME"):
                _, w, x, y, z, tx, ty, tz, camera_id, *_ = line.split(maxsplit=9)
                numbers, camera = [float(one) for one in (w, x, y, z, tx, ty, tz)], int(camera_id)
            pose = _pose(path, where, numbers)
            # The line of features, which is blank for an image without.
            where_seen, second = next(lines, ("", ""))
            if not where_seen:
                raise ValueError(f"{path}: after {where}: cut off, expected a line of X Y POINT3D_ID")
            features = second.split()
            try:
                seen = np.array(features[2::3], dtype=np.int64)
            except (ValueError, OverflowError):
                seen = np.empty(0, dtype=np.int64)
            if 3 * len(seen) != len(features):
                raise ValueError(f"{path}: {where_seen}: {len(features)} fields, expected X Y POINT each")
            yield where, camera, pose, seen

    @staticmethod
    def points(path: str) -> tuple[Identities, Floats]:
        identities, points = [], []
        for where, line in _lines(path):
            with at_place(f"{path}: {where}", "POINT3D_ID X Y Z R G B ERROR TRACK"):
                identity, x, y, z, *_ = line.split(maxsplit=4)
                identities.append(int(identity))
                points.append((float(x), float(y), float(z)))
        return np.array(identities, dtype=np.int64), np.array(points, dtype=np.float64).reshape(-1, 3)


class _Binary:
    """As `_Text`, of binary files."""

    @staticmethod
    def cameras(path: str) -> Iterator[tuple[int, float]]:
        with open_regular(path) as file:
            for where in _records(file, path, "camera", smallest=24):
                camera, number, _, _ = _unpacked(file, path, where, "<IiQQ")
                if number not in _NAMES:
                    raise ValueError(f"{path}: {where}: found model {number}, expected 0 to {max(_NAMES)}")
                name = _NAMES[number]
                parameters = _unpacked(file, path, where, f"<{CAMERA_MODELS[name][1]}d")
                yield camera, _focal_length(path, where, name, list(parameters))

    @staticmethod
    def images(path: str) -> Iterator[tuple[str, int, Pose, Identities]]:
        with open_regular(path) as file:
            for where in _records(file, path, "image", smallest=73):
                numbers = _unpacked(file, path, where, "<I7dI")
                while _take(file, path, where, 1) != b"\0":
                    pass  # The image's name.
                (features,) = _unpacked(file, path, where, "<Q")
                table = np.frombuffer(_take(file, path, where, 24 * features), dtype="<i8").reshape(-1, 3)
                yield where, numbers[8], _pose(path, where, list(numbers[1:8])), table[:, 2]

    @staticmethod
    def points(path: str) -> tuple[Identities, Floats]:
        with open_regular(path) as file:
            identities, points = [], []
            for where in _records(file, path, "point", smallest=51):
                identity, x, y, z, _, _, _, _, track = _unpacked(file, path, where, "<q3d3BdQ")
                identities.append(identity)
                points.append((x, y, z))
                _take(file, path, where, 8 * track)
        return np.array(identities, dtype=np.int64), np.array(points, dtype=np.float64).reshape(-1, 3)


def _ending(names: list[str] | tuple[str, ...]) -> str | None:
    """Binary files come first, as COLMAP itself takes them."""
    for ending in (".bin", ".txt"):
        if all(part + ending in names for part in PARTS):
            return ending
    return None


def _focal_length(path: str, where: str, model: str, parameters: list[float]) -> float:
    """The mean of both axes [px]."""
    if model not in CAMERA_MODELS:
        raise ValueError(f"{path}: {where}: found model {model!r}, expected {', '.join(CAMERA_MODELS)}")
    _, count, focal = CAMERA_MODELS[model]
    if len(parameters) != count:
        raise ValueError(f"{path}: {where}: found {len(parameters)} parameters, {model} has {count}")
    if focal == 0:  # Columns of equal angles: `focal` of them are a radian.
        length = parameters[0] / (2 * math.pi)
    else:
        length = min(parameters[:focal])
        length = sum(parameters[:focal]) / focal if length > 0 else length
    if not (length > 0 and math.isfinite(length)):
        raise ValueError(f"{path}: {where}: found a focal length of {length:g} px, expected one > 0")
    return length


def _pose(path: str, where: str, numbers: list[float]) -> Pose:
    """T_camera_map of a quaternion w x y z and a translation."""
    w, x, y, z = numbers[:4]
    if not np.isfinite(numbers).all():
        raise ValueError(f"{path}: {where}: found a pose that is not finite")
    with at_place(f"{path}: {where}"):
        return Pose.from_quaternion(numbers[4:], (x, y, z, w))


def _lines(path: str, *, skip_blank: bool = True) -> Iterator[tuple[str, str]]:
    for number, line in text_lines(path):
        if not line.startswith("#") and (line.strip() or not skip_blank):
            yield f"line {number}", line


def _records(file: IO[bytes], path: str, what: str, *, smallest: int) -> Iterator[str]:
    """Where each record of a file stands that begins with their number, and that ends with the last."""
    (count,) = _unpacked(file, path, f"number of {what}s", "<Q")
    left = os.fstat(file.fileno()).st_size - 8
    if count * smallest > left:
        raise ValueError(f"{path}: {left} bytes for {count} {what}s, expected at least {count * smallest}")
    for i in range(count):
        yield f"{what} {i + 1} of {count}"
    if file.read(1):
        raise ValueError(f"{path}: after {what} {count} of {count}: more bytes, expected the end")


def _take(file: IO[bytes], path: str, where: str, size: int) -> bytes:
    if size > 1 << 16 and size > os.fstat(file.fileno()).st_size - file.tell():
        content = b""
    else:
        content = file.read(size)
    if len(content) != size:
        raise ValueError(f"{path}: {where}: the file is cut off, expected {size} bytes more")
    return content


def _unpacked(file: IO[bytes], path: str, where: str, layout: str) -> tuple:
    return struct.unpack(layout, _take(file, path, where, struct.calcsize(layout)))


def _recognises(source: Source) -> bool:
    return _ending(source.names) is not None


COLMAP = Format("colmap", "a COLMAP model", _recognises, ColmapLog, ("pixel_sigma",), "folder")
