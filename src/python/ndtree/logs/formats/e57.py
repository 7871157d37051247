# SPDX-License-Identifier: BSD-3-Clause
"""E57, the exchange format of terrestrial laser scanners: each scan with its points and its pose."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from ndtree._lazy import needs
from ndtree.base.scan import Scan
from ndtree.base.words import number_of
from ndtree.logs.core.arrays import Points
from ndtree.logs.core.failures import readable
from ndtree.logs.core.log import SizedLog
from ndtree.logs.core.plain_file import open_regular
from ndtree.logs.core.source import Format, Source, Unplaced, without_sensor
from ndtree.logs.poses.pose import Pose

MAGIC = b"ASTM-E57"
_CARTESIAN = ("cartesianX", "cartesianY", "cartesianZ")
_SPHERICAL = ("sphericalRange", "sphericalAzimuth", "sphericalElevation")
_GRID = {"rowIndex", "columnIndex"}
#: Bytes of memory that a point takes while it is read; a file does not hold more points than bits.
_BITS = 8
#: Length of the file's header, and of a page with the checksum at its end.
_HEADER = 48


class E57Log(SizedLog):
    """The scans of an E57, one in memory at a time; points that it marks as invalid are not measured.

    A scan's points are in its scanner's frame, and its pose says where that is. Scans without a pose
    have been put together from others: nothing says where their sensor was. Nor does a pose that changes
    nothing in all scans, as programs write it where they have none, unless the points are in rows and
    columns, as scanners measure them.

    `NotALog` is raised if a scan has no pose, and nothing was said of such.
    """

    format = "e57"
    knows_no_returns = False
    path: str

    def __init__(
        self, source: Source, origin_of_scan: str | Sequence[float] | None = None, points_only: bool = False
    ) -> None:
        path = source.path
        super().__init__(path, dim=3)
        self._unplaced = unplaced = Unplaced.of(path, origin_of_scan, points_only)
        self.has_sensor = not unplaced.points_only
        with _opened(path) as file:
            self._count = int(file.scan_count)
            with readable(path, "cannot be read as E57", foreign=True):
                headers = [file.get_header(i) for i in range(self._count)]
                says = any(not _pose(one).is_identity or _GRID.issubset(one.point_fields) for one in headers)
                without = [one for one in headers if not (says and one.has_pose())]
        if not self._count:
            raise ValueError(f"{path}: no scans, expected at least one (it may hold images alone)")
        if without and not unplaced:
            what = "an E57 of points without a pose"
            if self._count > 1:
                what = f"an E57 of {number_of(self._count, 'scan')}, of which {len(without)} have no pose"
            raise without_sensor(path, what)

    def __len__(self) -> int:
        return self._count

    def _scans(self) -> Iterator[Scan]:
        with _opened(self.path) as file:
            for i in range(self._count):
                try:
                    with readable(self.path, f"scan {i} cannot be read", foreign=True):
                        scan = self._scan(file, i)
                except ValueError as error:
                    self.skip("damaged scans", error)
                    continue
                yield scan

    def _scan(self, file: Any, i: int) -> Scan:
        header = file.get_header(i)
        points = _points(self.path, file, header)
        pose = _pose(header)
        if not np.isfinite(pose.position).all():
            raise ValueError(f"{self.path}: scan {i}: its position is not finite")
        stamp = _stamp(header)
        if self._unplaced:
            return self._unplaced.scan(pose.apply(points), stamp)
        return Scan(pose.apply(points), pose.position, stamp=stamp)


@contextmanager
def _opened(path: str) -> Iterator[Any]:
    """The library's file. It does not close what it cannot open whole."""
    with needs(f"{path}: an E57, which needs pye57", "e57"):
        import pye57
    with open_regular(path) as file:  # A FIFO would wait for a writer.
        size = os.fstat(file.fileno()).st_size
        header = file.read(_HEADER)
    if len(header) < _HEADER or int.from_bytes(header[16:24], "little") != size:
        said = int.from_bytes(header[16:24], "little")
        raise ValueError(f"{path}: {size} bytes of an E57, expected {said} as its header says")
    with readable(path, "cannot be read as E57", foreign=True):
        opened = pye57.E57(path)
    try:
        yield opened
    finally:
        opened.close()


def _points(path: str, file: Any, header: Any) -> Points:
    """(n, 3) points of a scan that were measured, in the frame that its pose is of."""
    count = int(header.point_count)
    most = _BITS * os.path.getsize(path)
    if count > most:
        raise ValueError(f"{path}: {count} points in a scan, expected at most {most} in a file of this size")
    known = set(header.point_fields)
    names = next((names for names in (_CARTESIAN, _SPHERICAL) if known.issuperset(names)), None)
    if names is None:
        raise ValueError(f"{path}: points of {', '.join(sorted(known))}, expected {' '.join(_CARTESIAN)}")
    invalid = "cartesianInvalidState" if names is _CARTESIAN else "sphericalInvalidState"
    wanted = [*names, *([invalid] if invalid in known else [])]
    if not count:
        return np.zeros((0, 3))
    data, buffers = file.make_buffers(wanted, count)
    read = int(header.points.reader(buffers).read())
    columns = [np.asarray(data[name][:read], dtype=np.float64) for name in names]
    if names is _SPHERICAL:
        distance, azimuth, elevation = columns
        level = distance * np.cos(elevation)
        columns = [level * np.cos(azimuth), level * np.sin(azimuth), distance * np.sin(elevation)]
    points = np.stack(columns, axis=1)
    return points[np.asarray(data[invalid][:read]) == 0] if invalid in known else points


def _pose(header: Any) -> Pose:
    """T_map_scanner; the identity where there is none."""
    if not header.has_pose():
        return Pose.identity()
    w, x, y, z = (float(value) for value in header.rotation)
    return Pose.from_quaternion(header.translation, (x, y, z, w))


def _stamp(header: Any) -> float:
    """When a scan began, in GPS seconds; 0 where it does not say."""
    try:
        return float(header.acquisitionStart_dateTimeValue)
    except Exception:  # The library raises its own kind where there is none.
        return 0.0


_OPTIONS = ("origin_of_scan", "points_only")
E57 = Format("e57", "an E57 of laser scans", lambda one: one.head.startswith(MAGIC), E57Log, _OPTIONS)
