# SPDX-License-Identifier: BSD-3-Clause
"""Messages that are decoded here, of ROS 1 and ROS 2: of Livox's driver, of lasers with several echoes, whose
echoes are objects to others, and sensor_msgs/PointCloud, the cloud before PointCloud2.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndtree.logs.core.silence import without_padding
from ndtree.logs.ros.messages import packed_cloud
from ndtree.logs.ros.messages.beams import (
    LIVOX,
    LONGEST_SWEEP,
    MULTI_ECHO_LASER,
    OLD_CLOUD,
    PACKED_CLOUD,
    Beams,
)
from ndtree.logs.ros.messages.head import Header, header_of, order_of

#: Point of a CustomMsg: time since the message's [ns], place [m], and what is not used here. In ROS 2 numbers
#: of 4 bytes begin at multiples of 4, and so does each point.
_POINT = [("offset_time", "u4"), ("xyz", "f4", 3), ("others", "u1", 3)]
_PADDED = [*_POINT, ("padding", "u1")]
#: Numbers of a MultiEchoLaserScan before its echoes.
_NUMBERS = 7


@dataclass(frozen=True)
class Points:
    """What is used of a cloud."""

    header: Header
    points: NDArray[np.float32]
    offset_times: NDArray[np.uint32] | None = None  # Since the message's [ns].


@dataclass(frozen=True)
class MultiEchoLaserScan:
    """What is used of the message: the echoes of all beams, and the number of each one's beam."""

    header: Header
    angle_min: float
    angle_max: float
    angle_increment: float
    time_increment: float
    scan_time: float
    range_min: float
    range_max: float
    beams: int
    echoes: NDArray[np.float32]
    numbers: NDArray[np.intp]


def _after(at: int, multiple: int) -> int:
    """The next multiple from a byte on, counted behind the 4 that say how a message of ROS 2 is packed."""
    return 4 + -(-(at - 4) // multiple) * multiple


def _count_at(data: bytes, order: str, at: int, type: str) -> int:
    if at + 4 > len(data):
        raise ValueError(f"the cloud has {len(data)} bytes, expected a whole {type}")
    return int(struct.unpack_from(order + "I", data, at)[0])


def _require(data: bytes, needed: int, count: int) -> None:
    if len(data) < needed:
        raise ValueError(f"the cloud has {len(data)} bytes, expected {needed} for {count} points")


def livox(data: bytes, *, is_ros1: bool) -> Points:
    """The CustomMsg in some bytes; ValueError if they are too few."""
    order, (header, at) = order_of(data, is_ros1), header_of(data, is_ros1)
    at = (at if is_ros1 else _after(at, 8)) + 8 + 4 + 1 + 3
    count = _count_at(data, order, at, "CustomMsg")
    kind = np.dtype(_POINT if is_ros1 else _PADDED)
    _require(data, at + 4 + count * kind.itemsize - (0 if is_ros1 or not count else 1), count)
    table = np.frombuffer((data + b"\0")[at + 4 :], kind.newbyteorder(order), count)
    return Points(header, table["xyz"].astype(np.float32), table["offset_time"].astype(np.uint32))


def old_cloud(data: bytes, *, is_ros1: bool) -> Points:
    """The PointCloud in some bytes, without its channels; ValueError if they are too few."""
    order, (header, at) = order_of(data, is_ros1), header_of(data, is_ros1)
    at = at if is_ros1 else _after(at, 4)
    count = _count_at(data, order, at, "PointCloud")
    _require(data, at + 4 + 12 * count, count)
    points = np.frombuffer(data, order + "f4", 3 * count, at + 4).reshape(-1, 3)
    return Points(header, points.astype(np.float32))


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
        return Beams(points, senseless=f"offset_time over {lasts:.3g} s")
    return Beams(points, times=times)


def multi_echo(data: bytes, *, is_ros1: bool) -> MultiEchoLaserScan:
    """The message in some bytes; ValueError if they are too few."""
    order, (header, at) = order_of(data, is_ros1), header_of(data, is_ros1)
    at = at if is_ros1 else _after(at, 4)
    words = np.frombuffer(data, order + "u4", (len(data) - at) // 4, at) if at < len(data) else np.zeros(0)
    if len(words) <= _NUMBERS:
        raise ValueError(f"the scan has {len(data)} bytes, expected a whole MultiEchoLaserScan")
    numbers = struct.unpack_from(f"{order}{_NUMBERS}f", data, at)
    count = int(words[_NUMBERS])
    begins, sizes = _lists(words, _NUMBERS + 1, count)
    numbers_of_beams = np.repeat(np.arange(count), sizes)
    place = np.arange(len(numbers_of_beams)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    echoes = words.view(order + "f4")[begins[numbers_of_beams] + place].astype(np.float32)
    return MultiEchoLaserScan(header, *numbers, count, echoes, numbers_of_beams)


def _lists(words: NDArray[np.uint32], at: int, count: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Where `count` lists that follow each other begin, and their sizes; each has its size before it."""
    if count > len(words) - at:
        raise ValueError(f"the scan has {len(words) - at} numbers, expected {count} lists of echoes")
    every = words.tolist()
    begins = []
    for number in range(count):
        begins.append(at + 1)
        at += 1 + every[at]
        if at > len(every) or (at == len(every) and number < count - 1):
            raise ValueError(f"the scan ends in the echoes of beam {number}, expected {count} beams")
    begin = np.array(begins, dtype=np.intp)
    return begin, np.diff(np.append(begin, at + 1)) - 1


DECODERS: dict[str, Callable[..., Any]] = {
    **dict.fromkeys(LIVOX, livox),
    MULTI_ECHO_LASER: multi_echo,
    OLD_CLOUD: old_cloud,
    PACKED_CLOUD: packed_cloud.decoded,
}
