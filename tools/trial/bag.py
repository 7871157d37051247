# SPDX-License-Identifier: BSD-3-Clause
"""Recordings of planar lasers as ROS 1 bags: readings as sensors say them, transforms as they come."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from trial.robots import Recording, planar
from trial.scene import Floats

_BEGIN = 1_700_000_000.0  # Of the first scan [s].


def _typestore() -> Any:
    store = get_typestore(Stores.ROS1_NOETIC)
    definition = "geometry_msgs/TransformStamped[] transforms\n"
    store.register(get_types_from_msg(definition, "tf2_msgs/msg/TFMessage"))
    return store


class _Messages:
    def __init__(self) -> None:
        self.store = _typestore()

    def of(self, kind: str, **fields: Any) -> Any:
        return self.store.types[kind](**fields)

    def header(self, stamp: float, frame: str) -> Any:
        whole = round((_BEGIN + stamp) * 1e9)
        time = self.of("builtin_interfaces/msg/Time", sec=whole // 10**9, nanosec=whole % 10**9)
        return self.of("std_msgs/msg/Header", seq=0, stamp=time, frame_id=frame)

    def transform(self, stamp: float, parent: str, child: str, pose: Floats) -> Any:
        x, y, yaw = (float(one) for one in pose)
        return self.of(
            "geometry_msgs/msg/TransformStamped",
            header=self.header(stamp, parent),
            child_frame_id=child,
            transform=self.of(
                "geometry_msgs/msg/Transform",
                translation=self.of("geometry_msgs/msg/Vector3", x=x, y=y, z=0.0),
                rotation=self.of(
                    "geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=np.sin(yaw / 2), w=np.cos(yaw / 2)
                ),
            ),
        )

    def tf(self, transform: Any) -> Any:
        return self.of("tf2_msgs/msg/TFMessage", transforms=[transform])

    def laser(self, stamp: float, readings: Floats, angles: Floats, max_range: float) -> Any:
        return self.of(
            "sensor_msgs/msg/LaserScan",
            header=self.header(stamp, "laser"),
            angle_min=float(angles[0]),
            angle_max=float(angles[-1]),
            angle_increment=float(angles[1] - angles[0]),
            time_increment=0.0,
            scan_time=0.1,
            range_min=0.02,
            range_max=max_range,
            ranges=readings.astype(np.float32),
            intensities=np.zeros(0, np.float32),
        )


def write(
    r: Recording, path: Path, readings: Floats, transforms: list[tuple[float, float, Floats]] | None = None
) -> Path:
    """Write a bag.

    Parameters
    ----------
    readings : (s, n)
        As the sensor says them; r.ranges has inf for no echo.
    transforms : list of (stamp, received, pose)
        Of the robot in the frame of odometry [s]; by default those of the scans, 10 ms before each.
    """
    messages = _Messages()
    poses = planar(r.told)
    if transforms is None:
        around = [(stamp + by, pose) for stamp, pose in zip(r.stamps, poses) for by in (-1e-3, 1e-3)]
        transforms = [(stamp, stamp - 0.01, pose) for stamp, pose in around]
    tf, scan = "tf2_msgs/msg/TFMessage", "sensor_msgs/msg/LaserScan"
    entries: list[tuple[float, str, str, Any]] = [
        (received, "/tf", tf, messages.tf(messages.transform(stamp, "odom", "base_link", pose)))
        for stamp, received, pose in transforms
    ]
    entries += [
        (stamp, "/scan", scan, messages.laser(stamp, readings[i], r.sensor.angles, r.sensor.max_range))
        for i, stamp in enumerate(r.stamps)
    ]
    mount = messages.transform(-1.0, "base_link", "laser", np.zeros(3))
    entries.append((-1.0, "/tf_static", tf, messages.tf(mount)))
    with Writer(path) as writer:
        connections: dict[str, Any] = {}
        for received, topic, kind, message in sorted(entries, key=lambda entry: entry[0]):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=messages.store)
            content = messages.store.serialize_ros1(message, kind)
            writer.write(connections[topic], round((_BEGIN + received) * 1e9), content)
    return path
