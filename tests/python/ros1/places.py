# SPDX-License-Identifier: BSD-3-Clause
"""Receives where the node finds the robot until the node has ended, and writes it: places.py OUTPUT.json."""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import rospy
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import OccupancyGrid
from tf2_msgs.msg import TFMessage

PATIENCE = 120.0


def main(output: str) -> None:
    rospy.init_node("places")
    said: dict[str, list[Any]] = {"poses": [], "odometry": [], "grid": []}

    def pose(message: PoseWithCovarianceStamped) -> None:
        place = message.pose.pose.position
        stamp = message.header.stamp.to_sec()
        said["poses"].append((stamp, place.x, place.y, message.header.frame_id))

    def moved(message: TFMessage) -> None:
        for one in message.transforms:
            if one.header.frame_id == "map":
                said["odometry"].append((one.child_frame_id, one.header.stamp.to_sec()))

    def grid(message: OccupancyGrid) -> None:
        said["grid"] = list(message.data)

    poses = rospy.Subscriber("ndtree_map/pose", PoseWithCovarianceStamped, pose, queue_size=10000)
    others = [
        rospy.Subscriber("/tf", TFMessage, moved, queue_size=10000),
        rospy.Subscriber("map", OccupancyGrid, grid, queue_size=10),
    ]
    deadline, met = time.monotonic() + PATIENCE, False
    while not met or poses.get_num_connections():
        met = met or poses.get_num_connections() > 0
        assert time.monotonic() < deadline, "the node does not end"
        time.sleep(0.05)
    time.sleep(0.5)  # What has arrived is handed on.
    with open(output, "w", encoding="utf-8") as file:
        json.dump(said, file)
    del others


if __name__ == "__main__":
    main(sys.argv[1])
