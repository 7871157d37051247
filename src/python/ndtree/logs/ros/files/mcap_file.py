# SPDX-License-Identifier: BSD-3-Clause
"""MCAP files with messages of ROS 1 or ROS 2."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import replace
from typing import Any

from ndtree._lazy import needs
from ndtree.logs.ros import storage
from ndtree.logs.ros.messages import foxglove
from ndtree.logs.ros.storage import Chunk, Connection, Damaged, FileStorage, OnDamage, Raw, line_of

MAGIC = b"\x89MCAP0\r\n"


class McapFile(FileStorage):
    """An .mcap file. One without its last part, as a crash leaves it, is read up to where it ends.

    Raises ImportError if the library mcap is not there; ValueError if nothing in it can be read.
    """

    def __init__(self, path: str, name: str) -> None:
        with needs("MCAP files need mcap", "ros"):
            from mcap import reader, records, stream_reader
        self._reader, self._records, self._stream = reader, records, stream_reader
        super().__init__(path, name)

    def messages(self, topics: Collection[str], on_damage: OnDamage) -> Iterator[Raw]:
        wanted = self._wanted(topics)

        def messages_of(records: Iterator[Any], where: str) -> Iterator[Raw]:
            try:
                for one in records:
                    if isinstance(one, self._records.Message) and one.channel_id in wanted:
                        yield Raw(wanted[one.channel_id], int(one.log_time), bytes(one.data))
            except Exception as error:  # A library at the mercy of foreign bytes.
                if self.damage is None:  # Else it is known.
                    on_damage(self._unreadable(line_of(error), where))

        # Without chunks all messages would have to be sorted in memory: they are taken as they come.
        if not self._chunks:
            return messages_of(self._every_record(), "")
        where = "the chunk at byte {0.position} "
        return storage.of_chunks(
            self._chunks,
            wanted,
            lambda one: messages_of(self._records_at(one.position), where.format(one)),
        )

    def _open(self) -> None:
        self._chunks: list[Chunk] = []
        if self._read_summary():
            return
        self._chunks, self.connections, self.counts, self.span = [], [], {}, None
        self.unread = []
        self.damage = "it has no summary, it was never closed or is cut off"
        schemas: dict[int, Any] = {}
        reason = "no message"
        try:
            for record in self._every_record():
                if isinstance(record, self._records.Schema):
                    schemas[record.id] = record
                elif isinstance(record, self._records.Channel):
                    self._add(record, schemas.get(record.schema_id))
                elif isinstance(record, self._records.Message):
                    self._count(record.channel_id, int(record.log_time))
                elif isinstance(record, self._records.Footer):
                    self.damage = None if not self.counts else "it has no summary"
        except Exception as error:  # As above.
            reason = line_of(error)
        if self.damage and not self.counts:
            raise self._unreadable(reason)
        if self.damage:
            self._note_damage(self.damage, " (mcap recover mends it)")

    def _add(self, channel: Any, schema: Any) -> None:
        """Note a channel, and whether its messages are those of ROS or can be turned into such."""
        id, topic, encoding = channel.id, channel.topic, channel.message_encoding
        if any(one.id == id for one in (*self.connections, *self.unread)):
            return
        name = schema.name if schema is not None else ""
        packed = encoding == "protobuf"
        known = foxglove.type_of(name) if encoding in ("json", "protobuf") else storage.ros2_type(name)
        if packed and (schema is None or schema.encoding != "protobuf" or name not in foxglove.TYPES):
            known = None
        if encoding not in ("ros1", "cdr", "json", "protobuf") or not name or known is None:
            self.unread.append(Connection(id, topic, name or "no type", encoding or "nothing"))
            return
        has_text = schema.encoding in ("ros1msg", "ros2msg")
        definition = schema.data.decode("utf-8", "replace") if has_text else ""
        if topic.startswith("rt/") and "::" in name:  # DDS puts it before the name that ROS knows.
            topic = topic[2:]
        data = bytes(schema.data) if packed else b""
        self.connections.append(Connection(id, topic, known, encoding, definition or None, name, data))

    def _read_summary(self) -> bool:
        """Connections, counts, span and chunks, as the end of the file has them; whether it does."""
        try:
            summary = self._reader.SeekingReader(self._file, record_size_limit=self._size).get_summary()
        except Exception:  # As above.
            return False
        if summary is None or summary.statistics is None or not summary.channels:
            return False
        for channel in summary.channels.values():
            self._add(channel, summary.schemas.get(channel.schema_id))
        self._chunks = [
            Chunk(one.chunk_start_offset, one.message_start_time, one.message_index_offsets.keys())
            for one in summary.chunk_indexes
        ]
        statistics = summary.statistics
        self.counts = {int(id): int(count) for id, count in statistics.channel_message_counts.items()}
        if statistics.message_count:
            self.span = (int(statistics.message_start_time), int(statistics.message_end_time))
        return True

    def _every_record(self) -> Iterator[Any]:
        """All records of the file, also those in chunks."""
        for record in self._records_from(0):
            if isinstance(record, self._records.Chunk):
                yield from self._records_in(record)
            else:
                yield record

    def _records_at(self, position: int) -> Iterator[Any]:
        chunk = next(self._records_from(position))
        if not isinstance(chunk, self._records.Chunk):
            raise Damaged("there is none")
        yield from self._records_in(chunk)

    def _records_from(self, position: int) -> Iterator[Any]:
        """Records, chunks as such: the library unpacks without bounds."""
        self._file.seek(position)
        how = {"skip_magic": position > 0, "emit_chunks": True, "record_size_limit": self._size}
        yield from self._stream.StreamReader(self._file, **how).records

    def _records_in(self, chunk: Any) -> list[Any]:
        data = storage.unpacked(chunk.compression, chunk.data, chunk.uncompressed_size)
        records: list[Any] = self._stream.breakup_chunk(replace(chunk, compression="", data=data))
        return records
