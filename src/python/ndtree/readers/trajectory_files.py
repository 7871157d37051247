# SPDX-License-Identifier: BSD-3-Clause
"""Files of poses and of times, as of TUM and KITTI."""

from __future__ import annotations

import os
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ndtree.readers.plain_file import text_lines
from ndtree.readers.pose import Pose
from ndtree.readers.source import ReaderOption
from ndtree.readers.trajectory import Trajectory

Floats = NDArray[np.float64]

TRAJECTORY = ReaderOption("trajectory", str, "File of poses, TUM (t x y z qx qy qz qw) or KITTI (3x4).")

EXPECTED = "expected 8 numbers a line (t x y z qx qy qz qw) or 12 (3x4 matrix)"


def read_trajectory(
    path: str | os.PathLike[str], *, times: str | os.PathLike[str] | None = None
) -> Trajectory:
    """Read a trajectory file of TUM or KITTI; blank lines and comments behind # are passed over.

    Parameters
    ----------
    path : str or path
        8 numbers a line are a time [s], a position [m] and a quaternion (x, y, z, w); 12 are the upper three
        rows of a pose's matrix.
    times : str or path, optional
        Times of the poses of a KITTI file, one a line [s]. Left out, a pose's time is its number, from 0.

    Returns
    -------
    Trajectory

    Raises
    ------
    OSError
        If a file cannot be read.
    ValueError
        If a line is not as it should be: which, what was found, and what was expected.
    """
    name = os.fspath(path)
    rows = [(number, values) for number, values in _numbers(name)]
    if not rows:
        raise ValueError(f"{name}: no poses, {EXPECTED}")
    columns = len(rows[0][1])
    for number, values in rows:
        if columns not in (8, 12) or len(values) != columns:
            expected = EXPECTED if columns not in (8, 12) else f"expected {columns} as in the line before"
            raise ValueError(f"{name}: line {number}: found {len(values)} numbers, {expected}")
    table = np.array([values for _, values in rows])
    if columns == 8:
        if times is not None:
            raise ValueError(f"{name}: has times of its own, expected none in {os.fspath(times)}")
        rising = np.concatenate([[True], table[1:, 0] != table[:-1, 0]])  # A pose said twice is one.
        table = table[rising]
        return Trajectory(table[:, 0], table[:, 1:4], table[:, 4:], name=name)
    matrices = table.reshape(-1, 3, 4)
    stamps = np.arange(len(matrices), dtype=np.float64)
    if times is not None:
        stamps = read_times(times)
        if len(stamps) != len(matrices):
            raise ValueError(
                f"{os.fspath(times)}: {len(stamps)} times, "
                f"expected {len(matrices)} as there are poses in {name}"
            )
    return Trajectory(stamps, matrices[:, :, 3], matrices[:, :, :3], name=name, is_numbered=times is None)


def read_pose(path: str | os.PathLike[str]) -> Pose:
    """The pose in a file of its own: a matrix of 3x4 or 4x4 numbers, however broken into lines."""
    name = os.fspath(path)
    values = [value for _, line in _numbers(name) for value in line]
    if len(values) not in (12, 16):
        raise ValueError(f"{name}: found {len(values)} numbers, expected a matrix of 3x4 or 4x4")
    matrix = np.array(values).reshape(-1, 4)
    if not np.isfinite(matrix).all():
        raise ValueError(f"{name}: the pose is not finite")
    if len(matrix) == 4 and not np.allclose(matrix[3], (0, 0, 0, 1), atol=1e-9):
        raise ValueError(f"{name}: the last row is {matrix[3].tolist()}, expected 0 0 0 1")
    try:
        return Pose.from_matrix(matrix)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None


def trajectory_kind(path: str | os.PathLike[str]) -> str | None:
    """What the first line with anything on it looks like: "tum", "kitti", or None for neither."""
    try:
        _, values = next(_numbers(os.fspath(path)), (0, []))
    except ValueError:
        return None
    return {8: "tum", 12: "kitti"}.get(len(values))


def read_times(path: str | os.PathLike[str]) -> Floats:
    """Times of a file that has one number a line [s]."""
    name = os.fspath(path)
    stamps = []
    for number, values in _numbers(name):
        if len(values) != 1:
            raise ValueError(f"{name}: line {number}: found {len(values)} numbers, expected one, a time [s]")
        stamps.append(values[0])
    return np.array(stamps, dtype=np.float64)


def _numbers(path: str) -> Iterator[tuple[int, list[float]]]:
    """Numbers of each line that has any, and the line's number."""
    for number, line in text_lines(path):
        fields = line.split("#", 1)[0].replace(",", " ").split()
        if not fields:
            continue
        try:
            yield number, [float(field) for field in fields]
        except ValueError:
            found = " ".join(fields)[:40]
            raise ValueError(f"{path}: line {number}: found {found!r}, expected only numbers") from None
