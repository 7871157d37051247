# SPDX-License-Identifier: BSD-3-Clause
"""What the node listens to: messages as they are on the wire, which the readers of bags decode."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import rospy

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
