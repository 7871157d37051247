# SPDX-License-Identifier: BSD-3-Clause
"""Files of one point cloud: PCD, PLY, LAS and LAZ, text, and bare numbers."""

from __future__ import annotations

import codecs
import math
import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndtree.logs.core.arrays import Floats, Points
from ndtree.logs.core.plain_file import open_regular
from ndtree.logs.folders import text_clouds
from ndtree.logs.folders.las_files import las_note, las_points
from ndtree.logs.folders.pcd_files import pcd_columns
from ndtree.logs.folders.ply_files import ply_columns, ply_viewpoint
from ndtree.logs.folders.text_clouds import text_points
from ndtree.logs.poses.pose import Pose


def _numbers(path: str, most: int = -1) -> tuple[int, NDArray[np.float32]]:
    """Size of a file [bytes], and its first float32 numbers, `most` of them."""
    with open_regular(path) as file:
        return os.fstat(file.fileno()).st_size, np.fromfile(file, dtype="<f4", count=most)


def bin_points(path: str, width: int) -> NDArray[np.float32]:
    """(n, 3) points of a file of `width` numbers a point; ValueError where these are not whole points."""
    size, numbers = _numbers(path)
    if size % (4 * width):
        raise ValueError(f"{path}: {size} bytes, expected a multiple of {4 * width} ({WIDTHS[width]})")
    return numbers.reshape(-1, width)[:, :3]


def may_be_points(path: str) -> bool:
    """Whether a file holds numbers as coordinates are: finite but for few, and none absurdly large."""
    size, part = _numbers(path, _SAMPLE)
    with np.errstate(invalid="ignore"):
        usual = (np.abs(part) < _FAR) & ((part == 0) | (np.abs(part) > _TINY))
    is_usual = size % 4 == 0 and len(part) >= 3 and bool(np.mean(usual) > _MOST)
    return is_usual and bool(np.any(part[usual] != 0))


#: Bounds of what may be a coordinate or an intensity, but for a share of the numbers.
_FAR, _TINY, _MOST = 1e6, 1e-9, 0.99


def floats_a_point(files: Sequence[str]) -> int:
    """How many float32 a point has, told from files of one kind: 4 where nothing speaks against it.

    With the right number, each column is one quantity; with another one, columns mix coordinates, intensity
    and rings, and spread more. Compared is the mean logarithm of the columns' standard deviations. Where all
    files hold whole points of 4, a number of which most files do not is none.

    Raises ValueError if another number than 4 fits better, though not clearly.
    """
    samples, sizes, path = [], [], files[0]
    last = len(files) - 1
    for path in (files[i] for i in sorted({round(i * last / 4) for i in range(5)})):
        size, part = _numbers(path, _SAMPLE)
        sizes.append(size)
        if len(part) >= _FEWEST:
            samples.append(np.clip(np.nan_to_num(part.astype(np.float64), posinf=0.0, neginf=0.0), -1e4, 1e4))
    if not samples:
        return 4
    spreads = {width: float(np.mean([_spread(one, width) for one in samples])) for width in WIDTHS}
    noise = max(_CLEARLY / 4, _SURE / math.sqrt(2 * sum(map(len, samples))))
    clearly = max(_CLEARLY, 1.5 * noise)
    misfits = {width: sum(size % (4 * width) != 0 for size in sizes) for width in WIDTHS}
    possible = [width for width in WIDTHS if 2 * misfits[width] <= len(sizes) or misfits[4]]
    best = min(possible, key=lambda width: spreads[width])
    if best in (6, 8) and spreads[best // 2] - spreads[best] <= clearly:
        best //= 2  # Every second point of the same is as good.
    gain = spreads[4] - spreads[best]
    if gain <= 0.0:
        return 4
    if gain > clearly:
        return best
    fitting = [width for width in WIDTHS if not misfits[width]]
    if 4 in fitting and (gain < noise or best not in fitting):
        return 4
    if fitting == [best]:
        return best
    raise ValueError(f"{path}: has points 4 or {best} numbers? Expected float32 {WIDTHS[4]}")


#: What the numbers of a point are.
_MORE = ("", " intensity", *(f" intensity and {some} more" for some in ("one", "two", "three", "four")))
WIDTHS = {3 + i: f"x y z{more}" for i, more in enumerate(_MORE)}
#: Numbers that are looked at in a file, and how many there must be.
_SAMPLE, _FEWEST = 60_000, 60
#: Mean logarithm by which columns spread less with the right number.
_CLEARLY = 0.1
#: Standard errors of that mean that are no chance; one is 1 / sqrt(2 n) of n numbers.
_SURE = 2.5


def _spread(sample: Floats, width: int) -> float:
    """Mean logarithm of the columns' standard deviations; that of a constant one is 0.001 of the sample's."""
    table = sample[: len(sample) // width * width].reshape(-1, width)
    floor = max(1e-3 * float(sample.std()), 1e-12)
    return float(np.log(np.maximum(table.std(axis=0), floor)).mean())


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


def pcd_viewpoint(path: str) -> Pose:
    """Pose of the sensor in a PCD's header; the identity where the header has none.

    `0 0 0 0 0 0 1` is the identity, too: many programs write it so, with the quaternion's w last.
    """
    with open_regular(path) as file:
        for _ in range(100):
            line = file.readline(4096)
            if not line or line.startswith(b"DATA"):
                break
            if line.startswith(b"VIEWPOINT"):
                fields = line.decode("ascii", "replace").split()[1:]
                said = f"{path}: VIEWPOINT: found {' '.join(fields)!r}, expected x y z qw qx qy qz"
                if len(fields) != 7:
                    raise ValueError(said)
                try:
                    x, y, z, qw, qx, qy, qz = numbers = [float(field) for field in fields]
                    if numbers == [0, 0, 0, 0, 0, 0, 1]:
                        return Pose.identity()
                    return Pose.from_quaternion((x, y, z), (qx, qy, qz, qw))
                except ValueError as error:
                    raise ValueError(f"{said} ({error})") from None
    return Pose.identity()


_PCD = (b"# .PCD", b"# .pcd", b"VERSION", b"FIELDS", b"COLUMNS")
#: Those without first bytes of their own come last, and only their names tell them.
CLOUD_FILES = (
    CloudFile("PCD", (".pcd",), _PCD, lambda path: _points(pcd_columns(path)), pcd_viewpoint),
    CloudFile("PLY", (".ply",), (b"ply\n", b"ply\r"), lambda path: _points(ply_columns(path)), ply_viewpoint),
    CloudFile("LAS", (".las", ".laz"), (b"LASF",), las_points, note=las_note),
    CloudFile("text", text_clouds.ENDINGS, (), text_points),
    CloudFile("bin", (".bin",), (), lambda path: bin_points(path, floats_a_point([path]))),
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
        raise ValueError(f"{path}: expected a PCD, PLY, LAS or LAZ, points in text, or numbers (.bin)")
    return kind.points(path)


def _points(columns: Sequence[NDArray[Any]]) -> Points:
    small = all(column.dtype.newbyteorder("=") == np.float32 for column in columns)
    return np.stack([column.astype(np.float32 if small else np.float64) for column in columns], axis=1)
