# SPDX-License-Identifier: BSD-3-Clause
"""Publishes more scans than are kept while the node sleeps; prints what it counted: burst.py COUNT PID."""

from __future__ import annotations

import os
import signal
import sys
import time

import rospy
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import LaserScan

count, pid = map(int, sys.argv[1:])
said: dict = {}
rospy.init_node("burst")
rospy.Subscriber(
    "/diagnostics",
    DiagnosticArray,
    lambda message: said.update((one.key, one.value) for one in message.status[0].values),
)
publisher = rospy.Publisher("/scan", LaserScan, queue_size=2)


def publish(i: int) -> None:
    scan = LaserScan(
        angle_min=-2.0, angle_increment=0.0002, range_min=0.1, range_max=20.0, ranges=[3.0] * 20000
    )
    scan.header.stamp, scan.header.frame_id = rospy.Time(1000 + 0.1 * i), "laser"
    publisher.publish(scan)


def counted() -> tuple[int, int]:
    return int(said.get("received", 0)), int(said.get("lost by the middleware", 0))


deadline = time.monotonic() + 120
while publisher.get_num_connections() == 0:
    time.sleep(0.02)
publish(0)
while counted()[0] < 1 and time.monotonic() < deadline:
    time.sleep(0.02)
os.kill(pid, signal.SIGSTOP)
for i in range(1, count):
    publish(i)
    time.sleep(0.002)  # The publisher's thread fills what the system keeps, and then there is no room.
os.kill(pid, signal.SIGCONT)
while sum(counted()) < count and time.monotonic() < deadline:
    time.sleep(0.02)
time.sleep(0.5)
print(*counted(), flush=True)
os._exit(0)
