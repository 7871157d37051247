# SPDX-License-Identifier: BSD-3-Clause
"""Sensor messages of ROS to beams in the sensor's own frame. Nothing here needs ROS or a library for bags."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndtree.readers.depth_image import Camera, points_of

Floats = NDArray[np.float64]

LASER = "sensor_msgs/msg/LaserScan"
MULTI_ECHO_LASER = "sensor_msgs/msg/MultiEchoLaserScan"
POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
IMAGE = "sensor_msgs/msg/Image"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
PLANAR = (LASER, MULTI_ECHO_LASER)

#: Images that hold depths: type of a pixel, and its values in a metre.
DEPTH_ENCODINGS = {"16UC1": ("u2", 1000.0), "mono16": ("u2", 1000.0), "32FC1": ("f4", 1.0)}

_FIELD_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}


@dataclass(frozen=True)
class Beams:
    """End points (n, 3) in the sensor's frame [m], NaN where invalid, and which returned; None: all."""

    points: NDArray[np.floating[Any]]
    returned: NDArray[np.bool_] | None = None


def laser_beams(message: Any) -> Beams:
    """Beams of a LaserScan by the rules of REP 117.

    A range within [range_min, range_max] is a surface. +inf is no return: free up to range_max. NaN, -inf
    (too close to be measured), other ranges, and +inf where range_max is no length are invalid. All beams
    have the pose of the message's stamp: that the laser turns while the robot moves is not corrected.
    """
    return _planar_beams(message, np.asarray(message.ranges))


def multi_echo_beams(message: Any) -> Beams:
    """Beams of a MultiEchoLaserScan, of each its nearest echo that is valid as in `laser_beams`.

    A beam with no valid echo did not return if one of its echoes is +inf.
    """
    echoes = [np.asarray(beam.echoes, dtype=np.float32) for beam in message.ranges]
    table = np.full((len(echoes), max((len(echo) for echo in echoes), default=0) + 1), np.nan, np.float32)
    for row, echo in zip(table, echoes):
        row[: len(echo)] = echo
    silent = np.isposinf(table).any(axis=1)
    valid = (table >= message.range_min) & (table <= message.range_max)
    nearest = np.where(valid, table, np.inf).min(axis=1, initial=np.inf)
    nearest[~valid.any(axis=1) & ~silent] = np.nan
    return _planar_beams(message, nearest)


def _planar_beams(message: Any, ranges: NDArray[np.floating[Any]]) -> Beams:
    ways = _directions(float(message.angle_min), float(message.angle_increment), len(ranges))
    returned = (ranges >= message.range_min) & (ranges <= message.range_max) & np.isfinite(ranges)
    length = np.where(returned, ranges, np.nan).astype(np.float64)
    if 0 < message.range_max < np.inf:
        length[np.isposinf(ranges)] = message.range_max
    return Beams(length[:, None] * ways, returned)


@lru_cache(maxsize=8)
def _directions(angle_min: float, angle_increment: float, count: int) -> Floats:
    angles = angle_min + angle_increment * np.arange(count)
    return np.stack([np.cos(angles), np.sin(angles), np.zeros(count)], axis=1)


def cloud_beams(message: Any) -> Beams:
    """Points of a PointCloud2 with fields x, y and z of any type, byte order and layout; NaN is invalid."""
    by_name = {field.name: field for field in message.fields}
    missing = [name for name in ("x", "y", "z") if name not in by_name]
    if missing:
        raise ValueError(
            f"the cloud has no field {' and no '.join(missing)}, expected x, y and z, "
            f"found {', '.join(by_name) or 'none'}"
        )
    order = ">" if message.is_bigendian else "<"
    formats, offsets = [], []
    for name in ("x", "y", "z"):
        field = by_name[name]
        if field.datatype not in _FIELD_TYPES:
            raise ValueError(f"field {name} of the cloud has type {field.datatype}, expected 1 to 8")
        formats.append(order + _FIELD_TYPES[field.datatype])
        offsets.append(int(field.offset))
    height, width = int(message.height), int(message.width)
    step, row_step = int(message.point_step), int(message.row_step)
    if row_step == 0 and height <= 1:
        row_step = width * step
    data = np.asarray(message.data, dtype=np.uint8)
    ends = [offset + np.dtype(kind).itemsize for offset, kind in zip(offsets, formats)]
    needed = (height - 1) * row_step + width * step if height and width else 0
    if height and width and (max(ends) > step or width * step > row_step or len(data) < needed):
        raise ValueError(
            f"the cloud has {len(data)} bytes, expected {needed} for {height} rows of {row_step} bytes "
            f"and {width} points of {step}"
        )
    if not needed:
        return Beams(np.zeros((0, 3), dtype=np.float32))
    layout = np.dtype({"names": ["x", "y", "z"], "formats": formats, "offsets": offsets, "itemsize": step})
    table = np.ndarray((height, width), layout, np.ascontiguousarray(data), strides=(row_step, step))
    kind = np.float32 if all(kind[1:] == "f4" for kind in formats) else np.float64
    points = np.empty((height, width, 3), dtype=kind)
    for axis, name in enumerate(("x", "y", "z")):
        points[:, :, axis] = table[name]
    return Beams(points.reshape(-1, 3))


def depth_beams(message: Any, camera: Camera, pixel_stride: int) -> Beams:
    """Points of a depth Image, 16UC1 in millimetres or 32FC1 in metres; pixels without depth are no beams."""
    return Beams(points_of(depth_of(message), camera, pixel_stride=pixel_stride))


def depth_of(message: Any) -> NDArray[Any]:
    """The pixels of a depth Image, (rows, columns), in its own unit."""
    if message.encoding not in DEPTH_ENCODINGS:
        raise ValueError(
            f"the image has encoding {message.encoding!r}, expected {', '.join(DEPTH_ENCODINGS)}"
        )
    kind = np.dtype((">" if message.is_bigendian else "<") + DEPTH_ENCODINGS[message.encoding][0])
    height, width, step = int(message.height), int(message.width), int(message.step)
    data = np.ascontiguousarray(message.data, dtype=np.uint8)
    needed = (height - 1) * step + width * kind.itemsize if height and width else 0
    if step < width * kind.itemsize or len(data) < needed:
        raise ValueError(
            f"the image has {len(data)} bytes, expected {needed} for {height} rows of {step} bytes "
            f"and {width} pixels of {kind.itemsize}"
        )
    image = np.ndarray((height, width), kind, data, strides=(step, kind.itemsize))
    return image if kind.isnative else image.astype(kind.newbyteorder("="))


def camera_of_info(message: Any, scale: float) -> Camera:
    """The camera of a CameraInfo of ROS 1 or 2, of the rectified image if it has one."""
    projection = np.asarray(message.p if hasattr(message, "p") else message.P, dtype=np.float64)
    matrix = np.asarray(message.k if hasattr(message, "k") else message.K, dtype=np.float64)
    if projection.shape == (12,) and projection[0] > 0:
        fx, cx, fy, cy = projection[[0, 2, 5, 6]]
    else:
        fx, cx, fy, cy = matrix[[0, 2, 4, 5]]
    return Camera(float(fx), float(fy), float(cx), float(cy), scale)


def stamp_of(message: Any, received: int) -> float:
    """When a message was measured [s]; when it was received [ns] if it does not say."""
    stamp = message.header.stamp
    seconds = stamp.sec + 1e-9 * stamp.nanosec
    return seconds if seconds else 1e-9 * received
