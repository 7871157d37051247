# SPDX-License-Identifier: BSD-3-Clause
"""The Header at the beginning of messages, from their bytes."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from ndtree.logs.poses.transforms import plain
from ndtree.logs.ros.messages import foxglove, protobuf
from ndtree.logs.ros.storage import Raw


@dataclass(frozen=True)
class Time:
    """As in ROS."""

    sec: int
    nanosec: int


@dataclass(frozen=True)
class Header:
    """As in ROS."""

    stamp: Time
    frame_id: str


def order_of(data: bytes, is_ros1: bool) -> str:
    """The order of a message's bytes, "<" or ">"."""
    return "<" if is_ros1 or (len(data) > 1 and data[1] & 1) else ">"


def header_of(data: bytes, is_ros1: bool) -> tuple[Header, int]:
    """The Header that some bytes begin with, and where it ends.

    In ROS 1 a Header begins with a number of 4 bytes, in ROS 2 a message begins with 4 bytes that say how it
    is packed: all that follows stands in the same place.

    Raises ValueError if they are too few.
    """
    if len(data) < 16:
        raise ValueError(f"the message has {len(data)} bytes, expected a whole Header")
    seconds, nanoseconds, length = struct.unpack_from(order_of(data, is_ros1) + "3I", data, 4)
    if 16 + length > len(data):
        raise ValueError(f"the message has {len(data)} bytes, expected a frame of {length} in it")
    frame = data[16 : 16 + length].rstrip(b"\0").decode("utf-8", "replace")
    return Header(Time(seconds, nanoseconds), frame), 16 + length


def head_of(raw: Raw) -> tuple[float, str] | None:
    """Stamp [s] and frame of a message, from its first bytes; None where it is too short to have one.

    The stamp is 0 where the message does not say when it was measured, or at the beginning of a clock.
    """
    if raw.connection.encoding == "json":
        head = foxglove.head_of(raw.data)
        return None if head is None else (head[0], plain(head[1]))
    if raw.connection.encoding == "protobuf":
        try:
            head = foxglove.head_in(protobuf.fields_of(raw.data, raw.connection.name, raw.connection.schema))
        except ValueError:
            return None
        return None if head is None else (head[0], plain(head[1]))
    try:
        header, _ = header_of(raw.data, raw.connection.encoding == "ros1")
    except ValueError:
        return None
    return header.stamp.sec + 1e-9 * header.stamp.nanosec, plain(header.frame_id)
