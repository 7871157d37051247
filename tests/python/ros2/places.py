# SPDX-License-Identifier: BSD-3-Clause
"""Receives where the node finds the robot until a file appears, and writes it: places.py OUTPUT.json STOP."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import rclpy
from geometry_msgs.msg import PoseWithCovarianceStamped
from tf2_msgs.msg import TFMessage


def main(output: Path, stop: Path) -> None:
    rclpy.init()
    node = rclpy.create_node("places")
    said: dict[str, list[Any]] = {"poses": [], "odometry": []}

    def pose(message: PoseWithCovarianceStamped) -> None:
        place = message.pose.pose.position
        stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        said["poses"].append((stamp, place.x, place.y, message.header.frame_id))

    def moved(message: TFMessage) -> None:
        for one in message.transforms:
            if one.header.frame_id == "map":
                said["odometry"].append(one.child_frame_id)

    kept = [
        node.create_subscription(PoseWithCovarianceStamped, "/ndtree_map/pose", pose, 1000),
        node.create_subscription(TFMessage, "/tf", moved, 1000),
    ]
    while not stop.exists():
        rclpy.spin_once(node, timeout_sec=0.1)
    output.write_text(json.dumps(said), encoding="utf-8")
    del kept
    node.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
