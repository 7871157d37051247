# SPDX-License-Identifier: BSD-3-Clause
"""Lists of poses as matrices or as vertices of a graph: g2o, Open3D's logs, 4x4 or 3x4 a line."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from ndtree.logs.core.plain_file import are_numbers, floats_of, text_lines, with_points
from ndtree.logs.poses.pose import ROTATION_TOLERANCE, matrices_of

Floats = NDArray[np.float64]

#: Vertices of g2o with a pose, and how many numbers follow their id.
_VERTICES = {"VERTEX_SE3:QUAT": 7, "VERTEX_SE2": 3}
_OF_G2O = re.compile(r"(?:VERTEX|EDGE|FIX|PARAMS)(?:_|$)")
#: Numbers of a line: of a matrix, and of one behind a time.
_MATRIX_SIZES, _TIMED_SIZES = (12, 16), (13, 17)
_ENTRY = re.compile(r"(?:t|m|r)?_?\[?([0-3])[_,]?([0-3])\]?")
_LAST_ROW = (0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True)
class PoseList:
    """Poses of a file: of each a number or a time [s], and its matrix."""

    stamps: Floats
    matrices: Floats  # (n, 3, 4)
    is_numbered: bool


def kind_of_list(path: str) -> str | None:
    """ "g2o", "log", "matrices" or "timed matrices"; None for another file. Reads its first lines."""
    try:
        rows = list(islice(_rows(path), 8))
    except ValueError:
        return None
    if not rows:
        return None
    first = rows[0][1]
    if _OF_G2O.match(first[0]):
        return "g2o"
    counts = [len(fields) for _, fields in rows]
    if not all(are_numbers(fields) for _, fields in rows):
        behind = [fields for _, fields in rows[1:]]
        named = _entries(first) is not None and behind and all(map(are_numbers, behind))
        return "timed matrices" if named and len({*counts}) == 1 else None
    if counts[:5] == [3, 4, 4, 4, 4] and all(re.fullmatch(r"-?\d+", field) for field in first):
        return "log"
    if len(set(counts)) == 1 and counts[0] in (*_MATRIX_SIZES, *_TIMED_SIZES):
        timed = counts[0] in _TIMED_SIZES
        if counts[0] == 12 or _is_matrix([float(field) for field in first[timed:]]):
            return "timed matrices" if timed else "matrices"
    if (
        len(rows) == 8
        and set(counts) == {4}
        and all(list(map(float, rows[i][1])) == list(_LAST_ROW) for i in (3, 7))
    ):
        return "matrices"
    return None


def read_list(path: str, kind: str) -> PoseList:
    """Poses of a file of a kind that `kind_of_list` has told.

    Raises ValueError if a line is not as it should be: which, what was found, and what was expected.
    """
    if kind == "g2o":
        return _of_g2o(path)
    if kind == "log":
        return _of_log(path)
    return _of_matrices(path, timed=kind == "timed matrices")


def _of_g2o(path: str) -> PoseList:
    found: dict[int, Floats] = {}
    for number, fields in _rows(path):
        count = _VERTICES.get(fields[0])
        if count is None:
            continue
        values = floats_of(path, number, fields[1:])
        if len(values) != count + 1 or values[0] != int(values[0]):
            raise ValueError(
                f"{path}: line {number}: found {len(values)} numbers, "
                f"expected the id of a {fields[0]} and {count} more"
            )
        matrix = np.eye(3, 4)
        if count == 3:
            x, y, turn = values[1:]
            matrix[:2, :2] = [[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]]
            matrix[:2, 3] = x, y
        else:
            turned = np.array(values[4:])
            length = float(np.linalg.norm(turned))
            if not abs(length - 1) < 0.02:
                raise ValueError(f"{path}: line {number}: a quaternion of length {length:.3g}, expected 1")
            matrix[:, :3] = matrices_of(turned[None] / length)[0]
            matrix[:, 3] = values[1:4]
        found[int(values[0])] = matrix
    if not found:
        raise ValueError(f"{path}: no vertex with a pose, expected {' or '.join(_VERTICES)}")
    ids = sorted(found)
    return PoseList(np.array(ids, dtype=np.float64), np.stack([found[id] for id in ids]), True)


def _of_log(path: str) -> PoseList:
    """Three whole numbers, of which the first is that of the frame, and the four rows of camera to world."""
    numbers, matrices = [], []
    rows = list(_rows(path))
    for at in range(0, len(rows), 5):
        block = rows[at : at + 5]
        if [len(fields) for _, fields in block] != [3, 4, 4, 4, 4]:
            raise ValueError(
                f"{path}: line {block[-1][0]}: "
                "expected 3 whole numbers and the 4 rows of a matrix for each pose"
            )
        numbers.append(floats_of(path, *block[0])[0])
        matrices.append([floats_of(path, *row) for row in block[1:4]])
    order = np.argsort(numbers, kind="stable")
    rising = len(set(numbers)) == len(numbers)  # Else all may have the same, and count by their order.
    stamps = np.array(numbers)[order] if rising else np.arange(len(numbers), dtype=np.float64)
    return PoseList(stamps, np.array(matrices)[order] if rising else np.array(matrices), True)


def _of_matrices(path: str, *, timed: bool) -> PoseList:
    stamps: list[float] = []
    values: list[float] = []
    entries: dict[tuple[int, int], int] | None = None
    time = 0
    size = 0
    for number, fields in _rows(path):
        if not size and not are_numbers(fields):
            entries = _entries(fields)
            names = [field.lower() for field in fields]
            time = next((i for i, name in enumerate(names) if "time" in name or "stamp" in name), -1)
            continue
        row = floats_of(path, number, fields)
        size = size or len(row)
        if len(row) != size:
            raise ValueError(f"{path}: line {number}: found {len(row)} numbers, expected {size} as before")
        if entries is not None:
            values += [row[entries[i, j]] for i in range(3) for j in range(4)]
            stamps += [row[time]] if time >= 0 else []
            continue
        begin = 1 if timed else 0
        values += row[begin : begin + 12] if size > 4 else row
        stamps += row[:1] if timed else []
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
        return PoseList(np.array(stamps), matrices, False)
    return PoseList(np.arange(len(matrices), dtype=np.float64), matrices, True)


def _entries(names: list[str]) -> dict[tuple[int, int], int] | None:
    """Columns of a matrix whose entries a header names, as T00 to T23."""
    found = {}
    for at, name in enumerate(names):
        entry = _ENTRY.fullmatch(name.strip().lower())
        if entry:
            found[int(entry[1]), int(entry[2])] = at
    return found if all((i, j) in found for i in range(3) for j in range(4)) else None


def _rows(path: str) -> Iterator[tuple[int, list[str]]]:
    """Fields of each line that has any."""
    for number, line in text_lines(path):
        content = with_points(line.split("#", 1)[0])
        fields = content.replace(",", " ").replace(";", " ").split()
        if fields:
            yield number, fields


def _is_matrix(values: list[float]) -> bool:
    """Whether the numbers are those of a pose's matrix, 3x4 or 4x4."""
    matrix = np.array(values).reshape(-1, 4)
    turned = matrix[:3, :3]
    is_rotation = (
        np.isfinite(matrix).all() and np.abs(turned @ turned.T - np.eye(3)).max() < ROTATION_TOLERANCE
    )
    return bool(is_rotation and (len(matrix) == 3 or np.abs(matrix[3] - _LAST_ROW).max() < 1e-6))
