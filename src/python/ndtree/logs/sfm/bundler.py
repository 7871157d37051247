# SPDX-License-Identifier: BSD-3-Clause
"""Models of Bundler: bundle.out, version 0.3."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ndtree.logs.core.failures import at_place
from ndtree.logs.core.plain_file import open_plain, wrong_line
from ndtree.logs.core.source import Format, Source
from ndtree.logs.poses.pose import nearest_rotations, rotated
from ndtree.logs.sfm.triangulation import DEFAULT_PIXEL_SIGMA, Model, SfmLog, rows_of

MAGIC = b"# Bundle file v"
VERSION = b"0.3"


class BundlerLog(SfmLog):
    """One scan each camera that was registered: those that were not have a focal length of 0, and no scan.

    Distances are in the unit of the model, which is not a metre unless the model was scaled.
    """

    format = "bundler"

    def __init__(self, source: Source, pixel_sigma: float = DEFAULT_PIXEL_SIGMA) -> None:
        super().__init__(source, pixel_sigma)
        first = source.head[:80].split(b"\n", 1)[0].strip()
        if first != MAGIC + VERSION:
            raise wrong_line(source.path, 1, first, repr((MAGIC + VERSION).decode()))

    def _read(self) -> Model:
        lines = _Lines(self.path)
        cameras, points = lines.integers(2, "the numbers of cameras and points")
        lengths, rotations, translations = [], [], []
        row_of = np.full(cameras, -1, dtype=np.int32)
        for i in range(cameras):
            what = f"camera {i + 1} of {cameras}: "
            length = lines.numbers(3, what + "f k1 k2")[0]
            rotation = [lines.numbers(3, what + "a row of its rotation") for _ in range(3)]
            translation = lines.numbers(3, what + "its translation")
            if length == 0:
                continue
            if length < 0:
                raise ValueError(f"{self.path}: {what}a focal length of {length:g} px, expected one > 0")
            row_of[i] = len(lengths)
            lengths.append(length)
            rotations.append(rotation)
            translations.append(translation)
        centers = np.empty((len(lengths), 3))
        if lengths:
            with at_place(f"{self.path}: cameras"):
                turns = nearest_rotations(np.array(rotations))
            centers = -rotated(np.swapaxes(turns, 1, 2), np.array(translations))
        places = np.empty((points, 3))
        seeing: list[np.ndarray] = []
        counts = np.empty(points, dtype=np.int64)
        for i in range(points):
            what = f"point {i + 1} of {points}: "
            places[i] = lines.numbers(3, what + "its position")
            lines.numbers(3, what + "its colour")
            views = lines.views(what, cameras)
            counts[i] = len(views)
            rows = row_of[views]
            if rows.size and rows.min() < 0:
                lost = views[rows.argmin()]
                raise ValueError(f"{self.path}: line {lines.number}: {what}camera {lost} has no focal length")
            seeing.append(rows)
        every = np.concatenate([np.empty(0, dtype=np.int32), *seeing])
        seen = np.repeat(np.arange(points, dtype=np.int32), counts)
        return Model(places, centers, np.array(lengths), rows_of(len(lengths), every, seen))


class _Lines:
    """Lines of a bundle file, one after the other, and what must be in them."""

    def __init__(self, path: str) -> None:
        self.path = path
        self.number = 0
        self._lines = self._read()

    def _read(self) -> Iterator[list[bytes]]:
        with open_plain(self.path) as file:
            for self.number, line in enumerate(file, start=1):
                if not line.startswith(b"#") and line.strip():
                    yield line.split()

    def _next(self, what: str) -> list[bytes]:
        try:
            return next(self._lines)
        except StopIteration:
            raise ValueError(f"{self.path}: after line {self.number}: cut off, expected {what}") from None

    def _wrong(self, what: str) -> ValueError:
        return ValueError(f"{self.path}: line {self.number}: expected {what}")

    def numbers(self, count: int, what: str) -> list[float]:
        """Finite numbers that a line has alone."""
        fields = self._next(what)
        try:
            values = [float(field) for field in fields]
        except ValueError:
            values = []
        if len(values) != count or not np.isfinite(values).all():
            raise self._wrong(what)
        return values

    def integers(self, count: int, what: str) -> list[int]:
        """Numbers >= 0 that a line has alone."""
        fields = self._next(what)
        if len(fields) != count or not all(field.isdigit() for field in fields):
            raise self._wrong(what)
        return [int(field) for field in fields]

    def views(self, what: str, cameras: int) -> np.ndarray:
        """Cameras that see a point: their number, then camera, key and place in the image of each."""
        fields = self._next(what + "its views")
        try:
            views = np.array(fields[1::4], dtype=np.int64)
            complete = len(fields) == 1 + 4 * int(fields[0]) and len(views) == int(fields[0])
        except (ValueError, OverflowError):
            complete = False
        if not complete:
            raise self._wrong(what + "a number of views, and camera, key, x, y of each")
        if views.size and not (views.min() >= 0 and views.max() < cameras):
            raise self._wrong(f"{what}cameras of 0 to {cameras - 1} in its views")
        return views


_OPTIONS = ("pixel_sigma",)
BUNDLER = Format("bundler", "a Bundler model", lambda one: one.head.startswith(MAGIC), BundlerLog, _OPTIONS)
