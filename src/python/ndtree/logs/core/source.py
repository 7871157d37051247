# SPDX-License-Identifier: BSD-3-Clause
"""What a format is, what it is recognised from, and what is said of points without poses."""

from __future__ import annotations

import codecs
import os
import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ndtree._errors import WrongValue, key
from ndtree.base.options import option
from ndtree.base.scan import Scan
from ndtree.logs.core.arrays import Floats, Points
from ndtree.logs.core.failures import NotALog, WrongOption
from ndtree.logs.core.log import Log
from ndtree.logs.core.plain_file import open_plain

__all__ = ["Format", "Source", "WrongOption", "source_of"]

HEAD_BYTES = 1 << 18


@dataclass(frozen=True)
class Source:
    """A file or a folder that somebody wants to read.

    `head`: The first 256 KiB of a file, unpacked by gzip, without a byte order mark, cut at the end of a line
        where there is more; empty for a folder.
    """

    path: str  # Its name as it was given.
    head: bytes
    names: tuple[str, ...] = ()  # Names of a folder's entries, sorted; empty for a file.
    is_folder: bool = False
    packed: str = ""  # By what a file is packed, "gzip" or "bzip2"; "" for others.

    def inside(self, *parts: str) -> str:
        """Path of something in the folder."""
        return os.path.join(self.path, *parts)


def require_one(path: str, given: Sequence[str]) -> None:
    """Refuse several of options that exclude each other; raises WrongOption."""
    if len(given) > 1:
        raise WrongOption(f"{path}: {' and '.join(map(key, given))}: expected one of them")


@dataclass(frozen=True)
class Format:
    """One row of the table of formats: how to recognise it, and how to open it.

    `recognises`: Whether a `Source` is of this format. It may raise ValueError where the source is certainly
        of this format, and damaged.
    `stored_as` ({"file", "folder", "either"}): Nothing else is handed to ``recognises`` and ``open``.
    `contents`: ``contents(source, whole)`` says as a dictionary what else is in it, also where it cannot be
        opened as a log; unless `whole`, at once and from what an index or the beginning says.
    `dim` ({2, 3} or None): Of all logs of the format. None: of each its own, and ``open`` takes ``dim``,
        None, 2 or 3.
    """

    name: str  # The word for ``format=``.
    description: str  # With its article, for messages: "a CARMEN log".
    recognises: Callable[[Source], bool]
    open: Callable[..., Log]  # ``open(source, **options)`` makes the `Log`.
    options: tuple[str, ...] = ()  # Names of what ``open`` takes, in the table of options.
    stored_as: str = "file"
    contents: Callable[[Source, bool], dict[str, Any]] | None = None
    dim: int | None = 3

    def may_be(self, source: Source) -> bool:
        """Whether it is stored as the source is: as a file or as a folder."""
        return self.stored_as in ("either", "folder" if source.is_folder else "file")

    def log(self, source: Source, dim: int | None, options: dict[str, Any]) -> Log:
        """The log of a source; ValueError for wrong options, or where it has another dimension than `dim`."""
        for name, value in options.items():
            option(name).require(value)
        if self.dim is None:
            return self.open(source, dim=dim, **options)
        if dim not in (None, self.dim):
            expected = f"expected {key('dim')}={self.dim}"
            raise WrongValue(f"{source.path}: {self.description} is {self.dim}-D, {expected}")
        return self.open(source, **options)


def source_of(path: str, expected: str) -> Source:
    """Look at a file or a folder.

    Raises OSError if there is no such file, or it cannot be read; ValueError if it is empty, or gzip cannot
    unpack its beginning; `expected` says what it should have been.
    """
    if os.path.isdir(path):
        return Source(path, b"", tuple(sorted(os.listdir(path))), is_folder=True)
    head, packed = _head(path, expected)
    return Source(path, head, packed=packed)


def _head(path: str, expected: str) -> tuple[bytes, str]:
    """The first bytes, unpacked, cut at the end of a line if there is more; and by what they were packed."""
    with open_plain(path) as file:
        packed = file.packed
        head, damage = file.beginning(HEAD_BYTES)
    if len(head) == HEAD_BYTES or damage:
        whole = head[: head.rfind(b"\n") + 1]
        head = whole if damage else whole or head
    head = head.removeprefix(codecs.BOM_UTF8)
    if damage and not (damage.is_cut_off and head):  # What there is may still tell the format.
        what = "cut off" if damage.is_cut_off else "damaged"
        raise ValueError(f"{path}: the {damage.kind} stream is {what}, expected {expected}")
    if not head.strip():
        raise ValueError(f"{path}: the file is empty, expected {expected}")
    return head, packed


@dataclass(frozen=True)
class Unplaced:
    """What a user said of points without poses.

    `origin` (3,) float64 or None: Where all were measured from [m], in the frame of the points.
    """

    origin: Floats | None = None
    points_only: bool = False  # There was no sensor. If not, and without an origin, poses have to be found.

    def __bool__(self) -> bool:
        """Whether anything was said, so that no poses are looked for."""
        return self.points_only or self.origin is not None

    @staticmethod
    def of(
        path: str, origin_of_scan: str | Sequence[float] | None, points_only: bool | None, **others: Any
    ) -> Unplaced:
        """From the options of a reader; `others` that are given say the poses in another way.

        Raises WrongOption if more than one way is given; ValueError if the origin is no point.
        """
        ways = {"origin_of_scan": origin_of_scan, "points_only": points_only or None, **others}
        require_one(path, [name for name, value in ways.items() if value is not None])
        if origin_of_scan is None:
            return Unplaced(None, bool(points_only))
        return Unplaced(point_of(origin_of_scan), False)

    def scan(self, points: Points, stamp: float = 0.0) -> Scan:
        """Points in the map frame (n, 3), as a scan."""
        if self.points_only:
            return Scan(points, points, stamp=stamp, points_only=True)
        assert self.origin is not None
        return Scan(points, self.origin, stamp=stamp)


def point_of(value: str | Sequence[float]) -> Floats:
    """The place that `origin_of_scan` names [m]. @raises WrongValue"""
    try:
        fields = value.split(",") if isinstance(value, str) else list(value)
        point = np.array([float(field) for field in fields])
    except (TypeError, ValueError):
        point = np.zeros(0)
    if point.shape != (3,) or not np.isfinite(point).all():
        raise WrongValue(f"{key('origin_of_scan')} = {value!r}: expected three numbers X,Y,Z [m]")
    return point


def without_sensor(path: str, what: str, more: Sequence[str] = ()) -> NotALog:
    """The error of points without any pose; `what` they are, as in "a LAS of points without a pose"."""
    alone = f"ndtree map {shlex.quote(path)} --points-only (occupied cells alone)"
    ways = [alone, "--origin-of-scan X,Y,Z (all measured from one place)", *more]
    return NotALog(path, what, ways, has_points=True)
