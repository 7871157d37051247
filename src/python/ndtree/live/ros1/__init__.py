# SPDX-License-Identifier: BSD-3-Clause
"""The node ``ndtree_map`` of ROS 1. It needs rospy, of ROS or of Debian."""
