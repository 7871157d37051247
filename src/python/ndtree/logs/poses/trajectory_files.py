# SPDX-License-Identifier: BSD-3-Clause
"""Files of poses and of times, as of TUM, KITTI, EuRoC, g2o and Open3D."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator
from itertools import islice
from typing import NamedTuple

import numpy as np

from ndtree.logs.core.arrays import Floats
from ndtree.logs.core.failures import at_place
from ndtree.logs.core.plain_file import are_numbers, floats_of, text_lines, with_points
from ndtree.logs.poses.pose import ROTATION_TOLERANCE, Pose
from ndtree.logs.poses.pose_columns import TUM, PoseColumns, columns_named, order_in_doubt, seconds_of
from ndtree.logs.poses.trajectory import Trajectory

EXPECTED = "expected 8 numbers a line (t x y z qx qy qz qw), or 12 or 16 (3x4, or 4x4 ending in 0 0 0 1)"
#: Vertices of g2o with a pose, and how many numbers follow their id.
_VERTICES = {"VERTEX_SE3:QUAT": 7, "VERTEX_SE2": 3}
_OF_G2O = re.compile(r"(?:VERTEX|EDGE|FIX|PARAMS)(?:_|$)")
#: Numbers of a line: of a matrix, and of one behind a time.
_MATRIX_SIZES, _TIMED_SIZES = (12, 16), (13, 17)
_ENTRY = re.compile(r"(?:t|m|r)?_?\[?([0-3])[_,]?([0-3])\]?")
_LAST_ROW = (0.0, 0.0, 0.0, 1.0)


class _Poses(NamedTuple):
    """Poses of a file: of each a number or a time, and its matrix (n, 3, 4)."""

    stamps: Floats
    matrices: Floats
    is_numbered: bool


def read_trajectory(path: str | os.PathLike[str]) -> Trajectory:
    """Read a trajectory file; blank lines and comments behind # are passed over.

    Formats are TUM's and KITTI's; tables whose first line names the columns, as EuRoC's; matrices of 4x4
    numbers, a line or four lines each; a time and a matrix a line; vertices of g2o; Open3D's trajectory.log.

    A first line that names a time, x y z and qx qy qz qw, as a comment or not, says the order of the columns:
    ``#timestamp [ns], p_x, p_y, p_z, q_w, q_x, q_y, q_z``, or ``sec,nsec,x,y,z,qx,qy,qz,qw``. Columns of
    other names are passed over. Stamps are in the unit that it names; without one, stamps since 1970 in ms,
    us and ns are told from their size.

    8 numbers a line are a time [s], a position [m] and a quaternion (x, y, z, w), in this order unless a
    header says otherwise; 12 are the upper three rows of a pose's matrix. Where there is no time, it is the
    pose's number, from 0, or as a graph or log numbers it.

    Raises OSError if a file cannot be read; ValueError if a line is not as it should be: which, what was
    found, and what was expected.
    """
    name = os.fspath(path)
    kind = _kind_of_list(name)
    readers = {"g2o": _of_g2o, "log": _of_log, "matrices": _of_matrices, "timed matrices": _of_matrices}
    if kind is None:
        return _of_columns(name)
    stamps, matrices, is_numbered = readers[kind](name)
    stamps = stamps if is_numbered else seconds_of(stamps, None, name)
    return Trajectory(stamps, matrices[:, :, 3], matrices[:, :, :3], name=name, is_numbered=is_numbered)


def _of_columns(name: str) -> Trajectory:
    """Of a file with a time, a position and a quaternion a line."""
    found = list(_lines(name))
    if not found:
        raise ValueError(f"{name}: no poses, {EXPECTED}")
    named, columns = found[0][0], len(found[0][2])
    for _, number, values in found:
        if named is not None and len(values) != named.count:
            expected = f"expected {named.count} as the header names columns"
        elif named is None and columns not in (8, 12):
            expected = EXPECTED
        elif named is None and len(values) != columns:
            expected = f"expected {columns} as in the line before"
        else:
            continue
        raise ValueError(f"{name}: line {number}: found {len(values)} numbers, {expected}")
    table = np.array([values for _, _, values in found])
    layout = named or TUM
    stamps = seconds_of(table[:, layout.time], layout.unit, name)
    if layout.part is not None:
        stamps = stamps + table[:, layout.part] / 1e9
    rising = np.concatenate([[True], stamps[1:] != stamps[:-1]])  # A pose said twice is one.
    poses = table[rising][:, list(layout.pose)]
    return Trajectory(stamps[rising], poses[:, :3], poses[:, 3:], name=name)


def read_pose(path: str | os.PathLike[str]) -> Pose:
    """The pose in a file of its own: a matrix of 3x4 or 4x4 numbers, however broken into lines."""
    name = os.fspath(path)
    values = [value for number, fields in _rows(name) for value in floats_of(name, number, fields)]
    if len(values) not in (12, 16):
        raise ValueError(f"{name}: found {len(values)} numbers, expected a matrix of 3x4 or 4x4")
    matrix = np.array(values).reshape(-1, 4)
    if not np.isfinite(matrix).all():
        raise ValueError(f"{name}: the pose is not finite")
    if len(matrix) == 4 and not np.allclose(matrix[3], _LAST_ROW, atol=1e-9):
        raise ValueError(f"{name}: the last row is {matrix[3].tolist()}, expected 0 0 0 1")
    with at_place(name):
        return Pose.from_matrix(matrix)


def trajectory_kind(path: str | os.PathLike[str]) -> str | None:
    """What the first lines look like: "tum", "kitti" for poses by their number, or None for neither."""
    kind = _kind_of_list(os.fspath(path))
    if kind is not None:
        return "tum" if kind.startswith("timed") else "kitti"
    try:
        named, _, values = next(_lines(os.fspath(path)), (None, 0, []))
    except ValueError:
        return None
    if named is not None:
        return "tum" if len(values) == named.count else None
    return {8: "tum", 12: "kitti"}.get(len(values))


def read_times(path: str | os.PathLike[str]) -> Floats:
    """Times of a file that has one number a line [s]; those since 1970 may be in ms, us or ns."""
    name = os.fspath(path)
    stamps = []
    for number, fields in _rows(name):
        values = floats_of(name, number, fields)
        if len(values) != 1:
            raise ValueError(f"{name}: line {number}: found {len(values)} numbers, expected one, a time [s]")
        stamps += values
    return seconds_of(np.array(stamps, dtype=np.float64), None, name)


def _lines(path: str) -> Iterator[tuple[PoseColumns | None, int, list[float]]]:
    """What a header before the first line with numbers names, and each such line's number and numbers."""
    named, behind_header = None, False
    for number, line in text_lines(path):
        if "\0" in line:
            raise ValueError(f"{path}: line {number}: binary data, expected poses in text")
        content, fields = _content(line)
        if not behind_header and not are_numbers(fields):
            found = columns_named(line)
            if found is not None:
                named = found
                continue
            doubt = order_in_doubt(line) if named is None else None
            if doubt:
                expected = "one time, x y z and qx qy qz qw, as in '# t,x,y,z,qw,qx,qy,qz'"
                raise ValueError(f"{path}: line {number}: the header names {doubt}, expected {expected}")
        if fields:
            behind_header = True
            values = _named_values(path, number, content, named) if named else floats_of(path, number, fields)
            yield named, number, values


def _named_values(path: str, number: int, line: str, named: PoseColumns) -> list[float]:
    """Values of a line below a header; nan for words in columns that are no part of a pose."""
    fields = re.split(r"\s*[,;]\s*", line.strip().rstrip(",;")) if re.search("[,;]", line) else line.split()
    wanted = (named.time, named.part, *named.pose)
    return [
        floats_of(path, number, [field])[0] if i in wanted or are_numbers([field]) else math.nan
        for i, field in enumerate(fields)
    ]


def _content(line: str) -> tuple[str, list[str]]:
    """A line without its comment, and its fields."""
    content = with_points(line.split("#", 1)[0])
    return content, content.replace(",", " ").replace(";", " ").split()


def _rows(path: str) -> Iterator[tuple[int, list[str]]]:
    for number, line in text_lines(path):
        fields = _content(line)[1]
        if fields:
            yield number, fields


# --- Poses as matrices, or as vertices of a graph ---------------------------------------------------


def _kind_of_list(path: str) -> str | None:
    """ "g2o", "log", "matrices" or "timed matrices"; None for another file. Reads its first lines."""
    try:
        rows = [fields for _, fields in islice(_rows(path), 8)]
    except ValueError:
        return None
    if not rows:
        return None
    first, counts = rows[0], [len(fields) for fields in rows]
    if _OF_G2O.match(first[0]):
        return "g2o"
    if not all(map(are_numbers, rows)):
        named = _entries(first) is not None and len(rows) > 1 and all(map(are_numbers, rows[1:]))
        return "timed matrices" if named and len({*counts}) == 1 else None
    if counts[:5] == [3, 4, 4, 4, 4] and all(re.fullmatch(r"-?\d+", field) for field in first):
        return "log"
    if len(set(counts)) == 1 and counts[0] in (*_MATRIX_SIZES, *_TIMED_SIZES):
        timed = counts[0] in _TIMED_SIZES
        if counts[0] == 12 or _is_matrix([float(field) for field in first[timed:]]):
            return "timed matrices" if timed else "matrices"
    if counts == [4] * 8 and all(tuple(map(float, rows[i])) == _LAST_ROW for i in (3, 7)):
        return "matrices"
    return None


def _of_g2o(path: str) -> _Poses:
    found: dict[int, Floats] = {}
    for number, fields in _rows(path):
        count = _VERTICES.get(fields[0])
        if count is None:
            continue
        values = floats_of(path, number, fields[1:])
        if len(values) != count + 1 or values[0] != int(values[0]):
            expected = f"expected the id of a {fields[0]} and {count} more"
            raise ValueError(f"{path}: line {number}: found {len(values)} numbers, {expected}")
        with at_place(f"{path}: line {number}"):
            of_plane = count == 3
            pose = Pose.planar(*values[1:]) if of_plane else Pose.from_quaternion(values[1:4], values[4:])
        found[int(values[0])] = np.column_stack([pose.rotation, pose.position])
    if not found:
        raise ValueError(f"{path}: no vertex with a pose, expected {' or '.join(_VERTICES)}")
    ids = sorted(found)
    return _Poses(np.array(ids, dtype=np.float64), np.stack([found[id] for id in ids]), True)


def _of_log(path: str) -> _Poses:
    """Three whole numbers, the frame's first, and the four rows of camera to world."""
    numbers, matrices = [], []
    rows = list(_rows(path))
    for at in range(0, len(rows), 5):
        block = rows[at : at + 5]
        if [len(fields) for _, fields in block] != [3, 4, 4, 4, 4]:
            expected = "expected 3 whole numbers and the 4 rows of a matrix for each pose"
            raise ValueError(f"{path}: line {block[-1][0]}: {expected}")
        numbers.append(floats_of(path, *block[0])[0])
        matrices.append([floats_of(path, *row) for row in block[1:4]])
    if len(set(numbers)) < len(numbers):  # All may have the same, and count by their order.
        return _Poses(np.arange(len(numbers), dtype=np.float64), np.array(matrices), True)
    order = np.argsort(numbers, kind="stable")
    return _Poses(np.array(numbers)[order], np.array(matrices)[order], True)


def _of_matrices(path: str) -> _Poses:
    """A matrix a line, behind a time or not or as a header names the columns; or four lines each."""
    stamps: list[float] = []
    values: list[float] = []
    entries: dict[tuple[int, int], int] | None = None
    time = -1
    size = 0
    for number, fields in _rows(path):
        if not size and not are_numbers(fields):
            entries = _entries(fields)
            names = [field.lower() for field in fields]
            time = next((i for i, name in enumerate(names) if "time" in name or "stamp" in name), -1)
            continue
        row = floats_of(path, number, fields)
        if not size:
            size = len(row)
            time = 0 if entries is None and size in _TIMED_SIZES else time
        if len(row) != size:
            raise ValueError(f"{path}: line {number}: found {len(row)} numbers, expected {size} as before")
        if entries is not None:
            values += [row[entries[i, j]] for i in range(3) for j in range(4)]
        else:
            values += row[time + 1 : time + 13] if size > 4 else row
        stamps += [row[time]] if time >= 0 else []
    table = np.array(values)
    if size == 4:  # Four lines a pose.
        if len(table) % 16:
            raise ValueError(f"{path}: {len(table) // 4} rows of matrices, expected 4 for each pose")
        table = table.reshape(-1, 16)
        wrong = np.flatnonzero(np.abs(table[:, 12:] - _LAST_ROW).max(axis=1) > 1e-9)
        if wrong.size:
            raise ValueError(f"{path}: pose {wrong[0]}: the last row is not 0 0 0 1")
        table = table[:, :12]
    matrices = table.reshape(-1, 3, 4)
    if len(stamps) == len(matrices):
        return _Poses(np.array(stamps), matrices, False)
    return _Poses(np.arange(len(matrices), dtype=np.float64), matrices, True)


def _entries(names: list[str]) -> dict[tuple[int, int], int] | None:
    """Columns of a matrix whose entries a header names, as T00 to T23."""
    found = {}
    for at, name in enumerate(names):
        entry = _ENTRY.fullmatch(name.strip().lower())
        if entry:
            found[int(entry[1]), int(entry[2])] = at
    return found if all((i, j) in found for i in range(3) for j in range(4)) else None


def _is_matrix(values: list[float]) -> bool:
    """Whether the numbers are those of a pose's matrix, 3x4 or 4x4."""
    matrix = np.array(values).reshape(-1, 4)
    turned = matrix[:3, :3]
    apart = np.abs(turned @ turned.T - np.eye(3)).max()
    is_rotation = np.isfinite(matrix).all() and apart < ROTATION_TOLERANCE
    return bool(is_rotation and (len(matrix) == 3 or np.abs(matrix[3] - _LAST_ROW).max() < 1e-6))
