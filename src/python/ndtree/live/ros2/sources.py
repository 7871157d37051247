# SPDX-License-Identifier: BSD-3-Clause
"""What the node listens to: messages as they are on the wire, which the readers of bags decode."""

from __future__ import annotations

import posixpath
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import rclpy.subscription
from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from ndtree.live.ros.messages import class_of
from ndtree.live.ros.topics import Listener, Numbers
from ndtree.logs.ros.messages.beams import CAMERA_INFO, SENSORS
from ndtree.logs.ros.storage import Connection, Raw

#: Whether rclpy tells what number the publisher has given a message: of ROS 2 Humble and before it does not.
TELLS_NUMBERS = hasattr(rclpy.subscription, "MessageInfo")
#: Messages that may wait to be taken, of sensors and of transforms.
SENSOR_DEPTH, POSE_DEPTH = 50, 1000


class Sources(Listener):
    """Subscriptions of a node to sensors, transforms and poses.

    `lost` counts by the numbers that publishers give messages, where the middleware tells these, else what
    it says that it lost, which may be fewer.

    `put`: Is given each Raw message.
    `reading`: As for `Listener`.
    `reliable`: Whether lost messages are asked for again.
    `queue`: If so, messages of each sensor that may wait to be taken, at least.
    Attributes:
    `missing`: By type, why its topics cannot be listened to.
    """

    def __init__(
        self,
        node: Node,
        put: Callable[[Raw], None],
        reading: dict[str, Any],
        *,
        reliable: bool,
        queue: int,
    ) -> None:
        self.node, self.put, self.reliable = node, put, reliable
        self.depth = max(SENSOR_DEPTH, queue) if reliable else SENSOR_DEPTH
        self.missing: dict[str, str] = {}
        super().__init__(reading)

    def _published(self) -> Iterator[tuple[str, str]]:
        own = {posixpath.join("/", one.topic_name) for one in self.node.publishers}
        found = self.node.get_topic_names_and_types()
        return ((topic, types[0]) for topic, types in found if topic not in own and types)

    def _subscribe(self, topic: str, type: str) -> None:
        try:
            kind = class_of(type)
        except (ImportError, AttributeError) as error:
            self.missing[type] = str(error)
            return
        self._subscriptions[topic] = _Subscription(self, topic, type, kind)

    def take_poses(self) -> None:
        """Take all transforms and poses that have arrived: before a measurement, so that none waits for them.

        The executor takes one message of each subscription after the other, and on a busy machine it may be
        far behind with what comes often.
        """
        for one in self._subscriptions.values():
            if not one.is_sensor:
                one.take_all()

    def take_all(self) -> None:
        """Take all that has arrived, measurements last."""
        self.take_poses()
        for one in self._subscriptions.values():
            if one.is_sensor:
                one.take_all()


class _Subscription:
    def __init__(self, sources: Sources, topic: str, type: str, kind: Any) -> None:
        self._sources, self.type = sources, type
        self._connection = Connection(0, topic, type, "cdr", _definition(type))
        self.is_sensor = type in SENSORS
        self._numbers, self._said_lost = Numbers(), 0
        qos = QoSProfile(depth=sources.depth if self.is_sensor else POSE_DEPTH)
        if type == CAMERA_INFO or (self.is_sensor and not sources.reliable):
            qos.reliability = ReliabilityPolicy.BEST_EFFORT
        if posixpath.basename(topic) == "tf_static":
            qos.durability = DurabilityPolicy.TRANSIENT_LOCAL
        self._subscription = sources.node.create_subscription(
            kind,
            topic,
            self._received if TELLS_NUMBERS else lambda data: self._received(data, {}),
            qos,
            raw=True,
            event_callbacks=SubscriptionEventCallbacks(message_lost=self._lost),
        )

    @property
    def lost(self) -> int:
        return self._numbers.lost + self._said_lost

    def close(self) -> None:
        self._sources.node.destroy_subscription(self._subscription)

    def take_all(self) -> None:
        """Take what has arrived, in its order."""
        with self._subscription.handle:
            while (
                taken := self._subscription.handle.take_message(self._subscription.msg_type, True)
            ) is not None:
                self._pass_on(*taken[:2])

    def _received(self, data: bytes, info: Any) -> None:
        if self.is_sensor:
            self._sources.take_poses()
        self._pass_on(data, info)
        if not self.is_sensor:
            self.take_all()

    def _pass_on(self, data: bytes, info: Any) -> None:
        number = info.get("publication_sequence_number") if isinstance(info, dict) else None
        if self.is_sensor and number is not None:
            self._numbers.add(repr(info.get("publisher_gid")), number)
        self._sources.put(Raw(self._connection, self._sources.node.get_clock().now().nanoseconds, data))

    def _lost(self, event: Any) -> None:
        self._said_lost += 0 if self._numbers else event.total_count_change


def _definition(type: str) -> str | None:
    """The text of a type as it is installed: other versions of ROS have other fields."""
    package, _, name = type.split("/")
    try:
        return Path(get_package_share_directory(package), "msg", f"{name}.msg").read_text(encoding="utf-8")
    except (PackageNotFoundError, OSError):
        return None
