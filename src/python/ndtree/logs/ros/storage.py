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
from typing import IO, Protocol, TypeVar

from ndtree.base.words import number_of
from ndtree.logs.core.failures import one_line
from ndtree.logs.core.plain_file import FREE_BYTES, MOST_PACKED

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
    return one_line(error)


#: No message of ROS, and so no chunk that anybody records, is longer.
MOST_BYTES = 1 << 30
_PART = 1 << 24
_WINDOW = 1 << 27  #: Of zstd, where its header does not say how much it packs.


class Damaged(Exception):
    """Bytes that are not what they should be."""


class Chunk(Protocol):
    """Messages that were recorded one after the other; `first` is when the first one was [ns]."""

    @property
    def first(self) -> int: ...


AnyChunk = TypeVar("AnyChunk", bound=Chunk)


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


def of_chunks(chunks: Iterable[AnyChunk], messages_of: Callable[[AnyChunk], Iterable[Raw]]) -> Iterator[Raw]:
    """Messages of all chunks in the order of recording, also where chunks overlap in time."""

    def rows() -> Iterator[tuple[float, float, Raw | None]]:
        for chunk in sorted(chunks, key=lambda one: one.first):
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
    if packing not in _UNPACKERS:
        raise Damaged(f"compression {packing!r}, expected none, {', '.join(_UNPACKERS)}")
    most = most_bytes_of(len(data))
    if size > most:
        raise Damaged(f"{len(data)} bytes that unpack to {size}, expected at most {most}")
    content = b"".join(_parts(packing, data, size + 1))
    if len(content) != size:
        found = "more" if len(content) > size else str(len(content))
        raise Damaged(f"it unpacks to {found} bytes, expected {size}, as it says")
    return content


def unpacked_message(data: bytes) -> bytes:
    """What zstd has packed by itself, which does not say how much it is.

    Raises Damaged if it is cut off, or more than any message.
    """
    most = most_bytes_of(len(data))
    content = b"".join(_parts("zstd", data, most + 1))
    if len(content) > most:
        raise Damaged(f"{len(data)} bytes unpack to more than {most}")
    return content


def _parts(packing: str, data: bytes, most: int) -> Iterator[bytes]:
    """What is unpacked, at most `most` bytes of it."""
    try:
        for part in _UNPACKERS[packing](data, most):
            yield part
            most -= len(part)
            if most <= 0:
                return
    except (ValueError, OSError, EOFError, RuntimeError) as error:
        raise Damaged(line_of(error)) from None


def _with_bz2(data: bytes, most: int) -> Iterator[bytes]:
    while data and most > 0:
        stream = bz2.BZ2Decompressor()
        part = stream.decompress(data, most)
        most -= len(part)
        yield part
        if not stream.eof:  # Cut off, or more than is wanted.
            return
        data = stream.unused_data


def _with_zlib(data: bytes, most: int) -> Iterator[bytes]:
    try:
        yield zlib.decompressobj(zlib.MAX_WBITS | 32).decompress(data, most)
    except zlib.error as error:
        raise Damaged(line_of(error)) from None


def _with_lz4(data: bytes, most: int) -> Iterator[bytes]:
    from lz4 import frame

    yield frame.LZ4FrameDecompressor().decompress(data, most)


def _with_zstd(data: bytes, most: int) -> Iterator[bytes]:
    import zstandard

    window = max(most, _WINDOW)  # A frame that says how long it is may have one as long.
    try:
        unpacker = zstandard.ZstdDecompressor(max_window_size=window)
        with unpacker.stream_reader(io.BytesIO(data)) as stream:
            while most > 0:
                part = stream.read(min(most, _PART))
                if not part:
                    return
                most -= len(part)
                yield part
    except zstandard.ZstdError as error:
        raise Damaged(line_of(error)) from None


_UNPACKERS: dict[str, Callable[[bytes, int], Iterator[bytes]]] = {
    "bz2": _with_bz2,
    "lz4": _with_lz4,
    "zstd": _with_zstd,
    "zlib": _with_zlib,
}
