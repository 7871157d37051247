# SPDX-License-Identifier: BSD-3-Clause
"""The node ``ndtree_map`` of ROS 1: listens to sensors and transforms, maps, and publishes the map."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Sequence
from typing import Any

import rospy
from geometry_msgs.msg import PolygonStamped

from ndtree.live.ros.map_service import TICK, MapService
from ndtree.live.ros.middleware import Level, Publisher
from ndtree.live.ros.parameters import CHANGING, ROWS
from ndtree.live.ros1.parameters import Parameters
from ndtree.live.ros1.sources import Sources
from ndtree.logs.ros.storage import Raw

#: Subscribers have so long to take the last messages when the node ends [s].
DELIVERY = 5.0
#: How often the node asks the master for new topics [s].
ASKS = 0.5
#: What rospy raises.
ERRORS = (rospy.ROSException,)
_SAY = {Level.info: rospy.loginfo, Level.warning: rospy.logwarn, Level.error: rospy.logerr}


def begin(arguments: Sequence[str] | None) -> None:
    """Make this process a node."""
    rospy.init_node("ndtree_map", argv=sys.argv if arguments is None else arguments, disable_signals=True)


def finish() -> None:
    """End it."""
    rospy.signal_shutdown("the node was asked to end")


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
        self._sources = Sources(self._put, self._map.reading, lambda: {one.topic for one in self._publishers})
        services = self._map.services
        self._offered = [
            rospy.Service(f"~{name}", kind, answer) for name, (kind, answer) in services.offered().items()
        ]
        self._boxes = rospy.Subscriber("~clear_box", PolygonStamped, services.clear, queue_size=10)
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
            self._sources.look()
        if now - self._diagnosed >= self.value("diagnostics_period"):
            self._diagnosed = now
            self._map.diagnose(self._sources.lost)

    def _put(self, raw: Raw) -> None:
        try:
            self._map.put(raw)
        except RuntimeError:  # It is closed, and this message came at the same moment.
            return


def _current(name: str, default: Any) -> Any:
    return rospy.get_param_cached(f"~{name}", default)
