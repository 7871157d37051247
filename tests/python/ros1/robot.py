# SPDX-License-Identifier: BSD-3-Clause
"""A robot of ROS 1 that drives through a room and turns, with a laser; run by the Python that has rospy."""

import math
import sys

import rospy
from geometry_msgs.msg import TransformStamped
from sensor_msgs.msg import LaserScan
from tf2_msgs.msg import TFMessage

ROOM = (-4.0, -3.0, 4.0, 3.0)
MOUNT = (0.2, 0.1, 0.5)  # x, y [m] and yaw [rad] of the laser on its base
BEAMS = 181


def transform(stamp, parent, child, x, y, yaw):
    one = TransformStamped()
    one.header.stamp, one.header.frame_id, one.child_frame_id = stamp, parent, child
    one.transform.translation.x, one.transform.translation.y = x, y
    one.transform.rotation.z, one.transform.rotation.w = math.sin(yaw / 2), math.cos(yaw / 2)
    return one


def pose(t):
    """Where the base is at a time since the start [s]."""
    return 0.3 * t - 1.0, 0.5 * math.sin(t), 0.4 * t


def distance(x, y, angle):
    """To the wall of the room [m]."""
    c, s = math.cos(angle), math.sin(angle)
    along_x = ((ROOM[2] if c > 0 else ROOM[0]) - x) / c if abs(c) > 1e-9 else math.inf
    along_y = ((ROOM[3] if s > 0 else ROOM[1]) - y) / s if abs(s) > 1e-9 else math.inf
    return min(along_x, along_y)


def main():
    """N steps of 25 ms by the stamps of its messages, whatever the time by the clock on the wall."""
    steps = int(sys.argv[1])
    rospy.init_node("robot")
    tf = rospy.Publisher("/tf", TFMessage, queue_size=1000)
    static = rospy.Publisher("/tf_static", TFMessage, queue_size=10, latch=True)
    scans = rospy.Publisher("/scan", LaserScan, queue_size=1000)
    while not all(one.get_num_connections() for one in (tf, static, scans)):
        rospy.sleep(0.02)
    start = rospy.Time.now()
    static.publish(TFMessage([transform(start, "base_link", "laser", *MOUNT)]))
    for number in range(steps):
        t = 0.025 * number
        now = start + rospy.Duration.from_sec(t)
        x, y, yaw = pose(t)
        if number >= 8:  # The first scans come before the first transform.
            tf.publish(TFMessage([transform(now, "odom", "base_link", x, y, yaw)]))
        if number % 2 == 0:
            scan = LaserScan()
            scan.header.stamp, scan.header.frame_id = now, "/laser"
            scan.angle_min, scan.angle_increment = -math.pi / 2, math.pi / (BEAMS - 1)
            scan.angle_max, scan.range_min, scan.range_max = math.pi / 2, 0.1, 30.0
            laser_x = x + MOUNT[0] * math.cos(yaw) - MOUNT[1] * math.sin(yaw)
            laser_y = y + MOUNT[0] * math.sin(yaw) + MOUNT[1] * math.cos(yaw)
            scan.ranges = [
                distance(laser_x, laser_y, yaw + MOUNT[2] + scan.angle_min + i * scan.angle_increment)
                for i in range(BEAMS)
            ]
            scans.publish(scan)
        rospy.sleep(0.005)  # The recorder keeps a hundred messages that it has not written.
    print("driven", flush=True)
    sys.stdin.read()  # Who called it has seen them recorded.


main()
