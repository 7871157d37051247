# SPDX-License-Identifier: BSD-3-Clause
"""Problems of Bundle Adjustment in the Large: text, plain or packed by gzip or bzip2."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from ndtree.logs.core.arrays import Floats
from ndtree.logs.core.plain_file import PlainFile, open_plain, table_of
from ndtree.logs.core.source import Format, Source
from ndtree.logs.sfm.triangulation import Model, SfmLog, rows_of

LINES_AT_ONCE = 1 << 15
CAMERA_NUMBERS = 9  # Turn as axis times angle, translation, focal length, two of distortion.

Lines = Iterator[tuple[int, bytes]]


class BalLog(SfmLog):
    """One scan each camera.

    Distances are in the unit of the problem, which is rarely a metre.
    """

    format = "bal"

    def _read(self) -> Model:
        with open_plain(self.path) as file:
            return self._read_from(file)

    def _read_from(self, file: PlainFile) -> Model:
        lines = ((number, line) for number, line in enumerate(file, start=1) if line.strip())
        sizes = _header(next(lines, (1, b""))[1])
        if sizes is None:
            raise ValueError(f"{self.path}: line 1: expected the numbers of cameras, points and observations")
        cameras, points, _ = sizes
        seeing, seen = self._observations(lines, *sizes)
        parameters = self._numbers(lines, CAMERA_NUMBERS * cameras + 3 * points)
        camera = parameters[: CAMERA_NUMBERS * cameras].reshape(cameras, CAMERA_NUMBERS)
        wrong = np.flatnonzero(~(camera[:, 6] > 0))
        if wrong.size:
            said = f"camera {wrong[0]}: a focal length of {camera[wrong[0], 6]:g} px"
            raise ValueError(f"{self.path}: {said}, expected one > 0")
        centers = _turned(-camera[:, 3:6], -camera[:, :3])
        places = parameters[CAMERA_NUMBERS * cameras :].reshape(points, 3)
        return Model(places, centers, camera[:, 6], rows_of(cameras, seeing, seen))

    def _observations(
        self, lines: Lines, cameras: int, points: int, count: int
    ) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Cameras and points of this many observations."""
        parts = [np.empty((0, 2), dtype=np.int32)]
        done, last = 0, 1
        while done < count:
            block = list(islice(lines, min(LINES_AT_ONCE, count - done)))
            if not block:
                raise ValueError(f"{self.path}: after line {last}: cut off, expected more observations")
            table = table_of([line for _, line in block], 4)
            if table is None:
                wrong = next(number for number, line in block if table_of([line], 4) is None)
                raise ValueError(f"{self.path}: line {wrong}: expected camera, point, x, y")
            pairs = table[:, :2]
            bad = ~((pairs >= 0) & (pairs < (cameras, points)) & (pairs == np.floor(pairs))).all(axis=1)
            if bad.any():
                expected = f"a camera of 0 to {cameras - 1} and a point of 0 to {points - 1}"
                raise ValueError(f"{self.path}: line {block[bad.argmax()][0]}: expected {expected}")
            parts.append(pairs.astype(np.int32))
            done += len(block)
            last = block[-1][0]
        every = np.concatenate(parts)
        return every[:, 0], every[:, 1]

    def _numbers(self, lines: Lines, count: int) -> Floats:
        """All that is left in the file."""
        parts, found = [np.empty(0)], 0
        while block := list(islice(lines, LINES_AT_ONCE)):
            try:
                parts.append(np.array(b" ".join(line for _, line in block).split(), dtype=np.float64))
            except ValueError:
                first, last = block[0][0], block[-1][0]
                raise ValueError(f"{self.path}: lines {first} to {last}: expected only numbers") from None
            found += len(parts[-1])
            if found > count:
                break
        if found != count:
            more = "more" if found > count else str(found)
            raise ValueError(f"{self.path}: found {more} numbers of cameras and points, expected {count}")
        numbers = np.concatenate(parts)
        if not np.isfinite(numbers).all():
            which = int((~np.isfinite(numbers)).argmax())
            raise ValueError(f"{self.path}: number {which} of the cameras and points is not finite")
        return numbers


def _header(line: bytes) -> tuple[int, int, int] | None:
    fields = line.split()
    if len(fields) != 3 or not all(field.isdigit() for field in fields):
        return None
    cameras, points, observations = (int(field) for field in fields)
    return cameras, points, observations


def _turned(vectors: Floats, turns: Floats) -> Floats:
    """(n, 3) vectors, turned about axes by the angles that are their lengths [rad]."""
    angle = np.linalg.norm(turns, axis=1, keepdims=True)
    axis = np.divide(turns, angle, out=np.zeros_like(turns), where=angle > 0)
    along = np.sum(axis * vectors, axis=1, keepdims=True) * axis
    return along + np.cos(angle) * (vectors - along) + np.sin(angle) * np.cross(axis, vectors)


def _recognises(source: Source) -> bool:
    lines = source.head[:1000].split(b"\n")[:-1]
    first = [line for line in lines if line.strip()][:2]
    return len(first) == 2 and _header(first[0]) is not None and table_of(first[1:], 4) is not None


BAL = Format("bal", "a problem of Bundle Adjustment in the Large", _recognises, BalLog, ("pixel_sigma",))
