# SPDX-License-Identifier: BSD-3-Clause
"""What the map needs of a node, whatever its ROS is."""

from __future__ import annotations

from enum import Enum
from typing import Any, Protocol


class Level(Enum):
    """How much something said matters."""

    info = "info"
    warning = "warning"
    error = "error"


class Publisher(Protocol):
    """Publishes messages of one topic."""

    def publish(self, message: Any) -> None:
        """Send one to all that listen."""

    def listeners(self) -> int:
        """How many listen."""


class Middleware(Protocol):
    """A node of ROS 1 or ROS 2: parameters, topics, a clock, and somebody to talk to.

    `name`: With its namespace.
    """

    name: str

    def value(self, name: str) -> Any:
        """Of a parameter, as it is now."""

    def map_options(self) -> dict[str, Any]:
        """Options of the map that were given."""

    def publisher(self, kind: Any, topic: str, *, depth: int | None = None) -> Publisher:
        """Of a topic; with a depth, that number may wait, else who comes later gets the last one."""

    def now(self) -> float:
        """The time [s]: by the clock on the wall, or that of a simulator."""

    def say(self, level: Level, text: str) -> None:
        """Write to the log."""
