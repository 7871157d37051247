# SPDX-License-Identifier: BSD-3-Clause
"""A bag of ROS 1 or ROS 2 as a whole: the files that it consists of, its topics, and its messages."""

from __future__ import annotations

import heapq
import os
import re
import shutil
import tempfile
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

from ndtree._lazy import needs
from ndtree.logs.core.plain_file import FREE_BYTES, MOST_PACKED
from ndtree.logs.poses.transforms import plain
from ndtree.logs.ros.files import mcap_file, ros1_file, sqlite_file
from ndtree.logs.ros.messages import foxglove
from ndtree.logs.ros.messages.own import DECODERS
from ndtree.logs.ros.storage import Connection, Damaged, OnDamage, Raw, Storage, line_of, unpacked_message

METADATA, METADATA_BEGINS = "metadata.yaml", b"rosbag2_bagfile_information:"
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
ENDINGS = (".db3", ".mcap", ".bag", ".db3.zstd", ".mcap.zstd", ".bag.active")
#: The files that bags consist of, by their first bytes.
_FILES: dict[bytes, Callable[[str, str], Storage]] = {
    ros1_file.MAGIC: ros1_file.Ros1File,
    mcap_file.MAGIC: mcap_file.McapFile,
    sqlite_file.MAGIC: sqlite_file.SqliteFile,
}
MAGICS = tuple(_FILES)


@dataclass(frozen=True)
class Topic:
    """One topic of a bag."""

    name: str
    type: str
    messages: int


class Bag:
    """A bag that is open: its topics, and their messages in the order of recording.

    `topics`: By name.
    `start`, `end`: When the first and the last message were recorded [s].
    `damage`: A line for each file of which not everything can be read.
    `unread` (list of (Topic, str)): Topics whose messages are packed so that they cannot be read, and how
        they are packed.
    """

    def __init__(self, path: str, files: list[Storage]) -> None:
        self.path = path
        self._files = files
        self._stores: dict[str, Any] = {}
        counts: dict[str, int] = {}
        types: dict[str, str] = {}
        for file in files:
            for one in file.connections:
                types.setdefault(one.topic, one.type)
                counts[one.topic] = counts.get(one.topic, 0) + file.counts.get(one.id, 0)
        self.topics = [Topic(name, types[name], counts[name]) for name in sorted(types)]
        spans = [file.span for file in files if file.span is not None]
        self.start = 1e-9 * min((span[0] for span in spans), default=0)
        self.end = 1e-9 * max((span[1] for span in spans), default=0)
        self.unread = [
            (Topic(one.topic, one.type, file.counts.get(one.id, 0)), one.encoding)
            for file in files
            for one in file.unread
        ]
        self.damage = [f"{file.path}: {file.damage}" for file in files if file.damage]

    def of_type(self, *types: str) -> list[Topic]:
        """Topics of some types that have messages."""
        return [topic for topic in self.topics if topic.type in types and topic.messages]

    def topic(self, name: str) -> Topic | None:
        """A topic by its name, with a slash before it or not."""
        return next((topic for topic in self.topics if plain(topic.name) == plain(name)), None)

    def messages(self, topics: Collection[str], on_damage: OnDamage | None = None) -> Iterator[Raw]:
        """Messages of some topics; ValueError where the bag is damaged, unless `on_damage` notes it."""
        rows = [file.messages(topics, on_damage or _raised) for file in self._files]
        for raw in heapq.merge(*rows, key=lambda raw: raw.received) if len(rows) > 1 else rows[0]:
            yield _unpacked(raw) if raw.data.startswith(ZSTD_MAGIC) else raw

    def decoded(self, raw: Raw) -> Any:
        """A message of one of ROS's own types, or of a Livox lidar; ValueError if it is damaged."""
        one = raw.connection
        if one.encoding in ("json", "protobuf"):
            return foxglove.decoded(raw)
        if one.type in DECODERS:
            return DECODERS[one.type](raw.data, is_ros1=one.encoding == "ros1")
        if one.encoding not in self._stores:
            self._stores[one.encoding] = self._store(one.encoding)
        store = self._stores[one.encoding]
        try:
            if one.encoding == "ros1":
                return store.deserialize_ros1(raw.data, one.type)
            return store.deserialize_cdr(raw.data, one.type)
        except Exception as error:  # A library at the mercy of foreign bytes raises whatever comes.
            raise ValueError(f"no whole {one.type} ({type(error).__name__}: {line_of(error)})") from None

    def first(self, topic: str) -> Any:
        """The first message of a topic that is whole."""
        wrong: ValueError | None = None
        for raw in self.messages([topic]):
            try:
                return self.decoded(raw)
            except ValueError as error:
                wrong = wrong or ValueError(f"{self.path}: {topic}: first message: {error}")
        raise wrong or ValueError(f"{self.path}: {topic}: no message, expected at least one")

    def _store(self, encoding: str) -> Any:
        """Definitions of the types: as the bag has them, else ROS's own."""
        definitions: dict[str, str] = {}
        for file in self._files:
            for one in file.connections:
                if one.encoding == encoding and one.definition and one.type.startswith(_READ_PACKAGES):
                    definitions[one.type] = one.definition
        return _store_of(tuple(sorted(definitions.items())), encoding == "ros1")


#: Packages of messages that are read; of others the definitions are not needed.
_READ_PACKAGES = ("sensor_msgs/", "geometry_msgs/", "nav_msgs/", "tf2_msgs/", "tf/", "std_msgs/")


def _typesys() -> Any:
    with needs("ROS bags need rosbags", "ros"):
        from rosbags import typesys
    return typesys


@lru_cache(maxsize=8)
def _store_of(definitions: tuple[tuple[str, str], ...], is_ros1: bool) -> Any:
    """Makes the store of definitions, which takes a while."""
    typesys = _typesys()
    known = typesys.get_typestore(typesys.Stores.ROS1_NOETIC if is_ros1 else typesys.Stores.ROS2_HUMBLE)
    every = dict(known.fielddefs)
    for type_, text in definitions:
        try:
            every.update(typesys.get_types_from_msg(text, type_))
        except Exception:  # An unreadable definition: ROS's own has to do.
            continue
    _give_up_unknown(every, known.fielddefs)
    store = typesys.get_typestore(typesys.Stores.EMPTY)
    store.register(every)
    return store


def _give_up_unknown(every: dict[str, Any], known: Any) -> None:
    """Take ROS's own definitions, or none, for those that name types that there are not."""
    while True:
        unknown = [name for name, (_, of) in every.items() if not all(_is_known(one, every) for _, one in of)]
        if not unknown:
            return
        for name in unknown:
            if name in known and every[name] is not known[name]:
                every[name] = known[name]
            else:
                del every[name]


def _is_known(field: Any, types: dict[str, Any]) -> bool:
    kind, of = field
    if kind.name in ("ARRAY", "SEQUENCE"):
        return _is_known(of[0], types)
    return kind.name != "NAME" or of in types


@contextmanager
def open_bag(path: str) -> Iterator[Bag]:
    """Open a bag of ROS 1 or ROS 2 for as long as it is read.

    `path`: A file, or a folder with the files of one recording: those that its metadata.yaml names, and
        without one all of them.
    Raises ImportError if a library is not there; OSError if there is no such file; ValueError if it is no
    bag, or damaged so that nothing in it can be read.
    """
    _typesys()  # So that a missing library is reported before anything else.
    with ExitStack() as stack:
        files: list[Storage] = []
        for name in _files_of(path) if os.path.isdir(path) else [path]:
            file = _opened(name, stack)
            stack.callback(file.close)
            files.append(file)
        yield Bag(path, files)


def _files_of(folder: str) -> list[str]:
    names = [name for name in os.listdir(folder) if name.endswith(ENDINGS)]
    names.sort(key=lambda name: [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", name)])
    named = _named_by_metadata(folder)
    listed = [name for name in named if name in names]
    if listed:
        missing = [name for name in named if name not in names]
        if missing:
            raise ValueError(f"{folder}: {missing[0]} is not there, expected it, as {METADATA} names it")
        return [os.path.join(folder, name) for name in listed]
    recordings = {re.sub(r"_\d+$", "", name.split(".")[0]) for name in names}
    if len(recordings) > 1:
        ways = "".join(f"\n  {os.path.join(folder, name)}" for name in names[:6])
        raise ValueError(f"{folder}: {len(recordings)} recordings, expected the path of one of them:{ways}")
    if not names:
        raise ValueError(f"{folder}: no {', '.join(ENDINGS[:3])} in it, expected the files of a ROS bag")
    return [os.path.join(folder, name) for name in names]


def _named_by_metadata(folder: str) -> list[str]:
    """Names of files that metadata.yaml has; none if it is not there, or says nothing."""
    try:
        with open(os.path.join(folder, METADATA), encoding="utf-8", errors="replace") as file:
            text = file.read()
    except OSError:
        return []
    found = re.search(r"relative_file_paths:\s*\n((?:\s*-\s*\S.*\n?)+)", text)
    if found is None:
        return []
    rows = re.findall(r"-\s*(\S.*)", found.group(1))
    return [os.path.basename(row.strip().strip("'\"")) for row in rows]


def _opened(name: str, stack: ExitStack) -> Storage:
    """One file, by its first bytes; what is packed as a whole is unpacked into a temporary one."""
    if not os.path.isfile(name):  # A pipe would wait for somebody to write.
        raise ValueError(f"{name}: is not a regular file, expected one of a ROS bag")
    path, head = name, _head(name)
    if head.startswith(ZSTD_MAGIC):
        path = _unpacked_file(name, stack)
        head = _head(path)
        if not head:
            raise ValueError(f"{name}: cannot be unpacked (cut off), expected a whole file")
    elif head.startswith(sqlite_file.MAGIC) and os.path.isfile(wal := name + sqlite_file.WAL):
        path = _with_wal(name, stack) if os.path.getsize(wal) else path
    for magic, kind in _FILES.items():
        if head.startswith(magic):
            return kind(path, name)
    found = f"begins with {head[:12]!r}" if head else "is empty"
    raise ValueError(f"{name}: {found}, expected a ROS bag: a .bag of version 2.0, .mcap or .db3")


def _head(path: str) -> bytes:
    with open(path, "rb") as file:
        return file.read(16)


def _with_wal(path: str, stack: ExitStack) -> str:
    """A copy of a database that was never closed: SQLite completes it from what was written beside it."""
    folder = stack.enter_context(tempfile.TemporaryDirectory())
    target = os.path.join(folder, os.path.basename(path))
    for ending in ("", sqlite_file.WAL):
        shutil.copyfile(path + ending, target + ending)
    return target


def _unpacked_file(path: str, stack: ExitStack) -> str:
    zstandard = _zstandard(path)
    folder = stack.enter_context(tempfile.TemporaryDirectory())
    target = os.path.join(folder, os.path.basename(path).removesuffix(".zstd"))
    left = FREE_BYTES + MOST_PACKED * os.path.getsize(path)
    try:
        with open(path, "rb") as packed, open(target, "wb") as file:
            for part in zstandard.ZstdDecompressor().read_to_iter(packed):
                left -= len(part)
                if left < 0:
                    said = f"unpacks to more than {file.tell() >> 20} MiB"
                    raise ValueError(f"{path}: {said}, expected at most {MOST_PACKED} bytes for one")
                file.write(part)
    except zstandard.ZstdError as error:
        raise ValueError(f"{path}: cannot be unpacked ({line_of(error)}), expected a whole file") from None
    return target


def _unpacked(raw: Raw) -> Raw:
    """A message that was packed by itself; as it is where that fails, and so it is no whole message."""
    _zstandard(raw.connection.topic)
    try:
        return Raw(raw.connection, raw.received, unpacked_message(raw.data))
    except Damaged:
        return raw


def _zstandard(what: str) -> Any:
    with needs(f"{what}: packed by zstd, which needs zstandard", "ros"):
        import zstandard
    return zstandard


def _raised(error: ValueError) -> None:
    raise error


class _MemoryFile(Storage):
    """Messages in the order of arrival."""

    def __init__(self, name: str, messages: Sequence[Raw]) -> None:
        super().__init__(name)
        self._messages = messages
        numbers: dict[Connection, int] = {}
        for raw in messages:
            self._count(numbers.setdefault(raw.connection, len(numbers)), raw.received)
        self.connections = [replace(one, id=number) for one, number in numbers.items()]

    def messages(self, topics: Collection[str], on_damage: OnDamage) -> Iterator[Raw]:
        return (raw for raw in self._messages if raw.connection.topic in topics)


def bag_of(name: str, messages: Sequence[Raw]) -> Bag:
    """A bag of messages that are in memory already."""
    return Bag(name, [_MemoryFile(name, messages)])
