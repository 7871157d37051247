# SPDX-License-Identifier: BSD-3-Clause
"""Bags of ROS 2 in SQLite files."""

from __future__ import annotations

import sqlite3
from collections.abc import Collection, Iterator
from urllib.parse import quote

from ndtree.logs.core.failures import NotALog, shown
from ndtree.logs.ros.storage import Connection, OnDamage, Raw, Storage, line_of

MAGIC = b"SQLite format 3\0"
#: Ending of the file beside a database with what was written to it last.
WAL = "-wal"
#: Rows that damage has not emptied.
_WHOLE = "typeof(timestamp) = 'integer' AND typeof(data) = 'blob'"


class SqliteFile(Storage):
    """A .db3 file of a ROS 2 bag.

    Raises ValueError if the database has no messages and topics, or is too damaged to say which.
    """

    def __init__(self, path: str, name: str) -> None:
        super().__init__(name)
        how = "mode=rw" if path != name else "immutable=1"  # A copy may be changed.
        self._base = sqlite3.connect(f"file:{quote(path)}?{how}", uri=True)
        self._require_bag()
        try:
            definitions = self._definitions()
            for id, topic, type, encoding in self._base.execute(
                "SELECT id, name, type, serialization_format FROM topics ORDER BY id"
            ):
                if encoding == "cdr":
                    self.connections.append(Connection(id, topic, type, encoding, definitions.get(type)))
            for id, count, first, last in self._base.execute(
                "SELECT topic_id, COUNT(*), MIN(timestamp), MAX(timestamp) FROM messages "
                f"WHERE {_WHOLE} GROUP BY topic_id"
            ):
                self.counts[id] = count
                self._cover(first, last)
        except sqlite3.Error as error:
            self._look_through(error)

    def _require_bag(self) -> None:
        try:
            tables = {name for (name,) in self._base.execute("SELECT name FROM sqlite_master")}
        except sqlite3.Error:  # Damaged; there may be messages in it all the same.
            return
        if not tables or "topics" in tables or "messages" in tables:
            return
        self._base.close()
        if {"Node", "Link", "Data"} <= tables:
            way = "exporting its scans and poses from RTAB-Map, then ndtree map on their folder"
            raise NotALog(self.path, "a database of RTAB-Map", [way])
        some = shown(", ".join(sorted(tables)), 60)
        raise NotALog(self.path, f"a database of SQLite without a bag in it, but with {some}")

    def close(self) -> None:
        self._base.close()

    def messages(self, topics: Collection[str], on_damage: OnDamage) -> Iterator[Raw]:
        wanted = self._wanted(topics)
        among = f"topic_id IN ({','.join(map(str, wanted))}) AND {_WHOLE}"
        order = "" if self.damage else "ORDER BY timestamp, id"
        rows = self._base.execute(f"SELECT topic_id, timestamp, data FROM messages WHERE {among} {order}")
        try:
            for id, received, data in rows:
                yield Raw(wanted[id], received, bytes(data))
        except sqlite3.Error as error:
            if not self.damage:  # Else it is known.
                on_damage(self._unreadable(line_of(error)))

    def _definitions(self) -> dict[str, str]:
        """Texts of the types, which recorders since 2023 write."""
        try:
            return dict(
                self._base.execute(
                    "SELECT topic_type, encoded_message_definition FROM message_definitions "
                    "WHERE encoding = 'ros2msg'"
                )
            )
        except sqlite3.Error:
            return {}

    def _look_through(self, error: sqlite3.Error) -> None:
        """What can be found in a file that is cut off or damaged."""
        self.counts, self.span = {}, None
        try:
            for row in self._base.execute(f"SELECT topic_id, timestamp FROM messages WHERE {_WHOLE}"):
                self._count(*row)
        except sqlite3.Error:
            pass
        if not self.counts or not self.connections:
            self._base.close()
            raise self._unreadable(line_of(error)) from None
        self._note_damage("the database is cut off or damaged")
