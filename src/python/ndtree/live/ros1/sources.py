# SPDX-License-Identifier: BSD-3-Clause
"""What the node listens to: messages as they are on the wire, which the readers of bags decode."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import rospy

from ndtree.live.ros.topics import TRANSFORMS, Numbers, Wanted, is_superfluous
from ndtree.logs.ros.messages.beams import SENSORS
from ndtree.logs.ros.storage import Connection, Raw, ros2_type

#: Bytes that are taken from a socket at once.
BUFFER = 1 << 22


class Sources:
    """Subscriptions to sensors, transforms and poses.

    Messages come by TCP, each publisher's in a thread of its own: none is lost on the way. A publisher drops
    some where its queue is full, which the numbers in their headers tell; the queue of the mapper bounds how
    many wait.

    `put`: Is given each Raw message.
    `reading`: What a user said of sensors and frames, as for `ndtree.read`.
    """

    def __init__(self, put: Callable[[Raw], None], reading: dict[str, Any]) -> None:
        self._put, self._wanted = put, Wanted(reading)
        self._subscriptions: dict[str, _Subscription] = {}
        self._lost = 0
        self._published: set[str] = set()
        for topic, type in TRANSFORMS.items():
            self._subscribe(topic, type)

    def look(self, own: set[str]) -> None:
        """Listen to what has appeared since the last time, but to topics of its own."""
        for topic, type in rospy.get_published_topics():
            if topic in self._subscriptions or topic in own:
                continue
            type = ros2_type(type)
            if self._wanted.is_wanted(topic, type, [one.type for one in self._subscriptions.values()]):
                self._subscribe(topic, type)

    def choose(self, topics: set[str]) -> None:
        """From now on listen to these topics of sensors and poses, and to no others."""
        self._wanted.choose()
        for topic, one in list(self._subscriptions.items()):
            if is_superfluous(topic, one.type, topics):
                one.close()
                del self._subscriptions[topic]

    @property
    def lost(self) -> int:
        """Messages of sensors that publishers have sent and that did not come."""
        return self._lost + sum(one.numbers.lost for one in self._subscriptions.values())

    def close(self) -> None:
        """Listen to nothing."""
        self._lost = self.lost
        for one in self._subscriptions.values():
            one.close()
        self._subscriptions.clear()

    def _subscribe(self, topic: str, type: str) -> None:
        self._subscriptions[topic] = _Subscription(self._put, topic, type)


class _Subscription:
    def __init__(self, put: Callable[[Raw], None], topic: str, type: str) -> None:
        self._put, self._topic, self.type = put, topic, type
        self._connections: dict[tuple[str, str], Connection] = {}
        self.numbers = Numbers()
        self._subscriber = rospy.Subscriber(
            topic, rospy.AnyMsg, self._received, buff_size=BUFFER, tcp_nodelay=True
        )

    def close(self) -> None:
        self._subscriber.unregister()

    def _received(self, message: Any) -> None:
        said = message._connection_header
        key = said["type"], said["md5sum"]
        connection = self._connections.get(key)
        if connection is None:
            definition = said.get("message_definition") or None
            connection = Connection(0, self._topic, ros2_type(key[0]), "ros1", definition)
            self._connections[key] = connection
        if self.type in SENSORS:  # All begin with a header, and that with the number.
            self.numbers.add(said.get("callerid", ""), int.from_bytes(message._buff[:4], "little"))
        self._put(Raw(connection, rospy.Time.now().to_nsec(), message._buff))
