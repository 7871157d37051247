# SPDX-License-Identifier: BSD-3-Clause
"""Bags of ROS: files to messages, messages to beams and poses."""
