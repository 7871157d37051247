# SPDX-License-Identifier: BSD-3-Clause
"""Writes bags for the tests with the library rosbags, which is not ours."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags")

from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

KINDS = ("ros1", "sqlite3", "mcap")
START = 1.7e9  # Of recordings [s].
LEVEL = [0, 0, 0, 1]  # A quaternion that turns nothing.
Row = tuple[str, float, Any]  # A topic, the time of recording [s], and a message.

_TF_DEFINITION = "geometry_msgs/TransformStamped[] transforms\n"


def _store(kind: str) -> Any:
    if kind != "ros1":
        return get_typestore(Stores.ROS2_HUMBLE)
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg(_TF_DEFINITION, "tf2_msgs/msg/TFMessage"))
    return store


class Messages:
    """Makes messages of ROS 1 or 2."""

    def __init__(self, kind: str) -> None:
        self.kind = kind
        self.store = _store(kind)

    def of(self, type: str, **fields: Any) -> Any:
        return self.store.types[type](**fields)

    def header(self, stamp: float, frame: str) -> Any:
        nanoseconds = round(stamp * 1e9)
        time = self.of("builtin_interfaces/msg/Time", sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
        seq = {"seq": 0} if self.kind == "ros1" else {}
        return self.of("std_msgs/msg/Header", stamp=time, frame_id=frame, **seq)

    def transform(self, stamp: float, parent: str, child: str, position: Any, quaternion: Any) -> Any:
        return self.of(
            "geometry_msgs/msg/TransformStamped",
            header=self.header(stamp, parent),
            child_frame_id=child,
            transform=self.of(
                "geometry_msgs/msg/Transform",
                translation=self.vector(position),
                rotation=self.quaternion(quaternion),
            ),
        )

    def vector(self, values: Any, type: str = "Vector3") -> Any:
        x, y, z = (float(value) for value in values)
        return self.of(f"geometry_msgs/msg/{type}", x=x, y=y, z=z)

    def quaternion(self, values: Any) -> Any:
        x, y, z, w = (float(value) for value in values)
        return self.of("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)

    def pose(self, position: Any, quaternion: Any = LEVEL) -> Any:
        return self.of(
            "geometry_msgs/msg/Pose",
            position=self.vector(position, "Point"),
            orientation=self.quaternion(quaternion),
        )

    def tf(self, *transforms: Any) -> Any:
        return self.of("tf2_msgs/msg/TFMessage", transforms=list(transforms))

    def moved(
        self,
        stamp: float,
        parent: str,
        child: str,
        position: Any,
        quaternion: Any = LEVEL,
        *,
        at: float | None = None,
        topic: str = "/tf",
    ) -> Row:
        """A transform as `write_bag` takes it; `at` is when it was recorded [s], else at its stamp."""
        moved = self.transform(stamp, parent, child, position, quaternion)
        return topic, stamp if at is None else at, self.tf(moved)

    def fixed(self, *transform: Any, at: float | None = None) -> Row:
        """A transform that holds for ever, as `write_bag` takes it."""
        return self.moved(*transform, at=at, topic="/tf_static")

    def odometry(self, stamp: float, parent: str, child: str, position: Any, quaternion: Any) -> Any:
        return self.of(
            "nav_msgs/msg/Odometry",
            header=self.header(stamp, parent),
            child_frame_id=child,
            pose=self.of(
                "geometry_msgs/msg/PoseWithCovariance",
                pose=self.pose(position, quaternion),
                covariance=np.zeros(36),
            ),
            twist=self.of(
                "geometry_msgs/msg/TwistWithCovariance",
                twist=self.of(
                    "geometry_msgs/msg/Twist", linear=self.vector([0] * 3), angular=self.vector([0] * 3)
                ),
                covariance=np.zeros(36),
            ),
        )

    def laser(self, stamp: float, frame: str, ranges: Any, **changes: Any) -> Any:
        n = len(ranges)
        fields: dict[str, Any] = {
            "angle_min": -1.5, "angle_increment": 3.0 / max(n - 1, 1),
            "time_increment": 0.0, "scan_time": 0.1, "range_min": 0.1, "range_max": 8.0, **changes,
        }  # fmt: skip
        fields.setdefault("angle_max", fields["angle_min"] + (n - 1) * fields["angle_increment"])
        return self.of(
            "sensor_msgs/msg/LaserScan",
            header=self.header(stamp, frame),
            ranges=np.asarray(ranges, dtype=np.float32),
            intensities=np.zeros(0, dtype=np.float32),
            **fields,
        )

    def multi_echo(self, stamp: float, frame: str, ranges: Iterable[Any]) -> Any:
        echoes = [
            self.of("sensor_msgs/msg/LaserEcho", echoes=np.asarray(beam, dtype=np.float32)) for beam in ranges
        ]
        return self.of(
            "sensor_msgs/msg/MultiEchoLaserScan",
            header=self.header(stamp, frame), ranges=echoes, intensities=[],
            angle_min=0.0, angle_max=1.0, angle_increment=0.25, time_increment=0.0, scan_time=0.1,
            range_min=0.5, range_max=8.0,
        )  # fmt: skip

    def cloud(
        self,
        stamp: float,
        frame: str,
        points: Any,
        *,
        types: tuple[int, int, int] = (7, 7, 7),
        offsets: tuple[int, int, int] = (0, 4, 8),
        step: int = 16,
        height: int = 1,
        row_padding: int = 0,
        big: bool = False,
    ) -> Any:
        """A PointCloud2 packed byte by byte, from (n, 3) numbers."""
        codes = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
        width = len(points) // height
        data = bytearray(height * (width * step + row_padding))
        for i, point in enumerate(points):
            start = (i // width) * (width * step + row_padding) + (i % width) * step
            for value, type_, offset in zip(point, types, offsets):
                packed = np.array(value).astype((">" if big else "<") + codes[type_]).tobytes()
                data[start + offset : start + offset + len(packed)] = packed
        fields = [
            self.of("sensor_msgs/msg/PointField", name=name, offset=offset, datatype=type_, count=1)
            for name, type_, offset in zip("xyz", types, offsets)
        ]
        return self.of(
            "sensor_msgs/msg/PointCloud2",
            header=self.header(stamp, frame), height=height, width=width, fields=fields, is_bigendian=big,
            point_step=step, row_step=width * step + row_padding,
            data=np.frombuffer(bytes(data), dtype=np.uint8), is_dense=False,
        )  # fmt: skip

    def with_times(self, cloud: Any, points: Any, times: Any, name: str = "time") -> Any:
        """A cloud of points (n, 3) as float32, with a field of times in their own type behind them."""
        times = np.asarray(times)
        table = np.zeros(len(points), np.dtype([("xyz", "f4", 3), ("time", times.dtype)]))
        table["xyz"], table["time"] = points, times
        code = {"u4": 6, "f4": 7, "f8": 8}[times.dtype.str[1:]]
        extra = self.of("sensor_msgs/msg/PointField", name=name, offset=12, datatype=code, count=1)
        return changed(
            cloud, fields=[*cloud.fields, extra], point_step=table.itemsize, row_step=table.nbytes,
            data=np.frombuffer(table.tobytes(), np.uint8),
        )  # fmt: skip

    def image(
        self, stamp: float, frame: str, values: Any, encoding: str, *, big: bool = False, padding: int = 0
    ) -> Any:
        codes = {"mono8": "u1", "rgb8": "u1", "16SC1": "i2", "32FC1": "f4"}
        code = codes.get(encoding, "u2")
        rows = [row.astype((">" if big else "<") + code).tobytes() + bytes(padding) for row in values]
        return self.of(
            "sensor_msgs/msg/Image",
            header=self.header(stamp, frame), height=len(values), width=values.shape[1], encoding=encoding,
            is_bigendian=int(big), step=len(rows[0]), data=np.frombuffer(b"".join(rows), dtype=np.uint8),
        )  # fmt: skip

    def compressed_image(self, format: str, data: bytes) -> Any:
        return self.of(
            "sensor_msgs/msg/CompressedImage", header=self.header(START, "camera"), format=format,
            data=np.frombuffer(data, np.uint8),
        )  # fmt: skip

    def camera_info(self, stamp: float, frame: str, shape: tuple[int, int], camera: Any) -> Any:
        fx, fy, cx, cy = camera
        k = np.array([fx, 0, cx, 0, fy, cy, 0, 0, 1.0])
        p = np.array([fx, 0, cx, 0, 0, fy, cy, 0, 0, 0, 1.0, 0])
        names = "DKRP" if self.kind == "ros1" else "dkrp"
        roi = self.of(
            "sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
        )
        return self.of(
            "sensor_msgs/msg/CameraInfo",
            header=self.header(stamp, frame), height=shape[0], width=shape[1], distortion_model="plumb_bob",
            binning_x=0, binning_y=0, roi=roi, **dict(zip(names, (np.zeros(0), k, np.eye(3).ravel(), p))),
        )  # fmt: skip

    def text(self, words: str) -> Any:
        return self.of("std_msgs/msg/String", data=words)


def changed(message: Any, **values: Any) -> Any:
    """A message with other fields."""
    for name, value in values.items():
        object.__setattr__(message, name, value)
    return message


def same(one: Any, other: Any) -> bool:
    """Whether two logs have the same scans."""
    return len(one) == len(other) and all(
        np.array_equal(a.endpoints, b.endpoints) and a.stamp == b.stamp for a, b in zip(one, other)
    )


def write_bag(
    path: Path, make: Messages, content: Iterable[tuple[str, float, Any]], *, packed: bool = False
) -> Path:
    """Write (topic, time of recording [s], message or (type, bytes)) in their order; returns what to read.

    `packed` compresses the chunks of a ROS 1 bag.
    """
    store = make.store
    if make.kind == "ros1":
        path = path.with_suffix(".bag")
        writer: Any = Writer1(path)
        if packed:
            writer.set_compression(writer.CompressionFormat.BZ2)
        serialize = store.serialize_ros1
    else:
        plugin = StoragePlugin.MCAP if make.kind == "mcap" else StoragePlugin.SQLITE3
        writer = Writer2(path, version=9, storage_plugin=plugin)
        serialize = store.serialize_cdr
    connections: dict[tuple[str, str], Any] = {}
    with writer:
        for topic, stamp, message in content:
            type_, raw = message if isinstance(message, tuple) else (message.__msgtype__, None)
            if (topic, type_) not in connections:
                connections[topic, type_] = writer.add_connection(topic, type_, typestore=store)
            data = serialize(message, type_) if raw is None else raw
            writer.write(connections[topic, type_], round(stamp * 1e9), bytes(data))
    return path
