# SPDX-License-Identifier: BSD-3-Clause
"""Publishes a bag on its topics, message by message as they are: publisher.py BAG RATE LISTENERS.

It waits until each topic with measurements or transforms has this many listeners, and ends when they have
the last message.
"""

from __future__ import annotations

import sys
import time
from dataclasses import fields
from importlib import import_module
from pathlib import Path
from typing import Any

import rclpy
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

SENSORS = ("LaserScan", "PointCloud2", "Image", "Range", "MultiEchoLaserScan")
#: For listeners, and for the last messages to arrive [s].
PATIENCE = 120.0


def as_ros2(one: Any, store: Typestore) -> Any:
    """A message of ROS 1 as one of ROS 2: without numbers of headers."""
    if isinstance(one, list):
        return [as_ros2(part, store) for part in one]
    if not hasattr(one, "__msgtype__"):
        return one
    kind = store.types[one.__msgtype__.replace("tf/msg/tfMessage", "tf2_msgs/msg/TFMessage")]
    names = [field.name for field in fields(kind) if not field.name.startswith("__")]
    return kind(**{name: as_ros2(getattr(one, name), store) for name in names})


def main(path: Path, rate: float, listeners: int) -> None:
    rclpy.init()
    node = rclpy.create_node("publisher")
    store = get_typestore(Stores.ROS2_HUMBLE)
    publishers = {}
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        is_ros1 = path.suffix == ".bag"
        for one in reader.connections:
            type_ = "tf2_msgs/msg/TFMessage" if one.msgtype == "tf/msg/tfMessage" else one.msgtype
            package, _, name = type_.split("/")
            try:
                kind = getattr(import_module(f"{package}.msg"), name)
            except (ImportError, AttributeError):
                continue
            qos = QoSProfile(depth=10000)
            topic = "/" + one.topic.lstrip("/")
            if topic.endswith("tf_static"):
                qos.durability = DurabilityPolicy.TRANSIENT_LOCAL
            if topic not in publishers:
                publishers[topic] = node.create_publisher(kind, topic, qos), type_
        needed = [p for p, type_ in publishers.values() if type_.endswith((*SENSORS, "TFMessage"))]
        deadline = time.monotonic() + PATIENCE
        while min(p.get_subscription_count() for p in needed) < listeners:
            assert time.monotonic() < deadline, [p.topic_name for p in needed]
            rclpy.spin_once(node, timeout_sec=0.05)
        first, begin = None, time.monotonic()
        for connection, stamp, data in reader.messages():
            topic = "/" + connection.topic.lstrip("/")
            if topic not in publishers:
                continue
            first = stamp if first is None else first
            if rate > 0:
                time.sleep(max(0.0, begin + 1e-9 * (stamp - first) / rate - time.monotonic()))
            if is_ros1:
                message = reader.deserialize(data, connection.msgtype)
                data = store.serialize_cdr(as_ros2(message, store), publishers[topic][1])
            publishers[topic][0].publish(bytes(data))
    for publisher, _ in publishers.values():
        assert publisher.wait_for_all_acked(Duration(seconds=PATIENCE)), publisher.topic_name
    for publisher in needed:  # A listener that is gone owes no acknowledgement.
        assert publisher.get_subscription_count() >= listeners, f"{publisher.topic_name}: a listener has gone"
    rclpy.shutdown()


if __name__ == "__main__":
    main(Path(sys.argv[1]), float(sys.argv[2]), int(sys.argv[3]))
