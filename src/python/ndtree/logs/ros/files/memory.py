# SPDX-License-Identifier: BSD-3-Clause
"""Messages in memory, as a file of a bag: what has arrived so far of a robot that drives."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence

from ndtree.logs.ros.files.bag import Bag
from ndtree.logs.ros.storage import Connection, OnDamage, Raw, Storage


class MemoryFile(Storage):
    """Messages in the order of arrival."""

    def __init__(self, name: str, messages: Sequence[Raw]) -> None:
        super().__init__(name)
        self._messages = messages
        numbers: dict[tuple[str, str, str], int] = {}
        self._ids = []
        for raw in messages:
            one = raw.connection
            key = one.topic, one.type, one.encoding
            if key not in numbers:
                numbers[key] = len(numbers)
                self.connections.append(
                    Connection(numbers[key], one.topic, one.type, one.encoding, one.definition)
                )
            self._ids.append(numbers[key])
            self._count(numbers[key], raw.received)

    def messages(self, ids: Collection[int], heads: Collection[int], on_damage: OnDamage) -> Iterator[Raw]:
        wanted = self._wanted(ids, heads)
        for raw, number in zip(self._messages, self._ids):
            if number in wanted:
                yield Raw(wanted[number], raw.received, raw.data)

    def close(self) -> None:
        self._messages = ()


def bag_of(name: str, messages: Sequence[Raw]) -> Bag:
    """A bag of messages that are in memory already."""
    return Bag(name, [MemoryFile(name, messages)])
