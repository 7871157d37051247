# SPDX-License-Identifier: BSD-3-Clause
"""Leads a node through its lifecycle twice while a laser measures, and prints what there was, as JSON."""

from __future__ import annotations

import json
import math
import time

import rclpy
from geometry_msgs.msg import TransformStamped
from lifecycle_msgs.srv import ChangeState, GetState
from nav_msgs.srv import GetMap
from sensor_msgs.msg import LaserScan
from tf2_msgs.msg import TFMessage

CONFIGURE, CLEANUP, ACTIVATE, DEACTIVATE = 1, 2, 3, 4
PATIENCE = 60.0


def main() -> None:
    rclpy.init()
    node = rclpy.create_node("manager")
    tf = node.create_publisher(TFMessage, "/tf", 100)
    scans = node.create_publisher(LaserScan, "/scan", 100)
    clients: dict = {}

    def call(kind, name, request=None):
        client = clients.get(name) or clients.setdefault(
            name, node.create_client(kind, f"/ndtree_map/{name}")
        )
        assert client.wait_for_service(PATIENCE), name
        for _ in range(10):  # The first request after a service was found may be lost.
            future = client.call_async(request or kind.Request())
            rclpy.spin_until_future_complete(node, future, timeout_sec=30.0)
            if future.done():
                return future.result()
        raise TimeoutError(name)

    def change(number: int) -> str:
        request = ChangeState.Request()
        request.transition.id = number
        assert call(ChangeState, "change_state", request).success, number
        return call(GetState, "get_state").current_state.label

    def measure(radius: float) -> None:
        now = node.get_clock().now().to_msg()
        moved = TransformStamped(child_frame_id="laser")
        moved.header.stamp, moved.header.frame_id = now, "odom"
        tf.publish(TFMessage(transforms=[moved]))
        scan = LaserScan(angle_min=-math.pi, angle_increment=0.02, range_min=0.1, range_max=20.0)
        scan.header.stamp, scan.header.frame_id = now, "laser"
        scan.ranges = [radius] * 314
        scans.publish(scan)

    def width_of_a_map(radius: float) -> int:
        deadline = time.monotonic() + PATIENCE
        while time.monotonic() < deadline:
            for _ in range(10):
                measure(radius)
                time.sleep(0.02)
            width = call(GetMap, "get_map").map.info.width
            if width:
                return width
        raise TimeoutError("map")

    said = {"states": [call(GetState, "get_state").current_state.label], "widths": [], "publishers": []}
    for radius in (6.0, 2.0):
        said["states"] += [change(CONFIGURE), change(ACTIVATE)]
        said["widths"].append(width_of_a_map(radius))
        counts = [len(node.get_publishers_info_by_topic(topic)) for topic in ("/map", "/map_updates")]
        said["publishers"].append(counts)
        said["states"] += [change(DEACTIVATE), change(CLEANUP)]
    print(json.dumps(said))
    rclpy.shutdown()


if __name__ == "__main__":
    main()
