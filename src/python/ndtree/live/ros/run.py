# SPDX-License-Identifier: BSD-3-Clause
"""The command ``ndtree_map``: the node of the ROS that there is."""

from __future__ import annotations

import os
from importlib.util import find_spec


def is_ros1() -> bool:
    """Whether the setup file of ROS 1 was sourced, or nothing but its rospy is installed."""
    version = os.environ.get("ROS_VERSION")
    if version in ("1", "2"):
        return version == "1"
    return find_spec("rclpy") is None and find_spec("rospy") is not None


def main() -> int:
    """Run the node; its exit status."""
    if is_ros1():
        from ndtree.live.ros1.run import main as run
    else:
        from ndtree.live.ros2.run import main as run
    return run()
