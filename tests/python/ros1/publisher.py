# SPDX-License-Identifier: BSD-3-Clause
"""Publishes a bag of ROS 1 on its topics, message by message as they are: publisher.py BAG RATE.

It waits until each topic has a listener, and ends when the node has said that it has received all scans.
"""

from __future__ import annotations

import sys
import threading
import time
from importlib import import_module
from pathlib import Path
from typing import Any

import rospy
from diagnostic_msgs.msg import DiagnosticArray
from rosbags.rosbag1 import Reader

SENSORS = ("LaserScan", "PointCloud2", "Image", "Range", "MultiEchoLaserScan")
#: For listeners, and for the last messages to arrive [s].
PATIENCE = 120.0


def class_of(type: str) -> Any:
    package, _, name = type.split("/")
    return getattr(import_module(f"{package}.msg"), name)


def main(path: Path, rate: float) -> None:
    rospy.init_node("publisher")
    counted, done = {"received": 0, "sent": -1}, threading.Condition()

    def told(message: DiagnosticArray) -> None:
        with done:
            counted["received"] = int({one.key: one.value for one in message.status[0].values}["received"])
            done.notify()

    rospy.Subscriber("/diagnostics", DiagnosticArray, told, queue_size=100)
    publishers, sent = {}, 0
    with Reader(path) as reader:
        for one in reader.connections:
            topic = "/" + one.topic.lstrip("/")
            is_static = topic.endswith("tf_static")
            kind = class_of(one.msgtype.replace("tf/msg/tfMessage", "tf2_msgs/msg/TFMessage"))
            publishers[topic] = rospy.Publisher(topic, kind, latch=is_static, queue_size=100000), kind
        deadline = time.monotonic() + PATIENCE
        while not all(publisher.get_num_connections() for publisher, _ in publishers.values()):
            assert time.monotonic() < deadline, "nobody listens"
            time.sleep(0.01)
        first, begin = None, time.monotonic()
        for connection, stamp, data in reader.messages():
            publisher, kind = publishers["/" + connection.topic.lstrip("/")]
            first = stamp if first is None else first
            if rate > 0:
                time.sleep(max(0.0, begin + 1e-9 * (stamp - first) / rate - time.monotonic()))
            publisher.publish(kind().deserialize(bytes(data)))
            sent += connection.msgtype.endswith(SENSORS)
    with done:
        assert done.wait_for(lambda: counted["received"] >= sent, PATIENCE), (counted, sent)
    assert counted["received"] == sent, (counted, sent)


if __name__ == "__main__":
    main(Path(sys.argv[1]), float(sys.argv[2]))
