# SPDX-License-Identifier: BSD-3-Clause
"""Which topics a node listens to."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from ndtree.logs.poses.transforms import plain
from ndtree.logs.ros.messages.beams import CAMERA_INFO, IMAGES, SENSORS
from ndtree.logs.ros.survey import ODOMETRY, POSES, TF

#: Always, whether somebody publishes them or not.
TRANSFORMS = {"/tf": TF[0], "/tf_static": TF[0]}


class Wanted:
    """Topics that are wanted: all that may be of use, until it is decided which are.

    `reading`: What a user said of sensors and frames, as for `ndtree.read`; and as ``follow`` the topic of a
        Path.
    """

    def __init__(self, reading: dict[str, Any]) -> None:
        self._topics = {plain(one.partition("@")[0]) for one in reading.get("topic", ())}
        self._poses = {plain(reading[name]) for name in ("odometry", "poses", "follow") if name in reading}
        self._is_chosen = False

    def is_wanted(self, topic: str, type: str, others: Iterable[str]) -> bool:
        """Whether to listen to a topic of a type, beside topics of other types."""
        if type in TF or plain(topic) in self._poses:
            return True
        if type in SENSORS:
            return plain(topic) in self._topics or not (self._topics or self._is_chosen)
        if type == CAMERA_INFO:
            return any(one in IMAGES for one in others)
        return type == ODOMETRY and not (self._poses or self._is_chosen)

    def choose(self) -> None:
        """From now on nothing new is wanted but transforms."""
        self._is_chosen = True


def is_superfluous(topic: str, type: str, chosen: set[str]) -> bool:
    """Whether a topic is of no use once sensors and topics with poses were chosen."""
    return plain(topic) not in chosen and (type in SENSORS or type in POSES)


class Numbers:
    """Counts what is missing between messages, by the numbers that publishers give them."""

    def __init__(self) -> None:
        self.lost = 0
        self._last: dict[str, int] = {}

    def __bool__(self) -> bool:
        """Whether there were any."""
        return bool(self._last)

    def add(self, publisher: str, number: int) -> int:
        """How many are missing before a message; one that begins again, or comes late, tells nothing."""
        last = self._last.get(publisher, number)
        self._last[publisher] = max(last, number)
        missing = max(number - last - 1, 0)
        self.lost += missing
        return missing
