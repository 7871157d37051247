# SPDX-License-Identifier: BSD-3-Clause
"""What messages of sensors are turned into, and which types of messages there are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

LASER = "sensor_msgs/msg/LaserScan"
MULTI_ECHO_LASER = "sensor_msgs/msg/MultiEchoLaserScan"
RANGE = "sensor_msgs/msg/Range"
POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
OLD_CLOUD = "sensor_msgs/msg/PointCloud"
LIVOX = (
    "livox_ros_driver/msg/CustomMsg",
    "livox_ros_driver2/msg/CustomMsg",
    "livox_interfaces/msg/CustomMsg",
)
IMAGE = "sensor_msgs/msg/Image"
COMPRESSED_IMAGE = "sensor_msgs/msg/CompressedImage"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"

#: Say of each point where it is.
CLOUDS = (POINT_CLOUD, OLD_CLOUD, *LIVOX)
#: Measure in one plane.
PLANAR = (LASER, MULTI_ECHO_LASER, RANGE)
IMAGES = (IMAGE, COMPRESSED_IMAGE)
#: No sensor takes longer for one scan [s]; what says so is in another unit, or wrong.
LONGEST_SWEEP = 1.0
#: The best first: of several sensors in a bag one of an earlier type is read.
SENSORS = (LASER, MULTI_ECHO_LASER, POINT_CLOUD, *LIVOX, OLD_CLOUD, IMAGE, COMPRESSED_IMAGE, RANGE)
SENSOR_NAMES = "LaserScan, MultiEchoLaserScan, PointCloud2, PointCloud, Livox CustomMsg, depth Image or Range"


@dataclass(frozen=True)
class Beams:
    """What one message measured, in the sensor's frame.

    `points` (n, 3): End points [m], NaN where invalid.
    `returned` (n,) bool or None: Which met a surface; None: all.
    `times` (n,) float64 or None: When each was measured, from the message's stamp on [s]; None: all at the
        stamp.
    `is_guess`: The message does not say `times` but only how long the sweep may have taken: they count if the
        log bears them out.
    `senseless`: What is wrong with the message's times of its beams, where they can be none: `times` is None
        then.
    `unlimited`: What is wrong with the message's largest range, where it can be none: it counts as not given.
    `zeros`: Beams with a range of 0.
    `endless`: Beams that met nothing, but of which the message does not say up to where: they are invalid.
    `swapped`: The message's bytes are in the other order than it says.
    """

    points: NDArray[np.floating[Any]]
    returned: NDArray[np.bool_] | None = None
    times: Floats | None = None
    endless: int = 0
    is_guess: bool = False
    senseless: str = ""
    unlimited: str = ""
    zeros: int = 0
    swapped: bool = False


def stamp_of(message: Any) -> float:
    """When a message was measured [s]; 0 where it does not say, or at the beginning of a clock."""
    stamp = message.header.stamp
    return float(stamp.sec + 1e-9 * stamp.nanosec)


def short(type: str) -> str:
    """A type's own name."""
    return type.rpartition("/")[2]


def pitch_of(said: int, rows: int, width: int, size: int) -> int:
    """How many bytes after a row the next begins.

    What the message says counts, unless it leaves no room for a row or needs more bytes than there are, or
    the rows fill all bytes without space between them.

    `said`: By the message.
    `width`: Bytes of a row.
    `size`: Bytes that there are.
    """
    fits = said >= width and (rows - 1) * said + width <= size
    if size == rows * width or (size > rows * width and not fits):
        return width
    return said
