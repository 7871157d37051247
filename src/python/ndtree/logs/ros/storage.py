# SPDX-License-Identifier: BSD-3-Clause
"""What the files that bags consist of have in common, of all recorders."""

from __future__ import annotations

import os
import re
import struct
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from typing import IO

from ndtree.base.words import number_of

#: What is called with the damage that reading ran into; it raises it, or notes it and lets reading go on.
OnDamage = Callable[[ValueError], None]

_DDS = re.compile(r"(\w+)::msg::(?:dds_::(?=\w+_$))?(\w+?)_?")
#: What is read of a message of which only stamp and frame are wanted [bytes].
HEAD_BYTES = 512


@dataclass(frozen=True)
class Connection:
    """What a file says of the messages of one topic from one writer.

    `encoding` ({"ros1", "cdr", "json", "protobuf"}): How its messages are packed.
    """

    id: int  # Its number in the file.
    topic: str
    type: str  # As ROS 2 spells it: package/msg/Name.
    encoding: str
    definition: str | None = None  # The text of its type where the file has it in the form of .msg files.
    name: str = ""  # The type's own name, where `type` is the one of ROS that says the same.
    schema: bytes = b""  # Of messages packed by protobuf, the descriptors of their types.


@dataclass(frozen=True)
class Raw:
    """A message as it was recorded, or with less than all of `data` its beginning.

    `received` is when it was recorded [ns].
    """

    connection: Connection
    received: int
    data: bytes


class Storage(ABC):
    """One file of a bag, open for reading.

    `path`: How errors call it: where a file that was unpacked came from.
    `counts`: Messages of each connection.
    `span` (int, int) or None: When the first and the last message were recorded [ns]; None where there is
        none.
    `damage`: Why the file was read without its index, and what is missing then.
    `unread`: Those whose messages are packed so that no library can read them; `type` is as the file spells
        it.
    """

    def __init__(self, name: str) -> None:
        self.path = name
        self.connections: list[Connection] = []
        self.counts: dict[int, int] = {}
        self.span: tuple[int, int] | None = None
        self.damage: str | None = None
        self.unread: list[Connection] = []

    @abstractmethod
    def messages(self, ids: Collection[int], heads: Collection[int], on_damage: OnDamage) -> Iterator[Raw]:
        """Messages of some connections, in the order of recording; of `heads` the beginnings are enough."""

    @abstractmethod
    def close(self) -> None:
        """Nothing can be read afterwards."""

    def _wanted(self, ids: Collection[int], heads: Collection[int]) -> dict[int, Connection]:
        return {one.id: one for one in self.connections if one.id in ids or one.id in heads}

    def _unreadable(self, reason: str, what: str = "") -> ValueError:
        """The error of bytes that are no bag, all of them or a part."""
        return ValueError(f"{self.path}: {what}cannot be read as a ROS bag ({reason}), expected a whole one")

    def _note_damage(self, what: str, remedy: str = "") -> None:
        """After all that can be found was counted."""
        self.damage = f"{what}: {number_of(sum(self.counts.values()), 'message')} found in it{remedy}"

    def _count(self, id: int, received: int) -> None:
        """Note a message that was found."""
        self.counts[id] = self.counts.get(id, 0) + 1
        self.span = (received, received) if self.span is None else (
            min(self.span[0], received), max(self.span[1], received)
        )  # fmt: skip


class FileStorage(Storage):
    """One that is read through a file object, which `_open` finds at its beginning."""

    def __init__(self, path: str, name: str) -> None:
        super().__init__(name)
        self._file: IO[bytes] = open(path, "rb")
        self._size = os.fstat(self._file.fileno()).st_size  # No record is longer.
        try:
            self._open()
        except BaseException:
            self._file.close()
            raise

    @abstractmethod
    def _open(self) -> None:
        """Find connections, counts and span."""

    def close(self) -> None:
        self._file.close()


def ros2_type(name: str) -> str:
    """A type's name as ROS 2 spells it, also where it is as DDS does: package::msg::dds_::Name_."""
    if (dds := _DDS.fullmatch(name)) is not None:
        return f"{dds[1]}/msg/{dds[2]}"
    package, _, type_ = name.rpartition("/")
    return name if "/msg" in package else f"{package}/msg/{type_}"


def line_of(error: Exception) -> str:
    """What an exception says, in one line; its kind where it says nothing."""
    if isinstance(error, KeyError) and error.args:  # A field of a record.
        name = error.args[0]
        return f"no {name.decode('utf-8', 'replace') if isinstance(name, bytes) else name} in a record"
    if isinstance(error, struct.error) or type(error).__name__ == "EndOfFile":
        return "it ends too early"
    return " ".join(str(error).split())[:200] or type(error).__name__
