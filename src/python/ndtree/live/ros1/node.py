# SPDX-License-Identifier: BSD-3-Clause
"""The node ``ndtree_map`` of ROS 1: listens to sensors and transforms, maps, and publishes the map."""

from __future__ import annotations

import threading
import time
from typing import Any

import rospy
from geometry_msgs.msg import PolygonStamped
from nav_msgs.srv import GetMap, GetMapResponse, GetPlan, LoadMap
from std_srvs.srv import Empty, EmptyResponse, Trigger

from ndtree.live.ros.map_service import TICK, MapService
from ndtree.live.ros.messages import class_of, optional_class
from ndtree.live.ros.middleware import Level, Publisher
from ndtree.live.ros.parameters import CHANGING, ROWS, config_of, followed
from ndtree.live.ros.services import OCTOMAP_SERVICES
from ndtree.live.ros1.parameters import Parameters
from ndtree.live.ros1.sources import Sources
from ndtree.logs.ros.storage import Raw

#: Subscribers have so long to take the last messages when the node ends [s].
DELIVERY = 5.0
#: How often the node asks the master for new topics [s].
ASKS = 0.5
_SAY = {Level.info: rospy.loginfo, Level.warning: rospy.logwarn, Level.error: rospy.logerr}


def own(name: str) -> str:
    """A name as rospy spells it: those of the node begin with a tilde alone."""
    return "~" + name[2:] if name.startswith("~/") else name


class _Publisher:
    def __init__(self, kind: Any, topic: str, depth: int | None) -> None:
        self._publisher = rospy.Publisher(
            own(topic), kind, latch=depth is None, queue_size=1 if depth is None else depth, tcp_nodelay=True
        )
        self.topic: str = self._publisher.resolved_name
        self.publish = self._publisher.publish

    def listeners(self) -> int:
        return int(self._publisher.get_num_connections())

    def deliver(self, until: float) -> None:
        """Wait until a time [s] at most until all that waits is written.

        rospy has no function for that, and forgets what waits when it ends: a mark is put behind it.
        """
        marks = []
        for connection in list(self._publisher.impl.connections):
            if hasattr(connection, "_queue"):
                marks.append(_Mark())
                with connection._lock:
                    connection._queue.append(marks[-1])
                    connection._cond_data_available.notify()
        for mark in marks:
            mark.written.wait(max(until - time.monotonic(), 0.0))


class _Mark(bytes):
    """No bytes; rospy asks how many when it has written them."""

    def __init__(self) -> None:
        self.written = threading.Event()

    def __len__(self) -> int:
        self.written.set()
        return 0


class MapNode:
    """Maps what sensors publish; see the table of its parameters in `ndtree.live.ros.parameters`.

    Raises ValueError, OSError, WrongOption if no map can be made of the parameters.
    """

    def __init__(self) -> None:
        self.name: str = rospy.get_name()
        self._parameters = Parameters(rospy.get_param("~", {}), _current, rospy.logwarn)
        for row in ROWS:
            if row.key in CHANGING:
                rospy.set_param(f"~{row.key}", self._parameters.value(row.key))
        self._publishers: list[_Publisher] = []
        self._map = MapService(self)
        self._sources = Sources(
            self._put, {**config_of(self.value).reading, **followed(self.value("follow"))}
        )
        self._services = [
            rospy.Service("~save", Trigger, lambda request: self._map.services.save()),
            rospy.Service(
                "~load", LoadMap, lambda request: {"result": int(self._map.services.load(request.map_url))}
            ),
            rospy.Service("~reset", Empty, self._reset),
            rospy.Service("~clear_around", Trigger, lambda request: self._map.services.clear_around()),
            rospy.Service(
                "~get_map", GetMap, lambda request: GetMapResponse(*filter(None, [self._map.services.grid()]))
            ),
            rospy.Service("~get_plan", GetPlan, lambda request: {"plan": self._map.services.plan(request)}),
        ]
        get_octomap, query = (optional_class(f"octomap_msgs/srv/{name}") for name in OCTOMAP_SERVICES)
        if query is not None:
            self._services += [
                rospy.Service("~octomap_full", get_octomap, lambda request: self._octomap(False)),
                rospy.Service("~octomap_binary", get_octomap, lambda request: self._octomap(True)),
                rospy.Service("~clear_bbox", query, self._clear_bbox),
            ]
        self._boxes = rospy.Subscriber("~clear_box", PolygonStamped, self._clear_box, queue_size=10)
        self._asked = self._diagnosed = -1e9

    def value(self, name: str) -> Any:
        return self._parameters.value(name)

    def map_options(self) -> dict[str, Any]:
        return self._parameters.map_options

    def publisher(self, kind: Any, topic: str, *, depth: int | None = None) -> Publisher:
        self._publishers.append(_Publisher(kind, topic, depth))
        return self._publishers[-1]

    def now(self) -> float:
        return float(rospy.get_time())

    def say(self, level: Level, text: str) -> None:
        _SAY[level](text)

    def run(self, ended: threading.Event) -> None:
        """Map until the node is asked to end."""
        while not ended.wait(TICK) and not rospy.is_shutdown():
            self._tick()

    def end(self) -> None:
        """Map what has arrived, save, and wait a while until subscribers have the last map."""
        self._sources.close()
        self._map.close(self._sources.lost)
        until = time.monotonic() + DELIVERY
        for publisher in self._publishers:
            publisher.deliver(until)

    def _tick(self) -> None:
        chosen = self._map.tick()
        if chosen is not None:
            self._sources.choose(chosen)
        now = time.monotonic()
        if now - self._asked >= ASKS:
            self._asked = now
            self._sources.look({one.topic for one in self._publishers})
        if now - self._diagnosed >= self.value("diagnostics_period"):
            self._diagnosed = now
            self._map.diagnose(self._sources.lost)

    def _put(self, raw: Raw) -> None:
        try:
            self._map.put(raw)
        except RuntimeError:  # It is closed, and this message came at the same moment.
            return

    def _reset(self, request: Any) -> EmptyResponse:
        self._map.services.reset()
        return EmptyResponse()

    def _octomap(self, binary: bool) -> list[Any]:
        """Fields of an answer: none, where there is no map."""
        found = self._map.services.octomap(binary=binary)
        return [class_of("octomap_msgs/msg/Octomap")() if found is None else found]

    def _clear_bbox(self, request: Any) -> list[Any]:
        self._map.services.clear_box("", [request.min, request.max])
        return []

    def _clear_box(self, message: PolygonStamped) -> None:
        self._map.services.clear_box(message.header.frame_id, message.polygon.points)


def _current(name: str, default: Any) -> Any:
    return rospy.get_param_cached(f"~{name}", default)
