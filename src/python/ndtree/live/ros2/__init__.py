# SPDX-License-Identifier: BSD-3-Clause
"""The node ``ndtree_map`` of ROS 2. It needs rclpy: of ROS, or of the extra ``ros2``."""
