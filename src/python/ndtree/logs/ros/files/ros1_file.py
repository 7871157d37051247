# SPDX-License-Identifier: BSD-3-Clause
"""Bags of ROS 1, version 2.0: chunks of records, read with the index at the end or without."""

from __future__ import annotations

import re
import struct
from collections.abc import Collection, Iterator

from ndtree.logs.ros import storage
from ndtree.logs.ros.storage import Chunk, Connection, Damaged, FileStorage, OnDamage, Raw, line_of

MAGIC = b"#ROS"
_VERSION = re.compile(rb"#ROS(?:BAG|RECORD) V(\d+)\.(\d+)[\r\n]")
_MESSAGE, _BAG_HEADER, _INDEX, _CHUNK, _CHUNK_INFO, _CONNECTION = 2, 3, 4, 5, 6, 7
_U32, _U64 = struct.Struct("<I"), struct.Struct("<Q")
_TIME = struct.Struct("<II")
#: No header of a record is longer [bytes]: one that says so is damaged.
_LONGEST_HEADER = 1 << 24

Header = dict[bytes, bytes]


class Ros1File(FileStorage):
    """A bag of ROS 1.

    Chunks are read as a whole, one at a time, and their records one after the other. The index at the end of
    the file says which chunks hold what; where it is missing or wrong, as in a bag that was never closed,
    every chunk is looked into once. The indexes behind the chunks are never used.

    Raises ValueError if the file is of another version, or encrypted.
    """

    def messages(self, topics: Collection[str], on_damage: OnDamage) -> Iterator[Raw]:
        wanted = self._wanted(topics)

        def messages_of(chunk: Chunk) -> Iterator[Raw]:
            try:
                self._file.seek(chunk.position)
                for header, data in _records_in(_unpacked(*self._record())):
                    connection = wanted.get(_id(header)) if _op(header) == _MESSAGE else None
                    if connection is not None:
                        yield Raw(connection, _time(header, b"time"), data)
            except _DAMAGES as error:
                if not (self.damage and chunk is self._chunks[-1]):  # Known: there the file was cut off.
                    on_damage(self._unreadable(line_of(error), f"the chunk at byte {chunk.position} "))

        return storage.of_chunks(self._chunks, wanted, messages_of)

    def _open(self) -> None:
        line = self._file.readline(64)
        version = _VERSION.match(line)
        if version is None:
            raise ValueError(f"{self.path}: begins with {line[:24]!r}, expected a ROS bag: #ROSBAG V2.0")
        if version.groups() != (b"2", b"0"):
            number = b".".join(version.groups()).decode()
            way = "ROS 1 writes it anew: rosbag filter OLD.bag NEW.bag True"
            raise ValueError(f"{self.path}: a ROS bag of version {number}, expected version 2.0; {way}")
        self._chunks: list[Chunk] = []
        try:
            header, _ = self._record()
            if header.get(b"encryptor"):
                raise ValueError(f"{self.path}: the bag is encrypted, expected a plain one (rosbag decrypt)")
            begin = self._file.tell()
            index = _U64.unpack(header[b"index_pos"])[0]
            expected = (_U32.unpack(header[b"conn_count"])[0], _U32.unpack(header[b"chunk_count"])[0])
        except _DAMAGES as error:
            raise self._unreadable(line_of(error)) from None
        if index:
            try:
                self._file.seek(index)
                self._read_index(*expected)
                return
            except _DAMAGES:
                self.damage = "its index cannot be read, the file is cut off or damaged"
        else:
            self.damage = "it was never closed"
        self.connections, self._chunks, self.counts, self.span = [], [], {}, None
        self._file.seek(begin)
        self._look_into_chunks()
        self._note_damage(self.damage, " (rosbag reindex mends it)")

    def _read_index(self, connections: int, chunks: int) -> None:
        """All connections, and what is in which of the chunks, from the end of the file."""
        while (record := self._record(may_end=True)) is not None:
            header, data = record
            if _op(header) == _CONNECTION:
                connections -= 1
                self._add_connection(header, data)
            elif _op(header) == _CHUNK_INFO:
                chunks -= 1
                counts = {id: n for id, n in _TIME.iter_unpack(data[: len(data) // 8 * 8]) if n}
                for id, count in counts.items():
                    self.counts[id] = self.counts.get(id, 0) + count
                if counts:
                    first, last = _time(header, b"start_time"), _time(header, b"end_time")
                    self._chunks.append(Chunk(_U64.unpack(header[b"chunk_pos"])[0], first, counts))
                    self._cover(first, last)
        if connections > 0 or chunks > 0:
            raise Damaged("not all of the index is there")

    def _look_into_chunks(self) -> None:
        """Connections and messages from the chunks, up to where the file ends or cannot be followed."""
        while True:
            position = self._file.tell()
            try:
                record = self._record(may_end=True)
            except _DAMAGES:
                return
            if record is None:
                return
            header, data = record
            if _op(header) != _CHUNK:
                continue
            received: dict[int, int] = {}  # When the first message of each was.
            try:
                for inner, content in _records_in(_unpacked(header, data)):
                    if _op(inner) == _CONNECTION:
                        self._add_connection(inner, content)
                    elif _op(inner) == _MESSAGE:
                        when, id = _time(inner, b"time"), _id(inner)
                        received[id] = min(received.get(id, when), when)
                        self._count(id, when)
            except _DAMAGES:
                pass  # What came before it in the chunk counts; reading meets the damage again.
            if received:
                self._chunks.append(Chunk(position, min(received.values()), received))

    def _add_connection(self, header: Header, data: bytes) -> None:
        id = _id(header)
        if any(one.id == id for one in self.connections):
            return
        about = _fields(data)
        topic = header.get(b"topic") or about.get(b"topic", b"")
        self.connections.append(
            Connection(
                id,
                topic.decode("utf-8", "replace"),
                storage.ros2_type(about[b"type"].decode("utf-8", "replace")),
                "ros1",
                about.get(b"message_definition", b"").decode("utf-8", "replace") or None,
            )
        )

    def _record(self, may_end: bool = False) -> tuple[Header, bytes] | None:
        """The record at the file's place, or None where the file ends there."""
        start = self._file.read(4)
        if may_end and not start:
            return None
        length = _U32.unpack(start)[0]
        if length > _LONGEST_HEADER:
            raise Damaged(f"a record's header of {length} bytes")
        header = _fields(self._whole(length))
        return header, self._whole(_U32.unpack(self._whole(4))[0])

    def _whole(self, size: int) -> bytes:
        missing = size - (self._size - self._file.tell())
        if missing > 0:  # No room is made for what is not there.
            raise Damaged(f"the file ends {missing} bytes too early")
        return self._file.read(size)


#: What reading records of damaged bytes runs into.
_DAMAGES = (Damaged, struct.error, KeyError, OSError, EOFError, RuntimeError, UnicodeError)


def _fields(data: bytes) -> Header:
    fields, at = {}, 0
    while at < len(data):
        size = _U32.unpack_from(data, at)[0]
        name, equals, value = data[at + 4 : at + 4 + size].partition(b"=")
        if not equals or at + 4 + size > len(data):
            raise Damaged("a header without names")
        fields[name] = value
        at += 4 + size
    return fields


def _records_in(data: bytes) -> Iterator[tuple[Header, bytes]]:
    at = 0
    while at < len(data):
        size = _U32.unpack_from(data, at)[0]
        header = _fields(data[at + 4 : at + 4 + size])
        at += 4 + size
        size = _U32.unpack_from(data, at)[0]
        if at + 4 + size > len(data):
            raise Damaged("a record that ends behind its chunk")
        yield header, data[at + 4 : at + 4 + size]
        at += 4 + size


def _unpacked(header: Header, data: bytes) -> bytes:
    packing = header[b"compression"].decode("utf-8", "replace")
    return storage.unpacked(packing, data, _U32.unpack(header[b"size"])[0])


def _op(header: Header) -> int:
    op = header.get(b"op", b"")
    return op[0] if len(op) == 1 else -1


def _id(header: Header) -> int:
    return int(_U32.unpack(header[b"conn"])[0])


def _time(header: Header, name: bytes) -> int:
    seconds, nanoseconds = _TIME.unpack(header[name])
    return int(seconds) * 10**9 + int(nanoseconds)
