# SPDX-License-Identifier: BSD-3-Clause
"""Files of poses and of times, as of TUM, KITTI, EuRoC, g2o and Open3D."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ndtree.logs.core.failures import at_place
from ndtree.logs.core.plain_file import are_numbers, floats_of, text_lines, with_points
from ndtree.logs.poses.pose import Pose
from ndtree.logs.poses.pose_columns import TUM, PoseColumns, columns_named, order_in_doubt, seconds_of
from ndtree.logs.poses.pose_lists import PoseList, kind_of_list, read_list
from ndtree.logs.poses.trajectory import Trajectory

Floats = NDArray[np.float64]


EXPECTED = "expected 8 numbers a line (t x y z qx qy qz qw), or 12 or 16 (3x4 or 4x4 matrix)"


def read_trajectory(
    path: str | os.PathLike[str], *, times: str | os.PathLike[str] | None = None
) -> Trajectory:
    """Read a trajectory file; blank lines and comments behind # are passed over.

    Formats are TUM's and KITTI's; tables whose first line names the columns, as EuRoC's; matrices of 4x4
    numbers, a line or four lines each; a time and a matrix a line; vertices of g2o; Open3D's trajectory.log.

    A first line that names a time, x y z and qx qy qz qw, as a comment or not, says the order of the columns:
    ``#timestamp [ns], p_x, p_y, p_z, q_w, q_x, q_y, q_z``, or ``sec,nsec,x,y,z,qx,qy,qz,qw``. Columns of
    other names are passed over. Stamps are in the unit that it names; without one, stamps since 1970 in ms,
    us and ns are told from their size.

    `path`: 8 numbers a line are a time [s], a position [m] and a quaternion (x, y, z, w), in this order
        unless a header says otherwise; 12 are the upper three rows of a pose's matrix.
    `times`: Times of the poses of a KITTI file, one a line [s]. Left out, a pose's time is its number, from
        0, or as a graph or log numbers it.
    Raises OSError if a file cannot be read; ValueError if a line is not as it should be: which, what was
    found, and what was expected.
    """
    name = os.fspath(path)
    kind = kind_of_list(name)
    if kind is not None:
        return _of_list(name, read_list(name, kind), times)
    named, rows = _rows(name)
    if not rows:
        raise ValueError(f"{name}: no poses, {EXPECTED}")
    columns = len(rows[0][1])
    for number, values in rows:
        if named is not None and len(values) != named.count:
            raise ValueError(
                f"{name}: line {number}: found {len(values)} numbers, "
                f"expected {named.count} as the header names columns"
            )
        if named is None and (columns not in (8, 12) or len(values) != columns):
            expected = EXPECTED if columns not in (8, 12) else f"expected {columns} as in the line before"
            raise ValueError(f"{name}: line {number}: found {len(values)} numbers, {expected}")
    table = np.array([values for _, values in rows])
    if named is not None or columns == 8:
        if times is not None:
            raise ValueError(f"{name}: has times of its own, expected none in {os.fspath(times)}")
        layout = named or TUM
        stamps = seconds_of(table[:, layout.time], layout.unit, name)
        if layout.part is not None:
            stamps = stamps + table[:, layout.part] / 1e9
        rising = np.concatenate([[True], stamps[1:] != stamps[:-1]])  # A pose said twice is one.
        poses = table[rising][:, list(layout.pose)]
        return Trajectory(stamps[rising], poses[:, :3], poses[:, 3:], name=name)
    matrices = table.reshape(-1, 3, 4)
    numbers = np.arange(len(matrices), dtype=np.float64)
    return _of_list(name, PoseList(numbers, matrices, is_numbered=True), times)


def _of_list(name: str, poses: PoseList, times: str | os.PathLike[str] | None) -> Trajectory:
    stamps, matrices, is_numbered = poses.stamps, poses.matrices, poses.is_numbered
    if not is_numbered:
        stamps = seconds_of(stamps, None, name)
    if times is not None:
        if not is_numbered:
            raise ValueError(f"{name}: has times of its own, expected none in {os.fspath(times)}")
        stamps, is_numbered = read_times(times), False
        if len(stamps) != len(matrices):
            raise ValueError(
                f"{os.fspath(times)}: {len(stamps)} times, "
                f"expected {len(matrices)} as there are poses in {name}"
            )
    return Trajectory(stamps, matrices[:, :, 3], matrices[:, :, :3], name=name, is_numbered=is_numbered)


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
    with at_place(name):
        return Pose.from_matrix(matrix)


def trajectory_kind(path: str | os.PathLike[str]) -> str | None:
    """What the first lines look like: "tum", "kitti" for poses by their number, or None for neither."""
    kind = kind_of_list(os.fspath(path))
    if kind is not None:
        return "tum" if kind.startswith("timed") else "kitti"
    try:
        named, values = next(_lines(os.fspath(path)), (None, (0, [])))
    except ValueError:
        return None
    if named is not None:
        return "tum" if len(values[1]) == named.count else None
    return {8: "tum", 12: "kitti"}.get(len(values[1]))


def read_times(path: str | os.PathLike[str]) -> Floats:
    """Times of a file that has one number a line [s]; those since 1970 may be in ms, us or ns."""
    name = os.fspath(path)
    stamps = []
    for number, values in _numbers(name):
        if len(values) != 1:
            raise ValueError(f"{name}: line {number}: found {len(values)} numbers, expected one, a time [s]")
        stamps.append(values[0])
    return seconds_of(np.array(stamps, dtype=np.float64), None, name)


def _rows(path: str) -> tuple[PoseColumns | None, list[tuple[int, list[float]]]]:
    """What a header names, if there is one, and the numbers of each line behind it."""
    found = list(_lines(path))
    return found[0][0] if found else None, [row for _, row in found]


def _lines(path: str) -> Iterator[tuple[PoseColumns | None, tuple[int, list[float]]]]:
    """Numbers of each line that has any, its number, and what a header before the first of them names."""
    named, behind_header = None, False
    for number, line in text_lines(path):
        if "\0" in line:
            raise ValueError(f"{path}: line {number}: binary data, expected poses in text")
        content = with_points(line.split("#", 1)[0])
        fields = content.replace(",", " ").replace(";", " ").split()
        if not behind_header and not are_numbers(fields):
            found = columns_named(line)
            if found is not None:
                named = found
                continue
            doubt = order_in_doubt(line) if named is None else None
            if doubt:
                raise ValueError(
                    f"{path}: line {number}: the header names {doubt}, but not one time, x y z and "
                    "qx qy qz qw, as in '# t,x,y,z,qw,qx,qy,qz'"
                )
        if fields:
            behind_header = True
            if named is not None:
                yield named, (number, _named_values(path, number, content, named))
            else:
                yield named, (number, floats_of(path, number, fields))


def _named_values(path: str, number: int, line: str, named: PoseColumns) -> list[float]:
    """Values of a line below a header; nan for words in columns that are no part of a pose."""
    fields = re.split(r"\s*[,;]\s*", line.strip().rstrip(",;")) if re.search("[,;]", line) else line.split()
    wanted = (named.time, named.part, *named.pose)
    return [
        floats_of(path, number, [field])[0] if i in wanted or are_numbers([field]) else math.nan
        for i, field in enumerate(fields)
    ]


def _numbers(path: str) -> Iterator[tuple[int, list[float]]]:
    """Numbers of each line that has any, and the line's number."""
    for number, line in text_lines(path):
        fields = line.split("#", 1)[0].replace(",", " ").split()
        if fields:
            yield number, floats_of(path, number, fields)
