# SPDX-License-Identifier: BSD-3-Clause
"""Clouds of Livox lidars in the message of their own driver, of ROS 1 and ROS 2."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndtree.logs.core.silence import without_padding
from ndtree.logs.ros.messages.beams import LIVOX, LONGEST_SWEEP, Beams
from ndtree.logs.ros.messages.head import Header, header_of, order_of

TYPES = LIVOX

#: Point of a CustomMsg: time since the message's [ns], place [m], and what is not used here.
_POINT = [("offset_time", "u4"), ("xyz", "f4", 3), ("others", "u1", 3)]
#: In ROS 2 numbers of 4 bytes begin at multiples of 4, and so does each point.
_PADDED = [*_POINT, ("padding", "u1")]


@dataclass(frozen=True)
class CustomMsg:
    """What is used of the message."""

    header: Header
    offset_times: NDArray[np.uint32]
    points: NDArray[np.float32]


def decoded(data: bytes, *, is_ros1: bool) -> CustomMsg:
    """The message in some bytes; ValueError if they are too few."""
    order = order_of(data, is_ros1)
    header, at = header_of(data, is_ros1)
    if is_ros1:
        at += 8 + 4 + 1 + 3
    else:  # Behind the 4 bytes that say how it is packed, to a multiple of 8, and of 4.
        at = 4 + (at - 4 + 7) // 8 * 8 + 8 + 4 + 1 + 3
    if at + 4 > len(data):
        raise ValueError(f"the cloud has {len(data)} bytes, expected a whole CustomMsg")
    (count,) = struct.unpack_from(order + "I", data, at)
    kind = np.dtype(_POINT if is_ros1 else _PADDED)
    needed = at + 4 + count * kind.itemsize - (0 if is_ros1 or not count else 1)
    if len(data) < needed:
        raise ValueError(f"the cloud has {len(data)} bytes, expected {needed} for {count} points")
    table = np.frombuffer((data + b"\0")[at + 4 :], kind.newbyteorder(order), count)
    return CustomMsg(header, table["offset_time"].astype(np.uint32), table["xyz"].astype(np.float32))


def beams(message: Any) -> Beams:
    """Points of a CustomMsg, each with its own time; those in the sensor's origin are no measurement."""
    points = without_padding(message.points)
    times = 1e-9 * message.offset_times.astype(np.float64)
    measured = np.isfinite(points).all(axis=1)
    times[~measured] = times[measured].min(initial=np.inf) if measured.any() else 0.0
    lasts = float(np.ptp(times)) if len(times) else 0.0
    if lasts > LONGEST_SWEEP:
        return Beams(points, senseless=f"offset_time over {lasts:.3g} s")
    return Beams(points, times=times)
