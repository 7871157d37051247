# SPDX-License-Identifier: BSD-3-Clause
"""MCAP files with messages of ROS 1 or ROS 2."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import Any

from ndtree.readers.ros.storage import Connection, FileStorage, OnDamage, Raw, line_of, ros2_type

MAGIC = b"\x89MCAP0\r\n"


class McapFile(FileStorage):
    """An .mcap file. One without its last part, as a crash leaves it, is read up to where it ends.

    Raises
    ------
    ImportError
        If the library mcap is not there.
    ValueError
        If nothing in it can be read.
    """

    def __init__(self, path: str, name: str) -> None:
        try:
            from mcap import reader, records, stream_reader
        except ImportError as error:
            raise ImportError(
                f"MCAP files need mcap ({error}); install it with: pip install 'ndtree-mapping[ros]'"
            ) from None
        self._reader, self._records, self._stream = reader, records, stream_reader
        super().__init__(path, name)

    def messages(self, ids: Collection[int], heads: Collection[int], on_damage: OnDamage) -> Iterator[Raw]:
        wanted = self._wanted(ids, heads)
        rows = self._in_order(wanted) if self._is_indexed else self._as_found()
        while True:
            try:
                message = next(rows, None)
            except Exception as error:  # A library at the mercy of foreign bytes.
                if self.damage is None:  # Else it is known.
                    on_damage(self._unreadable(line_of(error)))
                return
            if message is None:
                return
            if message.channel_id in wanted:
                yield Raw(wanted[message.channel_id], int(message.log_time), bytes(message.data))

    def _open(self) -> None:
        try:
            summary = self._reader.make_reader(self._file).get_summary()
        except Exception:  # As above.
            summary = None
        self._is_indexed = False
        if summary is not None and summary.statistics is not None and summary.channels:
            # Without chunks the library would sort all messages in memory: they are taken as they come.
            self._is_indexed = bool(summary.chunk_indexes)
            for channel in summary.channels.values():
                self._add(channel, summary.schemas.get(channel.schema_id))
            known = summary.statistics
            self.counts = {int(id): int(count) for id, count in known.channel_message_counts.items()}
            if known.message_count:
                self.span = (int(known.message_start_time), int(known.message_end_time))
            return
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
        """Note a channel with messages of ROS."""
        encoding = channel.message_encoding
        if encoding not in ("ros1", "cdr") or schema is None:
            return
        if any(one.id == channel.id for one in self.connections):
            return
        definition = (
            schema.data.decode("utf-8", "replace") if schema.encoding in ("ros1msg", "ros2msg") else ""
        )
        self.connections.append(
            Connection(channel.id, channel.topic, ros2_type(schema.name), encoding, definition or None)
        )

    def _in_order(self, wanted: dict[int, Connection]) -> Iterator[Any]:
        self._file.seek(0)
        topics = {one.topic for one in wanted.values()}
        if topics:
            for _, _, message in self._reader.make_reader(self._file).iter_messages(topics=topics):
                yield message

    def _as_found(self) -> Iterator[Any]:
        for record in self._every_record():
            if isinstance(record, self._records.Message):
                yield record

    def _every_record(self) -> Iterator[Any]:
        self._file.seek(0)
        yield from self._stream.StreamReader(self._file, record_size_limit=self._size).records
