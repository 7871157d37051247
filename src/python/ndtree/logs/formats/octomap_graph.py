# SPDX-License-Identifier: BSD-3-Clause
"""Scan graphs of OctoMap: binary files of point clouds, each with the pose of its sensor."""

from __future__ import annotations

import struct
from collections.abc import Iterator

import numpy as np

from ndtree.base.scan import Scan
from ndtree.logs.core.arrays import Floats
from ndtree.logs.core.failures import at_place
from ndtree.logs.core.log import SizedLog
from ndtree.logs.core.plain_file import DamagedStream, PlainFile, open_plain
from ndtree.logs.core.source import Format, Source
from ndtree.logs.poses.pose import Pose

#: Vectors and quaternions begin with the number of their coordinates.
_POINT = np.dtype([("size", "<u4"), ("xyz", "<f8", 3)])
_POSE = struct.Struct("<I3dI4dI")  # Position, quaternion w x y z, number of the node.
_POINTS_AT_ONCE = 1 << 16
_IS = "a scan graph of OctoMap"


class OctomapGraphLog(SizedLog):
    """The nodes of a graph, in the order of the file, each a scan; its edges say nothing of scans.

    A file is the number of nodes, and of each node: the number of its points, the points in the sensor's
    frame, the sensor's pose in the map, and the node's number; numbers are little endian.
    """

    format = "octomap_graph"
    may_be_cut_off = True
    path: str

    def __init__(self, source: Source) -> None:
        if not _recognises(source):
            raise ValueError(f"{source.path}: expected {_IS}, nodes with points of 3 numbers")
        super().__init__(source.path, dim=3)
        (self._nodes,) = struct.unpack_from("<I", source.head)

    def __len__(self) -> int:
        return self._nodes

    def _scans(self) -> Iterator[Scan]:
        done = 0
        try:
            with open_plain(self.path) as file:
                file.read(4)
                for done in range(self._nodes):
                    yield self._node(file, f"{self.path}: node {done + 1} of {self._nodes}")
        except DamagedStream as error:
            where = f"{self.path}: node {done + 1} of {self._nodes}"
            self.skip(f"damaged {error.kind} streams", ValueError(f"{where}: {error}, expected a whole one"))
        except ValueError as error:  # It is unknown where the next node begins.
            self.skip("damaged files", error)

    def _node(self, file: PlainFile, where: str) -> Scan:
        (count,) = struct.unpack("<I", _taken(file, 4, where))
        points = self._points(file, count, where)
        size, x, y, z, size_of_turn, qw, qx, qy, qz, _ = _POSE.unpack(_taken(file, _POSE.size, where))
        if (size, size_of_turn) != (3, 4) or not np.isfinite((x, y, z)).all():
            raise ValueError(f"{where}: expected a position of 3 numbers and a quaternion of 4 behind points")
        with at_place(where):
            pose = Pose.from_quaternion((x, y, z), (qx, qy, qz, qw))
        return Scan(pose.apply(points), pose.position, rotation=pose.rotation)

    def _points(self, file: PlainFile, count: int, where: str) -> Floats:
        parts = [np.empty((0, 3))]
        while count:
            some = min(count, _POINTS_AT_ONCE)
            table = np.frombuffer(_taken(file, some * _POINT.itemsize, where), dtype=_POINT)
            if not (table["size"] == 3).all():
                raise ValueError(f"{where}: found a point of {table['size'].max()} numbers, expected 3")
            parts.append(table["xyz"])
            count -= some
        return np.concatenate(parts)


def _taken(file: PlainFile, size: int, where: str) -> bytes:
    content = file.read(size)
    if len(content) != size:
        raise ValueError(f"{where}: the file is cut off, expected {size - len(content)} bytes more")
    return content


def _recognises(source: Source) -> bool:
    """Whether the first node's vectors, or those of its pose, have the sizes that they should."""
    head = source.head
    if len(head) < 8:
        return False
    nodes, points = struct.unpack_from("<II", head)
    sizes = [3] * min(points, 2) + [3, 4]  # Where a vector ends, the next begins.
    starts = [8 + 28 * i for i in range(len(sizes))]
    if points > 2:
        sizes, starts = sizes[:2], starts[:2]
    found = [int.from_bytes(head[start : start + 4], "little") for start in starts]
    return nodes > 0 and len(head) >= starts[-1] + 4 and found == sizes


OCTOMAP_GRAPH = Format("octomap_graph", _IS, _recognises, OctomapGraphLog)
