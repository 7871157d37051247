# SPDX-License-Identifier: BSD-3-Clause
"""Publishes large messages as the node does, and is gone at once: sender.py COUNT [deliver]."""

from __future__ import annotations

import os
import sys
import time

import rospy
from std_msgs.msg import UInt8MultiArray

from ndtree.live.ros1.node import _Publisher

rospy.init_node("sender")
publisher = _Publisher(UInt8MultiArray, "large", 1000)
while publisher.listeners() == 0:
    time.sleep(0.02)
for _ in range(int(sys.argv[1])):
    publisher.publish(UInt8MultiArray(data=bytes(1_000_000)))
if sys.argv[2:] == ["deliver"]:
    publisher.deliver(time.monotonic() + 60.0)
os._exit(0)
