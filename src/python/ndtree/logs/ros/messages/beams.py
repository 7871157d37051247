# SPDX-License-Identifier: BSD-3-Clause
"""What messages of sensors are turned into, and which types of messages there are."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndtree.logs.core.arrays import Bools, Floats, Points

LASER = "sensor_msgs/msg/LaserScan"
MULTI_ECHO_LASER = "sensor_msgs/msg/MultiEchoLaserScan"
RANGE = "sensor_msgs/msg/Range"
POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
PACKED_CLOUD = "point_cloud_interfaces/msg/CompressedPointCloud2"
OLD_CLOUD = "sensor_msgs/msg/PointCloud"
LIVOX = tuple(f"livox_{one}/msg/CustomMsg" for one in ("ros_driver", "ros_driver2", "interfaces"))
IMAGE = "sensor_msgs/msg/Image"
COMPRESSED_IMAGE = "sensor_msgs/msg/CompressedImage"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"

#: Say of each point where it is.
CLOUDS = (POINT_CLOUD, PACKED_CLOUD, OLD_CLOUD, *LIVOX)
#: Measure in one plane.
PLANAR = (LASER, MULTI_ECHO_LASER, RANGE)
IMAGES = (IMAGE, COMPRESSED_IMAGE)
#: No sensor takes longer for one scan [s]; what says so is in another unit, or wrong.
LONGEST_SWEEP = 1.0
#: The best first: of several sensors in a bag one of an earlier type is read.
SENSORS = (
    LASER, MULTI_ECHO_LASER, POINT_CLOUD, PACKED_CLOUD, *LIVOX, OLD_CLOUD, IMAGE, COMPRESSED_IMAGE, RANGE
)  # fmt: skip
SENSOR_NAMES = (
    "LaserScan, MultiEchoLaserScan, PointCloud2, CompressedPointCloud2, PointCloud, Livox CustomMsg, "
    "depth Image or Range"
)


#: What is wrong with messages that are mapped in spite of it, and what is done.
SENSELESS = "the times of beams make no sense, and all beams count as measured at the stamp"
UNLIMITED = "the largest range makes no sense, and counts as not given"
OTHER_NUMBER = "angles are for another number of ranges: angle_max does not count"
BEYOND = "most ranges are beyond the largest one, and are left out"
SWAPPED = "is_bigendian contradicts the data, which are read in the other order"


@dataclass(frozen=True)
class Beams:
    """What one message measured, in the sensor's frame.

    `points` (n, 3): End points [m], NaN where invalid.
    `returned` (n,) bool or None: Which met a surface; None: all.
    `times` (n,) float64 or None: When each was measured, from the message's stamp on [s]; None: all at the
        stamp.
    `is_guess`: The message does not say `times` but only how long the sweep may have taken: they count if the
        log bears them out.
    `odd`: What is wrong with the message though it is mapped, as one of the constants beside: what it says.
    `endless`: Beams that met nothing, but of which the message does not say up to where: they are invalid.
    """

    points: Points
    returned: Bools | None = None
    times: Floats | None = None
    endless: int = 0
    is_guess: bool = False
    zeros: int = 0  # Beams with a range of 0.
    colors: NDArray[np.uint8] | None = None  # (n, 3), red, green and blue.
    odd: dict[str, str] = field(default_factory=dict)


def stamp_of(message: Any) -> float:
    """When a message was measured [s]; 0 where it does not say, or at the beginning of a clock."""
    stamp = message.header.stamp
    return float(stamp.sec + 1e-9 * stamp.nanosec)


def short(type: str) -> str:
    """A type's own name."""
    return type.rpartition("/")[2]


def pitch_of(said: int, rows: int, width: int, size: int) -> int:
    """How many bytes after a row of `width` bytes the next begins, of all `size`.

    What the message has `said` counts, unless it leaves no room for a row or needs more bytes than there are,
    or the rows fill all bytes without space between them.
    """
    fits = said >= width and (rows - 1) * said + width <= size
    if size == rows * width or (size > rows * width and not fits):
        return width
    return said


#: Lengths that are not 0 are between these [m].
_SHORTEST, _LONGEST = 1e-6, 1e5
#: Of a message's numbers, fewer may be lengths where it is wrong, and more are in the other order.
_WRONG, _RIGHT = 0.5, 0.9
#: Values that are looked at; fewer pairs of pixels tell nothing.
LOOKED_AT, _FEWEST = 4096, 64
#: How many times rougher depths of the wrong order are from pixel to pixel.
_ROUGHER = 16.0


def is_swapped(values: NDArray[Any]) -> bool:
    """Whether numbers, as their message says they are to be read, make sense only in the other byte order.

    `values` (ndarray): Lengths as floats of any shape [m], or integers of a depth image (rows, columns); of a
        byte order.
    """
    other = values.view(values.dtype.newbyteorder())
    if values.dtype.kind == "f":
        with np.errstate(invalid="ignore"):
            some, swapped = (one.ravel()[: 3 * LOOKED_AT].astype(np.float64) for one in (values, other))
        return _sense(some) < _WRONG and _sense(swapped) > _RIGHT
    if values.dtype.itemsize < 2 or values.ndim != 2:
        return False
    rough = [_roughness(one[:: max(1, len(one) // 64)].astype(np.int64)) for one in (values, other)]
    return rough[0] > _ROUGHER * max(rough[1], 1.0)


def _sense(values: Floats) -> float:
    """Share of what may be lengths, of finite values but 0, which is the same in both orders."""
    known = values[np.isfinite(values) & (values != 0)]
    return float(np.mean((np.abs(known) > _SHORTEST) & (np.abs(known) < _LONGEST))) if len(known) else 1.0


def _roughness(rows: NDArray[np.int64]) -> float:
    """Median difference of pixels beside each other that have a depth; 0 where there are few."""
    pairs = (rows[:, 1:] > 0) & (rows[:, :-1] > 0)
    steps = np.abs(np.diff(rows, axis=1))[pairs]
    return float(np.median(steps)) if len(steps) >= _FEWEST else 0.0
