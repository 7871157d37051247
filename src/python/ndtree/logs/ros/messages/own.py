# SPDX-License-Identifier: BSD-3-Clause
"""Messages that are decoded here, of ROS 1 and ROS 2: of Livox's driver, of lasers with several echoes, whose
echoes are objects to others, the cloud before PointCloud2, and the packed ones of point_cloud_transport.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndtree._lazy import needs
from ndtree.logs.core.silence import without_padding
from ndtree.logs.ros.messages.beams import (
    LIVOX,
    LONGEST_SWEEP,
    MULTI_ECHO_LASER,
    OLD_CLOUD,
    PACKED_CLOUD,
    SENSELESS,
    Beams,
)
from ndtree.logs.ros.messages.foxglove import Message, header_of, order_of
from ndtree.logs.ros.storage import Damaged, unpacked

#: Point of a CustomMsg: time since the message's [ns], place [m], and what is not used here. In ROS 2 numbers
#: of 4 bytes begin at multiples of 4, and so does each point.
_POINT: list[Any] = [("offset_time", "u4"), ("xyz", "f4", 3), ("others", "u1", 3)]
_PADDED = [*_POINT, ("padding", "u1")]
#: Numbers of a MultiEchoLaserScan before its echoes.
_NUMBERS = "angle_min angle_max angle_increment time_increment scan_time range_min range_max".split()
#: What Draco calls places, in its list of kinds of attributes.
_POSITION = 0


class _Reader:
    """What is in a message behind its `header`, one after the other; ValueError where there is too little."""

    def __init__(self, data: bytes, is_ros1: bool, type: str) -> None:
        self._data, self._is_ros1, self._type = data, is_ros1, type
        self._order = order_of(data, is_ros1)
        self.header, self._at = header_of(data, is_ros1)

    def _taken(self, size: int, multiple: int, missing: int = 0) -> int:
        """Where the next bytes begin: in ROS 2 at a multiple, behind the 4 that say how it is packed."""
        at = self._at + (0 if self._is_ros1 else -(self._at - 4) % multiple)
        if at + size > len(self._data) + missing:
            raise ValueError(f"the message has {len(self._data)} bytes, expected a whole {self._type}")
        self._at = at + size
        return at

    def number(self, code: str = "I") -> int:
        """One integer, by its letter in the module struct."""
        at = self._taken(struct.calcsize(code), struct.calcsize(code))
        return int(struct.unpack_from(self._order + code, self._data, at)[0])

    def rows(self, kind: Any, count: int, missing: int = 0) -> NDArray[Any]:
        """Numbers of 4 bytes, or rows of such; of the last, some bytes may be missing."""
        dtype = np.dtype(kind).newbyteorder(self._order)
        at = self._taken(count * dtype.itemsize, 4, missing)
        return np.frombuffer(self._data[at:] + bytes(missing), dtype, count)

    def left(self) -> NDArray[Any]:
        """All that follows, as integers of 4 bytes."""
        at = self._taken(0, 4)
        return np.frombuffer(self._data, self._order + "u4", (len(self._data) - at) // 4, at)

    def bytes(self) -> bytes:
        """Bytes behind their number."""
        size = self.number()
        at = self._taken(size, 1)
        return self._data[at : at + size]

    def text(self) -> str:
        """Text behind its length."""
        return self.bytes().rstrip(b"\0").decode("utf-8", "replace")


def livox(data: bytes, *, is_ros1: bool) -> Any:
    """The CustomMsg in some bytes: `points`, and `offset_times` since the message's [ns]."""
    read = _Reader(data, is_ros1, "CustomMsg")
    for code in "QIBBBB":
        read.number(code)
    count = read.number()
    table = read.rows(_POINT if is_ros1 else _PADDED, count, 0 if is_ros1 or not count else 1)
    times = table["offset_time"].astype(np.uint32)
    return Message(header=read.header, points=table["xyz"].astype(np.float32), offset_times=times)


def old_cloud(data: bytes, *, is_ros1: bool) -> Any:
    """The PointCloud in some bytes, without its channels."""
    read = _Reader(data, is_ros1, "PointCloud")
    points = read.rows("f4", 3 * read.number()).reshape(-1, 3).astype(np.float32)
    return Message(header=read.header, points=points, offset_times=None)


def point_beams(message: Any) -> Beams:
    """Points of a cloud, each with its own time if it has one; NaN is invalid, and so is padding."""
    points = without_padding(message.points)
    if message.offset_times is None:
        return Beams(points)
    times = 1e-9 * message.offset_times.astype(np.float64)
    measured = np.isfinite(points).all(axis=1)
    times[~measured] = times[measured].min(initial=np.inf) if measured.any() else 0.0
    lasts = float(np.ptp(times)) if len(times) else 0.0
    if lasts > LONGEST_SWEEP:
        return Beams(points, odd={SENSELESS: f"offset_time over {lasts:.3g} s"})
    return Beams(points, times=times)


def multi_echo(data: bytes, *, is_ros1: bool) -> Any:
    """The MultiEchoLaserScan in some bytes: the `echoes` of all `beams`, and whose each is."""
    read = _Reader(data, is_ros1, "MultiEchoLaserScan")
    numbers = dict(zip(_NUMBERS, read.rows("f4", len(_NUMBERS)).tolist()))
    count, words = read.number(), read.left()
    begins, sizes = _lists(words, count)
    of_beams = np.repeat(np.arange(count), sizes)
    place = np.arange(len(of_beams)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    echoes = words.view(words.dtype.str.replace("u", "f"))[begins[of_beams] + place].astype(np.float32)
    return Message(header=read.header, beams=count, echoes=echoes, numbers=of_beams, **numbers)


def _lists(words: NDArray[np.uint32], count: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Where `count` lists that follow each other begin, and their sizes; each has its size before it."""
    if count > len(words):
        raise ValueError(f"the scan has {len(words)} numbers, expected {count} lists of echoes")
    every, begins, at = words.tolist(), [], 0
    for number in range(count):
        begins.append(at + 1)
        at += 1 + every[at]
        if at > len(every) or (at == len(every) and number < count - 1):
            raise ValueError(f"the scan ends in the echoes of beam {number}, expected {count} beams")
    begin = np.array(begins, dtype=np.intp)
    return begin, np.diff(np.append(begin, at + 1)) - 1


def packed_cloud(data: bytes, *, is_ros1: bool) -> Any:
    """The CompressedPointCloud2 in some bytes, unpacked to what a PointCloud2 has."""
    read = _Reader(data, is_ros1, "CompressedPointCloud2")
    height, width = read.number(), read.number()
    fields = []
    for _ in range(read.number()):
        fields.append(Message(name=read.text(), offset=read.number(), datatype=read.number("B")))
        read.number()  # How many it has.
    is_bigendian = bool(read.number("B"))
    point_step, row_step = read.number(), read.number()
    packed = read.bytes()
    read.number("B")  # Whether all are finite.
    form = read.text()
    if form == "draco":
        points = _of_draco(packed)
        fields = [Message(name=name, offset=4 * axis, datatype=7) for axis, name in enumerate("xyz")]
        values, height, width, is_bigendian = points.view(np.uint8).ravel(), 1, len(points), False
        point_step, row_step = 12, 12 * width
    elif form in ("zlib", "zstd"):
        try:
            with needs("clouds packed by zstd need zstandard", "ros"):
                values = np.frombuffer(unpacked(form, packed, height * row_step), np.uint8)
        except Damaged as error:
            raise ValueError(f"the cloud cannot be unpacked ({error}), expected {form}") from None
    else:
        raise ValueError(f"the cloud is packed as {form!r}, expected draco, zlib or zstd")
    layout = {"is_bigendian": is_bigendian, "point_step": point_step, "row_step": row_step}
    return Message(header=read.header, height=height, width=width, fields=fields, data=values, **layout)


def _of_draco(packed: bytes) -> NDArray[np.float32]:
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
    return np.ascontiguousarray(places[0], dtype="<f4")


DECODERS: dict[str, Callable[..., Any]] = {
    **dict.fromkeys(LIVOX, livox),
    MULTI_ECHO_LASER: multi_echo,
    OLD_CLOUD: old_cloud,
    PACKED_CLOUD: packed_cloud,
}
