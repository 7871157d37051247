# SPDX-License-Identifier: BSD-3-Clause
"""What the node listens to: messages as they are on the wire, which the readers of bags decode."""

from __future__ import annotations

import posixpath
from collections.abc import Callable
from pathlib import Path
from typing import Any

import rclpy.subscription
from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from ndtree.live.ros.messages import class_of
from ndtree.live.ros.topics import TRANSFORMS, Numbers, Wanted, is_superfluous
from ndtree.logs.ros.messages.beams import CAMERA_INFO, SENSORS
from ndtree.logs.ros.storage import Connection, Raw

#: Whether rclpy tells what number the publisher has given a message: of ROS 2 Humble and before it does not.
TELLS_NUMBERS = hasattr(rclpy.subscription, "MessageInfo")
#: Messages that may wait to be taken, of sensors and of transforms.
SENSOR_DEPTH, POSE_DEPTH = 50, 1000


class Sources:
    """Subscriptions of a node to sensors, transforms and poses.

    `put`: Is given each Raw message.
    `reading`: What a user said of sensors and frames, as for `ndtree.read`.
    `reliable`: Whether lost messages are asked for again.
    `queue`: If so, messages of each sensor that may wait to be taken, at least.
    Attributes:
    `lost`: Messages that did not come: by the numbers that publishers give them, where the middleware tells
        these, else those of which it says itself that it lost them, which may be fewer.
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
        self._node, self._put, self._wanted = node, put, Wanted(reading)
        self.reliable = reliable
        self.depth = max(SENSOR_DEPTH, queue) if reliable else SENSOR_DEPTH
        self._subscriptions: dict[str, Any] = {}
        self.lost = 0
        self.missing: dict[str, str] = {}
        for topic, type in TRANSFORMS.items():
            self._subscribe(topic, type)

    def look(self) -> None:
        """Listen to what has appeared since the last time."""
        own = {posixpath.join("/", one.topic_name) for one in self._node.publishers}
        for topic, types in self._node.get_topic_names_and_types():
            if topic not in self._subscriptions and topic not in own and types:
                others = [one.connection.type for one in self._subscriptions.values()]
                if self._wanted.is_wanted(topic, types[0], others):
                    self._subscribe(topic, types[0])

    def choose(self, topics: set[str]) -> None:
        """From now on listen to these topics of sensors and poses, and to no others."""
        self._wanted.choose()
        for topic, one in list(self._subscriptions.items()):
            if is_superfluous(topic, one.connection.type, topics):
                self._node.destroy_subscription(one.subscription)
                del self._subscriptions[topic]

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

    def close(self) -> None:
        """Listen to nothing."""
        for one in self._subscriptions.values():
            self._node.destroy_subscription(one.subscription)
        self._subscriptions.clear()

    def _subscribe(self, topic: str, type: str) -> None:
        try:
            kind = class_of(type)
        except (ImportError, AttributeError) as error:
            self.missing[type] = str(error)
            return
        self._subscriptions[topic] = _Subscription(self, topic, type, kind)


class _Subscription:
    def __init__(self, sources: Sources, topic: str, type: str, kind: Any) -> None:
        self._sources, self._node = sources, sources._node
        self.connection = Connection(0, topic, type, "cdr", _definition(type))
        self.is_sensor = type in SENSORS
        self._numbers = Numbers()
        qos = QoSProfile(depth=sources.depth if self.is_sensor else POSE_DEPTH)
        if self.is_sensor and not sources.reliable:
            qos.reliability = ReliabilityPolicy.BEST_EFFORT
        if type == CAMERA_INFO:
            qos.reliability = ReliabilityPolicy.BEST_EFFORT
        if posixpath.basename(topic) == "tf_static":
            qos.durability = DurabilityPolicy.TRANSIENT_LOCAL
        self.subscription = self._node.create_subscription(
            kind,
            topic,
            self._received if TELLS_NUMBERS else lambda data: self._received(data, {}),
            qos,
            raw=True,
            event_callbacks=SubscriptionEventCallbacks(message_lost=self._lost),
        )

    def take_all(self) -> None:
        """Take what has arrived, in its order."""
        with self.subscription.handle:
            while (
                taken := self.subscription.handle.take_message(self.subscription.msg_type, True)
            ) is not None:
                self._pass_on(*taken[:2])

    def _received(self, data: bytes, info: Any) -> None:
        if self.is_sensor:
            self._sources.take_poses()
        self._pass_on(data, info)
        if not self.is_sensor:
            self.take_all()

    def _pass_on(self, data: bytes, info: Any) -> None:
        if self.is_sensor:
            self._count(info)
        now = self._node.get_clock().now().nanoseconds
        self._sources._put(Raw(self.connection, now, data))

    def _count(self, info: Any) -> None:
        """Count what is missing between two messages of a publisher."""
        number = info.get("publication_sequence_number") if isinstance(info, dict) else None
        if number is None:
            return
        self._sources.lost += self._numbers.add(repr(info.get("publisher_gid")), number)

    def _lost(self, event: Any) -> None:
        self._sources.lost += 0 if self._numbers else event.total_count_change


def _definition(type: str) -> str | None:
    """The text of a type as it is installed: other versions of ROS have other fields."""
    package, _, name = type.split("/")
    try:
        return Path(get_package_share_directory(package), "msg", f"{name}.msg").read_text(encoding="utf-8")
    except (PackageNotFoundError, OSError):
        return None
