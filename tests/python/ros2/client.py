# SPDX-License-Identifier: BSD-3-Clause
"""Publishes scans to the node, uses all its services, and prints what it is told as JSON: client.py FILE."""

from __future__ import annotations

import json
import sys
import time

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Point32, PolygonStamped, TransformStamped
from lifecycle_msgs.srv import GetState
from nav_msgs.srv import GetMap, GetPlan, LoadMap
from rcl_interfaces.msg import ParameterValue
from rcl_interfaces.srv import DescribeParameters, SetParameters
from rclpy.parameter import Parameter
from sensor_msgs.msg import LaserScan
from std_srvs.srv import Empty, Trigger
from tf2_msgs.msg import TFMessage

SCANS = 60


def main(file: str) -> None:
    rclpy.init()
    node = rclpy.create_node("client")
    tf = node.create_publisher(TFMessage, "/tf", 100)
    scans = node.create_publisher(LaserScan, "/scan", 100)
    boxes = node.create_publisher(PolygonStamped, "/ndtree_map/clear_box", 10)
    said: dict = {}
    diagnostics: dict = {}

    def told(message) -> None:
        diagnostics.update((one.key, one.value) for one in message.status[0].values)

    node.create_subscription(DiagnosticArray, "/diagnostics", told, 10)

    def call(kind, name, request=None):
        client = node.create_client(kind, f"/ndtree_map/{name}")
        assert client.wait_for_service(60.0), name
        for _ in range(10):  # The first request after a service was found may be lost.
            future = client.call_async(request or kind.Request())
            rclpy.spin_until_future_complete(node, future, timeout_sec=6.0)
            if future.done():
                return future.result()
        raise TimeoutError(name)

    def known() -> int:
        return sum(value >= 0 for value in call(GetMap, "get_map").map.data)

    def planned(start, goal):
        request = GetPlan.Request()
        request.start.pose.position.x, request.goal.pose.position.x = start, goal
        path = call(GetPlan, "get_plan", request).plan
        return [path.header.frame_id, *(round(one.pose.position.x, 6) for one in path.poses)]

    def set_parameter(name, value):
        given = Parameter(name, value=value).to_parameter_msg()
        assert isinstance(given.value, ParameterValue)
        result = call(SetParameters, "set_parameters", SetParameters.Request(parameters=[given])).results[0]
        return [result.successful, result.reason]

    def drive() -> None:
        while min(one.get_subscription_count() for one in (scans, tf, boxes)) < 1:
            rclpy.spin_once(node, timeout_sec=0.05)
        for i in range(SCANS):
            now = node.get_clock().now().to_msg()
            moved = TransformStamped(child_frame_id="laser")
            moved.header.stamp, moved.header.frame_id = now, "odom"
            moved.transform.translation.x = 0.02 * i
            tf.publish(TFMessage(transforms=[moved]))
            scan = LaserScan(angle_min=-2.0, angle_increment=0.02, range_min=0.1, range_max=20.0)
            scan.header.stamp, scan.header.frame_id = now, "laser"
            scan.ranges = [3.0 + 0.01 * (i % 3)] * 200
            scans.publish(scan)
            time.sleep(0.02)

    said["state"] = call(GetState, "get_state").current_state.label
    said["early save"] = call(Trigger, "save").message
    names = ["window", "queue", "grid_period"]
    described = call(DescribeParameters, "describe_parameters", DescribeParameters.Request(names=names))
    said["described"] = [bool(one.description) for one in described.descriptors]
    said["limits"] = [described.descriptors[1].integer_range[0].from_value]
    drive()
    counted = 0
    deadline = time.monotonic() + 60
    while counted < SCANS:
        assert time.monotonic() < deadline, diagnostics
        rclpy.spin_once(node, timeout_sec=0.1)
        names = [one for one in diagnostics if one in ("mapped", "dropped") or one.startswith("left out")]
        counted = sum(int(diagnostics[one]) for one in names)
    said["mapped"] = int(diagnostics["mapped"])
    said["known"] = known()
    said["changed"] = set_parameter("grid_period", 0.05)
    said["refused"] = set_parameter("queue", 7)
    said["out of limits"] = set_parameter("grid_period", -1.0)
    said["plans"] = [planned(0.8, 2.0), planned(0.8, 50.0)]
    saved = call(Trigger, "save")
    said["save"] = [saved.success, saved.message]
    said["cleared"] = call(Trigger, "clear_around").success
    said["known around"] = known()
    corners = [Point32(x=-1.0, y=-5.0), Point32(x=0.0, y=5.0)]
    polygon = PolygonStamped()
    polygon.header.frame_id, polygon.polygon.points = "odom", corners
    boxes.publish(polygon)
    deadline = time.monotonic() + 60
    while known() >= said["known around"]:  # A message: no answer says that it was taken.
        assert time.monotonic() < deadline
    said["known without a box"] = known()
    call(Empty, "reset")
    said["known after reset"] = known()
    said["load"] = [
        call(LoadMap, "load", LoadMap.Request(map_url=url)).result for url in (file, "/nothing.ndt", __file__)
    ]
    said["known after load"] = known()
    print(json.dumps(said))
    rclpy.shutdown()


if __name__ == "__main__":
    main(sys.argv[1])
