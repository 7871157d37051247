# SPDX-License-Identifier: BSD-3-Clause
"""The node ``ndtree_map`` of ROS 1: listens to sensors and transforms, maps, and publishes the map."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import rospy
from geometry_msgs.msg import PolygonStamped

from ndtree.live.ros.map_service import TICK, MapService
from ndtree.live.ros.middleware import Level, Publisher
from ndtree.live.ros.parameters import CHANGING, ROWS, Parameters
from ndtree.live.ros.topics import Listener, Numbers
from ndtree.logs.ros.messages.beams import SENSORS
from ndtree.logs.ros.storage import Connection, Raw, ros2_type

#: Bytes that are taken from a socket at once.
BUFFER = 1 << 22


class Sources(Listener):
    """Subscriptions to sensors, transforms and poses.

    Messages come by TCP, each publisher's in a thread of its own: none is lost on the way. A publisher drops
    some where its queue is full, which the numbers in their headers tell; the queue of the mapper bounds how
    many wait.

    `put`: Is given each Raw message.
    `reading`: As for `Listener`.
    `own`: Tells the node's own topics.
    """

    def __init__(
        self, put: Callable[[Raw], None], reading: dict[str, Any], own: Callable[[], set[str]]
    ) -> None:
        self._put, self._own = put, own
        super().__init__(reading)

    def _published(self) -> Iterator[tuple[str, str]]:
        own = self._own()
        return ((topic, ros2_type(type)) for topic, type in rospy.get_published_topics() if topic not in own)

    def _subscribe(self, topic: str, type: str) -> None:
        self._subscriptions[topic] = _Subscription(self._put, topic, type)


class _Subscription:
    def __init__(self, put: Callable[[Raw], None], topic: str, type: str) -> None:
        self._put, self._topic, self.type = put, topic, type
        self._connections: dict[tuple[str, str], Connection] = {}
        self._numbers = Numbers()
        self._subscriber = rospy.Subscriber(
            topic, rospy.AnyMsg, self._received, buff_size=BUFFER, tcp_nodelay=True
        )
        self.close = self._subscriber.unregister

    @property
    def lost(self) -> int:
        return self._numbers.lost

    def _received(self, message: Any) -> None:
        said = message._connection_header
        key = said["type"], said["md5sum"]
        connection = self._connections.get(key)
        if connection is None:
            definition = said.get("message_definition") or None
            connection = Connection(0, self._topic, ros2_type(key[0]), "ros1", definition)
            self._connections[key] = connection
        if self.type in SENSORS:  # All begin with a header, and that with the number.
            self._numbers.add(said.get("callerid", ""), int.from_bytes(message._buff[:4], "little"))
        self._put(Raw(connection, rospy.Time.now().to_nsec(), message._buff))


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
