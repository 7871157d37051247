# SPDX-License-Identifier: BSD-3-Clause
"""Takes messages more slowly than they come, until the sender has gone, and says how many: slow.py OUTPUT."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import rospy
from std_msgs.msg import UInt8MultiArray

received = 0


def take(message: UInt8MultiArray) -> None:
    global received
    time.sleep(0.03)
    received += len(message.data) == 1_000_000


rospy.init_node("slow")
subscriber = rospy.Subscriber("large", UInt8MultiArray, take, buff_size=65536)
while subscriber.get_num_connections() == 0:
    time.sleep(0.01)
while subscriber.get_num_connections() > 0:
    time.sleep(0.01)
Path(sys.argv[1]).write_text(str(received))
