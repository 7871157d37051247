# SPDX-License-Identifier: BSD-3-Clause
"""Which topics a node listens to."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable
from typing import Any

from ndtree.logs.poses.transforms import plain
from ndtree.logs.ros.messages.beams import CAMERA_INFO, IMAGES, SENSORS
from ndtree.logs.ros.survey import ODOMETRY, POSES, TF

#: Always, whether somebody publishes them or not.
TRANSFORMS = {"/tf": TF[0], "/tf_static": TF[0]}


class Listener(ABC):
    """Listens to all topics that may be of use, until it is decided which are.

    `reading`: What a user said of sensors and frames, as for `ndtree.read`; and as ``follow`` the topic of a
        Path.
    """

    def __init__(self, reading: dict[str, Any]) -> None:
        self._topics = {plain(one.partition("@")[0]) for one in reading.get("topic", ())}
        self._poses = {plain(reading[name]) for name in ("odometry", "poses", "follow") if name in reading}
        self._is_chosen = False
        self._subscriptions: dict[str, Any] = {}
        self._lost = 0
        for topic, type in TRANSFORMS.items():
            self._subscribe(topic, type)

    @abstractmethod
    def _published(self) -> Iterable[tuple[str, str]]:
        """All topics but the node's own, and their types."""

    @abstractmethod
    def _subscribe(self, topic: str, type: str) -> None:
        """Add what listens to a topic: it has a `type`, messages that it has `lost`, and a `close`."""

    @property
    def lost(self) -> int:
        """Messages that did not come."""
        return self._lost + sum(int(one.lost) for one in self._subscriptions.values())

    def look(self) -> None:
        """Listen to what has appeared since the last time."""
        for topic, type in self._published():
            if topic not in self._subscriptions and self._is_wanted(topic, type):
                self._subscribe(topic, type)

    def _is_wanted(self, topic: str, type: str) -> bool:
        if type in TF or plain(topic) in self._poses:
            return True
        if type in SENSORS:
            return plain(topic) in self._topics or not (self._topics or self._is_chosen)
        if type == CAMERA_INFO:
            return any(one.type in IMAGES for one in self._subscriptions.values())
        return type == ODOMETRY and not (self._poses or self._is_chosen)

    def choose(self, topics: set[str]) -> None:
        """From now on listen to these topics of sensors and poses, and to no others but transforms."""
        self._is_chosen = True
        for topic, one in list(self._subscriptions.items()):
            if plain(topic) not in topics and (one.type in SENSORS or one.type in POSES):
                self._leave(topic)

    def close(self) -> None:
        """Listen to nothing."""
        for topic in list(self._subscriptions):
            self._leave(topic)

    def _leave(self, topic: str) -> None:
        one = self._subscriptions.pop(topic)
        one.close()
        self._lost += one.lost


class Numbers:
    """Counts what is missing between messages, by the numbers that publishers give them."""

    def __init__(self) -> None:
        self.lost = 0
        self._last: dict[str, int] = {}

    def __bool__(self) -> bool:
        """Whether there were any."""
        return bool(self._last)

    def add(self, publisher: str, number: int) -> None:
        """Take note of a message; one that begins again, or comes late, tells nothing."""
        last = self._last.get(publisher, number)
        self._last[publisher] = max(last, number)
        self.lost += max(number - last - 1, 0)
