# SPDX-License-Identifier: BSD-3-Clause
"""Asks the node for all that octomap_server has once it has mapped: asker.py SCANS OUTPUT.npz."""

from __future__ import annotations

import sys
import time

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import OccupancyGrid
from nav_msgs.srv import GetMap
from octomap_msgs.srv import BoundingBoxQuery, GetOctomap
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import PointCloud2

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def main(scans: str, output: str) -> None:
    rclpy.init()
    node = rclpy.create_node("asker")
    found: dict = {}
    diagnostics: dict = {}
    changes: list = []

    def told(message) -> None:
        diagnostics.update((one.key, one.value) for one in message.status[0].values)

    def rows(message):
        return np.frombuffer(bytes(message.data), "<f4").reshape(message.width, len(message.fields))

    def until(happens) -> None:
        deadline = time.monotonic() + 120
        while not happens():
            assert time.monotonic() < deadline, (diagnostics, list(found))
            rclpy.spin_once(node, timeout_sec=0.1)

    def call(kind, name, request=None):
        client = node.create_client(kind, f"/ndtree_map/{name}")
        assert client.wait_for_service(60.0), name
        for _ in range(10):  # The first request after a service was found may be lost.
            future = client.call_async(request or kind.Request())
            rclpy.spin_until_future_complete(node, future, timeout_sec=6.0)
            if future.done():
                return future.result()
        raise TimeoutError(name)

    def whole(topic):
        """A grid as who comes later gets it."""
        got: list = []
        subscription = node.create_subscription(OccupancyGrid, topic, got.append, LATCHED)
        until(lambda: got)
        for _ in range(20):
            rclpy.spin_once(node, timeout_sec=0.1)
        node.destroy_subscription(subscription)
        info = got[-1].info
        return np.array(got[-1].data, dtype=np.int8).reshape(info.height, info.width)

    node.create_subscription(DiagnosticArray, "/diagnostics", told, 10)
    node.create_subscription(PointCloud2, "ndtree_map/changes", lambda one: changes.append(rows(one)), 1000)
    cells = [
        node.create_subscription(
            PointCloud2, f"ndtree_map/{name}", lambda one, name=name: found.update({name: rows(one)}), LATCHED
        )
        for name in ("free_cells", "occupied_cells")
    ]
    until(lambda: diagnostics.get("mapped") == scans)
    for _ in range(60):  # Cells are published once a second at most.
        rclpy.spin_once(node, timeout_sec=0.1)
    for subscription in cells:  # What is cleared below is published, too.
        node.destroy_subscription(subscription)
    found["changes"] = np.concatenate(changes)
    for name in ("low", "high"):
        found[f"map_{name}"] = whole(f"map_{name}")

    def nodes(name):
        return np.frombuffer(np.array(call(GetOctomap, name).map.data, dtype=np.int8).tobytes(), np.uint8)

    for name in ("octomap_full", "octomap_binary"):
        found[name] = nodes(name)
    for above in ("ground", "robot", "sky"):
        given = Parameter("grid_above", value=above).to_parameter_msg()
        said = call(SetParameters, "set_parameters", SetParameters.Request(parameters=[given])).results[0]
        answered = call(GetMap, "get_map").map
        shape = answered.info.height, answered.info.width
        found[f"above {above}"] = np.array(answered.data, dtype=np.int8).reshape(shape)
        found[f"said of {above}"] = np.array([said.reason])
    query = BoundingBoxQuery.Request()
    query.min.x = query.min.y = query.min.z = -50.0
    query.max.x, query.max.y, query.max.z = 0.0, 50.0, 50.0
    call(BoundingBoxQuery, "clear_bbox", query)
    found["cleared"] = nodes("octomap_full")
    with open(output, "wb") as file:
        np.savez(file, **found)
    rclpy.shutdown()


if __name__ == "__main__":
    main(*sys.argv[1:])
