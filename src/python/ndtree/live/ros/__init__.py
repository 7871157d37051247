# SPDX-License-Identifier: BSD-3-Clause
"""What the nodes ``ndtree_map`` of ROS 1 and ROS 2 have in common."""
