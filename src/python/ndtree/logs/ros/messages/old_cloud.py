# SPDX-License-Identifier: BSD-3-Clause
"""sensor_msgs/PointCloud, the cloud before PointCloud2: three floats a point; its channels are not read."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndtree.logs.core.silence import without_padding
from ndtree.logs.ros.messages.beams import OLD_CLOUD, Beams
from ndtree.logs.ros.messages.head import Header, header_of, order_of

TYPES = (OLD_CLOUD,)


@dataclass(frozen=True)
class PointCloud:
    """What is used of the message."""

    header: Header
    points: NDArray[np.float32]


def decoded(data: bytes, *, is_ros1: bool) -> PointCloud:
    """The message in some bytes; ValueError if they are too few."""
    order = order_of(data, is_ros1)
    header, at = header_of(data, is_ros1)
    if not is_ros1:  # Numbers of 4 bytes begin at multiples of 4.
        at = (at + 3) // 4 * 4
    if at + 4 > len(data):
        raise ValueError(f"the cloud has {len(data)} bytes, expected a whole PointCloud")
    (count,) = struct.unpack_from(order + "I", data, at)
    needed = at + 4 + 12 * count
    if len(data) < needed:
        raise ValueError(f"the cloud has {len(data)} bytes, expected {needed} for {count} points")
    points = np.frombuffer(data, order + "f4", 3 * count, at + 4).reshape(-1, 3)
    return PointCloud(header, points.astype(np.float32))


def beams(message: Any) -> Beams:
    """Points of a PointCloud; NaN is invalid, and so is padding."""
    return Beams(without_padding(message.points))
