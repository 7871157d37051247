# SPDX-License-Identifier: BSD-3-Clause
"""CompressedPointCloud2 of point_cloud_transport, unpacked to what a PointCloud2 has."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndtree._lazy import needs
from ndtree.logs.ros.messages.head import Header, header_of, order_of

#: The most bytes that a packed one may stand for, and how many more are taken.
_MOST, _FREE = 1000, 1 << 20
#: What Draco calls places, in its list of kinds of attributes.
_POSITION = 0


@dataclass(frozen=True)
class Field:
    """As sensor_msgs/PointField."""

    name: str
    offset: int
    datatype: int


@dataclass(frozen=True)
class Cloud:
    """What is used of a PointCloud2."""

    header: Header
    height: int
    width: int
    fields: list[Field]
    is_bigendian: bool
    point_step: int
    row_step: int
    data: NDArray[np.uint8]


class _Reader:
    """Numbers and texts of a message, one after the other."""

    def __init__(self, data: bytes, at: int, is_ros1: bool) -> None:
        self._data, self._at, self._is_ros1 = data, at, is_ros1
        self._order = order_of(data, is_ros1)

    def number(self, code: str) -> int:
        size = struct.calcsize(code)
        if not self._is_ros1:  # Behind the 4 bytes that say how it is packed, at multiples of its size.
            self._at += -(self._at - 4) % size
        (value,) = struct.unpack_from(self._order + code, self._data, self._at)
        self._at += size
        return int(value)

    def bytes(self) -> bytes:
        size = self.number("I")
        part = self._data[self._at : self._at + size]
        if len(part) < size:
            raise struct.error(f"{len(part)} bytes of {size}")
        self._at += size
        return part

    def text(self) -> str:
        return self.bytes().rstrip(b"\0").decode("utf-8", "replace")


def decoded(data: bytes, *, is_ros1: bool) -> Cloud:
    """The message in some bytes, unpacked; ValueError if they are too few, or packed in another way."""
    header, at = header_of(data, is_ros1)
    read = _Reader(data, at, is_ros1)
    try:
        height, width = read.number("I"), read.number("I")
        fields = []
        for _ in range(read.number("I")):
            fields.append(Field(read.text(), read.number("I"), read.number("B")))
            read.number("I")
        is_bigendian = bool(read.number("B"))
        point_step, row_step = read.number("I"), read.number("I")
        packed = read.bytes()
        read.number("B")
        form = read.text()
    except struct.error:
        raise ValueError(f"the cloud has {len(data)} bytes, expected a whole CompressedPointCloud2") from None
    if form == "draco":
        return _of_draco(header, packed)
    if form not in _UNPACKERS:
        raise ValueError(f"the cloud is packed as {form!r}, expected draco, {' or '.join(_UNPACKERS)}")
    size = height * row_step
    found = _UNPACKERS[form](packed, size + 1) if size <= _FREE + _MOST * len(packed) else b""
    if len(found) != size:
        raise ValueError(f"the cloud is packed in {len(packed)} bytes, expected {size} when unpacked")
    values = np.frombuffer(found, np.uint8)
    return Cloud(header, height, width, fields, is_bigendian, point_step, row_step, values)


def _with_zlib(data: bytes, most: int) -> bytes:
    try:
        return zlib.decompressobj(zlib.MAX_WBITS | 32).decompress(data, most)
    except zlib.error as error:
        raise ValueError(f"the cloud cannot be unpacked ({error}), expected zlib") from None


def _with_zstd(data: bytes, most: int) -> bytes:
    with needs("clouds packed by zstd need zstandard", "ros"):
        import zstandard
    try:
        with zstandard.ZstdDecompressor().stream_reader(data) as stream:
            return bytes(stream.read(most))
    except zstandard.ZstdError as error:
        raise ValueError(f"the cloud cannot be unpacked ({error}), expected zstd") from None


_UNPACKERS: dict[str, Callable[[bytes, int], bytes]] = {"zlib": _with_zlib, "zstd": _with_zstd}


def _of_draco(header: Header, packed: bytes) -> Cloud:
    """Places alone: Draco keeps no layout, and neither times nor colours of points are needed."""
    try:
        import DracoPy
    except ImportError as error:
        how = "install it with:\n  pip install 'DracoPy'"
        raise ImportError(f"clouds packed by Draco need DracoPy ({error}); {how}") from None
    try:
        attributes: Any = DracoPy.decode(packed).attributes
    except Exception as error:  # A library at the mercy of foreign bytes: it raises whatever it runs into.
        raise ValueError(f"the cloud cannot be unpacked ({error}), expected Draco") from None
    places = [one["data"] for one in attributes if one["attribute_type"] == _POSITION]
    if len(places) != 1 or places[0].ndim != 2 or places[0].shape[1] != 3:
        raise ValueError("the cloud is packed by Draco without one place for each point, expected x, y and z")
    points = np.ascontiguousarray(places[0], dtype="<f4")
    fields = [Field(name, 4 * axis, 7) for axis, name in enumerate("xyz")]
    return Cloud(header, 1, len(points), fields, False, 12, 12 * len(points), points.view(np.uint8).ravel())
