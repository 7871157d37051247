# SPDX-License-Identifier: BSD-3-Clause
"""Bags of ROS 1 and ROS 2 as files: what is stored, message by message."""
