# SPDX-License-Identifier: BSD-3-Clause
"""What the files that bags consist of have in common, and what is packed in them: unpacked within bounds."""

from __future__ import annotations

import bz2
import heapq
import io
import math
import os
import re
import struct
import zlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass
from typing import IO, Any

from ndtree.base.words import number_of
from ndtree.logs.core.failures import one_line
from ndtree.logs.core.plain_file import FREE_BYTES, MOST_PACKED

#: What is called with the damage that reading ran into; it raises it, or notes it and lets reading go on.
OnDamage = Callable[[ValueError], None]

_DDS = re.compile(r"(\w+)::msg::(?:dds_::(?=\w+_$))?(\w+?)_?")


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
    """A message as it was recorded."""

    connection: Connection
    received: int  # [ns]
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
    def messages(self, topics: Collection[str], on_damage: OnDamage) -> Iterator[Raw]:
        """Messages of some topics, in the order of recording."""

    def close(self) -> None:
        """Nothing can be read afterwards."""
        return

    def _wanted(self, topics: Collection[str]) -> dict[int, Connection]:
        return {one.id: one for one in self.connections if one.topic in topics}

    def _unreadable(self, reason: str, what: str = "") -> ValueError:
        """The error of bytes that are no bag, all of them or a part."""
        return ValueError(f"{self.path}: {what}cannot be read as a ROS bag ({reason}), expected a whole one")

    def _note_damage(self, what: str, remedy: str = "") -> None:
        """After all that can be found was counted."""
        self.damage = f"{what}: {number_of(sum(self.counts.values()), 'message')} found in it{remedy}"

    def _count(self, id: int, received: int) -> None:
        self.counts[id] = self.counts.get(id, 0) + 1
        self._cover(received, received)

    def _cover(self, first: int, last: int) -> None:
        span = self.span or (first, last)
        self.span = min(span[0], first), max(span[1], last)


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
    return one_line(error)


#: No message of ROS, and so no chunk that anybody records, is longer.
MOST_BYTES = 1 << 30
_PART = 1 << 24
_WINDOW = 1 << 27  #: Of zstd, where its header does not say how much it packs.
_PACKINGS = ("bz2", "lz4", "zstd", "zlib")


class Damaged(Exception):
    """Bytes that are not what they should be."""


@dataclass
class Chunk:
    """Messages that lie together in a file: where they begin, and of which connections they are.

    `ids`: Empty where that is not known.
    """

    position: int
    first: int = 0  # When the first was recorded [ns].
    ids: Collection[int] = ()


def in_order(rows: Iterable[tuple[float, float, Raw | None]]) -> Iterator[Raw]:
    """Messages by their times: rows of a time, one before which nothing follows, and a message or none."""
    waiting: list[tuple[float, int, Raw]] = []
    for number, (when, begin, raw) in enumerate(rows):
        if raw is not None:
            heapq.heappush(waiting, (when, number, raw))
        while waiting and waiting[0][0] < begin:
            yield heapq.heappop(waiting)[2]
    while waiting:
        yield heapq.heappop(waiting)[2]


def of_chunks(
    chunks: Iterable[Chunk], ids: Collection[int], messages_of: Callable[[Chunk], Iterable[Raw]]
) -> Iterator[Raw]:
    """Messages of chunks with some connections in the order of recording, also where they overlap."""

    def rows() -> Iterator[tuple[float, float, Raw | None]]:
        for chunk in sorted(chunks, key=lambda one: one.first):
            if not chunk.ids or not set(chunk.ids).isdisjoint(ids):
                yield chunk.first, chunk.first, None
                for raw in messages_of(chunk):
                    yield raw.received, -math.inf, raw

    return in_order(rows())


def most_bytes_of(packed: int) -> int:
    """The most bytes that `packed` bytes may stand for."""
    return min(FREE_BYTES + MOST_PACKED * packed, MOST_BYTES)


def unpacked(packing: str, data: bytes, size: int) -> bytes:
    """What is in a chunk that says that it unpacks to `size` bytes.

    Raises Damaged if it does not, or that is more than any chunk holds.
    """
    if packing in ("", "none"):
        return data
    if packing not in _PACKINGS:
        raise Damaged(f"compression {packing!r}, expected none, {', '.join(_PACKINGS)}")
    most = most_bytes_of(len(data))
    if size > most:
        raise Damaged(f"{len(data)} bytes that unpack to {size}, expected at most {most}")
    content = _beginning(packing, data, size + 1)
    if len(content) != size:
        found = "more" if len(content) > size else str(len(content))
        raise Damaged(f"it unpacks to {found} bytes, expected {size}, as it says")
    return content


def unpacked_message(data: bytes) -> bytes:
    """What zstd has packed by itself, which does not say how much it is.

    Raises Damaged if it is cut off, or more than any message.
    """
    most = most_bytes_of(len(data))
    content = _beginning("zstd", data, most + 1)
    if len(content) > most:
        raise Damaged(f"{len(data)} bytes unpack to more than {most}")
    return content


def _beginning(packing: str, data: bytes, most: int) -> bytes:
    """What is unpacked, at most `most` bytes of it."""
    parts: list[bytes] = []
    try:
        if packing == "zstd":
            import zstandard

            # A frame that says how long it is may have a window as long.
            unpacker = zstandard.ZstdDecompressor(max_window_size=max(most, _WINDOW))
            with unpacker.stream_reader(io.BytesIO(data)) as file:
                while most > 0 and (part := file.read(min(most, _PART))):
                    parts.append(part)
                    most -= len(part)
            return b"".join(parts)
        while data and most > 0:
            stream = _decompressor(packing)
            parts.append(stream.decompress(data, most))
            most -= len(parts[-1])
            data = stream.unused_data if packing == "bz2" and stream.eof else b""
    except (ImportError, MemoryError):
        raise
    except Exception as error:  # Libraries at the mercy of foreign bytes.
        raise Damaged(line_of(error)) from None
    return b"".join(parts)


def _decompressor(packing: str) -> Any:
    if packing == "lz4":
        from lz4 import frame

        return frame.LZ4FrameDecompressor()
    return bz2.BZ2Decompressor() if packing == "bz2" else zlib.decompressobj(zlib.MAX_WBITS | 32)
