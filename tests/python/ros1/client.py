# SPDX-License-Identifier: BSD-3-Clause
"""Publishes scans to the node, uses all its services, and prints what it is told as JSON: client.py FILE."""

from __future__ import annotations

import json
import sys
import threading
import time

import rospy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Point32, PolygonStamped, PoseStamped, TransformStamped
from nav_msgs.srv import GetMap, GetPlan, LoadMap
from rosgraph_msgs.msg import Log
from sensor_msgs.msg import LaserScan
from std_srvs.srv import Empty, Trigger
from tf2_msgs.msg import TFMessage

SCANS, PATIENCE = 60, 60.0


def main(file: str) -> None:
    rospy.init_node("client")
    tf = rospy.Publisher("/tf", TFMessage, queue_size=1000)
    scans = rospy.Publisher("/scan", LaserScan, queue_size=1000)
    boxes = rospy.Publisher("/ndtree_map/clear_box", PolygonStamped, queue_size=10)
    said: dict = {}
    diagnostics: dict = {}
    told = threading.Condition()

    def receive(message: DiagnosticArray) -> None:
        with told:
            diagnostics.update((one.key, one.value) for one in message.status[0].values)
            told.notify()

    rospy.Subscriber("/diagnostics", DiagnosticArray, receive)

    def call(kind, name, *request):
        rospy.wait_for_service(f"/ndtree_map/{name}", PATIENCE)
        return rospy.ServiceProxy(f"/ndtree_map/{name}", kind)(*request)

    def known() -> int:
        return sum(value >= 0 for value in call(GetMap, "get_map").map.data)

    def planned(start, goal):
        ends = PoseStamped(), PoseStamped()
        ends[0].pose.position.x, ends[1].pose.position.x = start, goal
        path = call(GetPlan, "get_plan", *ends, 0.0).plan
        return [path.header.frame_id, *(round(one.pose.position.x, 6) for one in path.poses)]

    said["early save"] = call(Trigger, "save").message
    deadline = time.monotonic() + PATIENCE
    while not all(one.get_num_connections() for one in (scans, tf, boxes)):
        assert time.monotonic() < deadline, "nobody listens"
        time.sleep(0.01)
    for i in range(SCANS):
        now = rospy.Time.now()
        moved = TransformStamped(child_frame_id="laser")
        moved.header.stamp, moved.header.frame_id = now, "odom"
        moved.transform.translation.x, moved.transform.rotation.w = 0.02 * i, 1.0
        tf.publish(TFMessage([moved]))
        scan = LaserScan(angle_min=-2.0, angle_increment=0.02, range_min=0.1, range_max=20.0)
        scan.header.stamp, scan.header.frame_id = now, "laser"
        scan.ranges = [3.0 + 0.01 * (i % 3)] * 200
        scans.publish(scan)
        time.sleep(0.01)

    def counted() -> int:
        names = [one for one in diagnostics if one in ("mapped", "dropped") or one.startswith("left out")]
        return sum(int(diagnostics[one]) for one in names)

    with told:
        assert told.wait_for(lambda: counted() >= SCANS, PATIENCE), diagnostics
    said["mapped"] = int(diagnostics["mapped"])
    said["known"] = known()
    said["plans"] = [planned(0.8, 2.0), planned(0.8, 50.0)]
    saved = call(Trigger, "save")
    said["save"] = [saved.success, saved.message]
    said["cleared"] = call(Trigger, "clear_around").success
    said["known around"] = known()
    polygon = PolygonStamped()
    polygon.header.frame_id = "odom"
    polygon.polygon.points = [Point32(x=-1.0, y=-5.0), Point32(x=0.0, y=5.0)]
    boxes.publish(polygon)
    deadline = time.monotonic() + PATIENCE
    while known() >= said["known around"]:  # A message: no answer says that it was taken.
        assert time.monotonic() < deadline
    said["known without a box"] = known()
    call(Empty, "reset")
    said["known after reset"] = known()
    said["load"] = [call(LoadMap, "load", url).result for url in (file, "/nothing.ndt", __file__)]
    said["known after load"] = known()

    def radius_until(happens, what: str) -> str:
        """What clearing says; the server tells a node of another value some time later."""
        deadline = time.monotonic() + PATIENCE
        while not happens(message := call(Trigger, "clear_around").message):
            assert time.monotonic() < deadline, (what, message)
        return message

    logged: list[str] = []
    rosout = rospy.Subscriber("/rosout", Log, lambda message: logged.append(message.msg))
    while not rosout.get_num_connections():
        assert time.monotonic() < deadline + PATIENCE, "no log"
        time.sleep(0.01)
    rospy.set_param("/ndtree_map/clear_radius", 0.75)
    said["changed"] = radius_until(lambda message: message.startswith("within 0.75 m of "), "0.75")
    rospy.set_param("/ndtree_map/clear_radius", -1.0)
    said["refused"] = radius_until(lambda message: any("-1.0" in one for one in logged), "a warning")
    said["warning"] = next(one for one in logged if "-1.0" in one)
    print(json.dumps(said))


if __name__ == "__main__":
    main(sys.argv[1])
