# SPDX-License-Identifier: BSD-3-Clause
"""PTX, as Leica's and other programs export registered scans: each with a grid of points and its pose."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice

import numpy as np

from ndtree.base.scan import Scan
from ndtree.logs.core.arrays import Floats
from ndtree.logs.core.failures import at_place
from ndtree.logs.core.log import LineLog
from ndtree.logs.core.plain_file import PlainFile, open_plain, table_of, wrong_line
from ndtree.logs.core.source import Format, Source
from ndtree.logs.poses.pose import Pose

#: Lines before the points of a scan: columns, rows, position, three axes, and a matrix of four rows.
_HEADER = (1, 1, 3, 3, 3, 3, 4, 4, 4, 4)
#: Numbers of a point: x y z intensity, and colours or not.
_POINT = (4, 7)
_BLOCK = 1 << 16
#: No scanner has more columns or rows.
_MOST = 10**7


class PtxLog(LineLog):
    """The scans of a PTX, one of which is in memory at a time; points at 0 0 0 were not measured.

    The matrix moves the points to the map, and the scanner is where it moves 0 0 0. Where it changes nothing,
    the points are in the map's frame already, and the scanner is at the position that the header names.
    """

    format = "ptx"
    may_be_cut_off = False
    knows_no_returns = False  # Points at 0 0 0 do not say where their beams went.

    def __init__(self, source: Source) -> None:
        super().__init__(source.path, dim=3)

    def _scans(self) -> Iterator[Scan]:
        with open_plain(self.path) as file:
            lines = iter(file)
            number = 0
            while (header := _header(file, lines)) is not None:
                count, pose, moves = header
                try:
                    points = self._points(file, count)
                except ValueError as error:
                    self.skip("damaged scans", ValueError(f"{error} (scan {number})"))
                    return
                self._place = file.place
                number += 1
                yield Scan(pose.apply(points), pose.position) if moves else Scan(points, pose.position)

    def _points(self, file: PlainFile, count: int) -> Floats:
        parts = [np.empty((0, 3))]
        left, width = count, 0
        while left:
            begin = file.line + 1
            block = list(islice(file, min(left, _BLOCK)))
            if not block:
                raise ValueError(f"{self.path}: ends after {count - left} points, expected {count}")
            width = width or len(block[0].split())
            if width not in _POINT:
                raise wrong_line(self.path, begin, block[0], "x y z intensity of a point, with r g b or not")
            table = table_of(block, width)
            if table is None:
                at = next((i for i, line in enumerate(block) if table_of([line], width) is None), 0)
                raise wrong_line(self.path, begin + at, block[at], f"{width} numbers of a point")
            xyz = table[:, :3]
            parts.append(xyz[(xyz != 0).any(axis=1)])
            left -= file.line + 1 - begin
        return np.concatenate(parts)


def _header(file: PlainFile, lines: Iterator[bytes]) -> tuple[int, Pose, bool] | None:
    """Number of points and pose of the next scan, and whether it moves them; None at the end of the file."""
    rows: list[list[float]] = []
    for expected in _HEADER:
        line = next((line for line in lines if line.strip()), None)
        if line is None:
            if not rows:
                return None
            raise ValueError(f"{file.path}: ends within the header of a scan, expected {len(_HEADER)} lines")
        table = table_of([line], expected)
        if table is None:
            raise wrong_line(file.path, file.line, line, f"{expected} numbers of the header of a scan")
        rows.append(table[0].tolist())
    columns, count = rows[0][0], rows[1][0]
    for name, value in (("columns", columns), ("rows", count)):
        if not 0 <= value <= _MOST or value != int(value):
            raise ValueError(f"{file.path}: line {file.line}: {value:g} {name}, expected a whole number")
    matrix = np.array(rows[6:])
    if not np.isfinite(matrix).all() or not np.isfinite(rows[2]).all():
        raise ValueError(f"{file.path}: line {file.line}: the pose of a scan is not finite")
    if np.abs(matrix[:, 3] - (0, 0, 0, 1)).max() > 1e-6:
        said = f"the last column of the matrix is {matrix[:, 3].tolist()}"
        raise ValueError(f"{file.path}: line {file.line}: {said}, expected 0 0 0 1")
    moves = not np.array_equal(matrix, np.eye(4))
    with at_place(f"{file.path}: line {file.line}"):
        pose = Pose.from_matrix(matrix.T)
    if not moves:
        pose = Pose(np.eye(3), np.array(rows[2]))
    return int(columns) * int(count), pose, moves


def _recognises(source: Source) -> bool:
    if b"\0" in source.head:
        return False
    lines = [line.split() for line in source.head.splitlines()[:14] if line.strip()]
    if tuple(len(fields) for fields in lines[:10]) != _HEADER or not all(f[0].isdigit() for f in lines[:2]):
        return False
    return len(lines) < 11 or len(lines[10]) in _POINT


PTX = Format("ptx", "a PTX of registered scans", _recognises, PtxLog)
