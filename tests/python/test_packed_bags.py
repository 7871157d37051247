# SPDX-License-Identifier: BSD-3-Clause
"""What bags hold packed: unpacked within bounds, whatever it says of itself."""

from __future__ import annotations

import bz2
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("typer")
pytest.importorskip("mcap")
pytest.importorskip("zstandard")
pytest.importorskip("lz4")

import zstandard
from lz4 import frame
from mcap import writer as mcap_writer
from outcomes import info_of, outcome_of
from test_hostile_files import peak_memory

import ndtree
from ndtree.cli.commands import every
from ndtree.logs.ros.storage import Damaged, most_bytes_of, unpacked, unpacked_message

every()  # Commands are loaded once, and not in each fork.

PACKERS: dict[str, Callable[[bytes], bytes]] = {
    "bz2": bz2.compress,
    "lz4": frame.compress,
    "zstd": zstandard.ZstdCompressor().compress,
}
BOMB_BYTES = 150 << 20


def zstd_without_size(data: bytes) -> bytes:
    packer = zstandard.ZstdCompressor(write_content_size=False).compressobj()
    return bytes(packer.compress(data) + packer.flush())


def zstd_bomb(*, says_size: bool) -> bytes:
    packer = zstandard.ZstdCompressor().compressobj(size=BOMB_BYTES if says_size else -1)
    zeros = bytes(1 << 20)
    parts = [packer.compress(zeros) for _ in range(BOMB_BYTES >> 20)]
    return b"".join(parts) + packer.flush()


BOMBS: dict[str, Callable[[], bytes]] = {
    "bz2": lambda: (BOMB_BYTES >> 20) * bz2.compress(bytes(1 << 20)),  # One behind the other are one.
    "lz4": lambda: frame.compress(bytes(BOMB_BYTES)),
    "zstd": lambda: zstd_bomb(says_size=True),
    "zstd without its size": lambda: zstd_bomb(says_size=False),
}


@pytest.mark.parametrize("packing", PACKERS)
def test_what_is_packed_is_unpacked(packing: str) -> None:
    random = np.random.default_rng(5)
    for size in (0, 1, 1000, 100_000, (1 << 24) + 1):  # The last one in several parts.
        for data in (bytes(size), random.bytes(size))[: 2 if size < 1 << 20 else 1]:
            packed = PACKERS[packing](data)
            assert unpacked(packing, packed, size) == data
            for says in {size + 1, max(size - 1, 0)} - {size}:
                with pytest.raises(Damaged, match=f"expected {says}, as it says"):
                    unpacked(packing, packed, says)
            with pytest.raises(Damaged):
                unpacked(packing, packed[: len(packed) // 2], size + (size == 0))
    assert unpacked("none", b"ab", 7) == unpacked("", b"ab", 7) == b"ab"
    with pytest.raises(Damaged, match="compression 'rar', expected none, bz2, lz4, zstd"):
        unpacked("rar", b"ab", 2)


def test_what_several_streams_of_bz2_hold_is_one() -> None:
    assert unpacked("bz2", bz2.compress(b"one") + bz2.compress(b"two"), 6) == b"onetwo"


def test_messages_do_not_say_how_long_they_are() -> None:
    data = np.random.default_rng(5).bytes(70_000)
    for packed in (PACKERS["zstd"](data), zstd_without_size(data)):
        assert unpacked_message(packed) == data
    with pytest.raises(Damaged):
        unpacked_message(b"\x28\xb5\x2f\xfdrubbish")


@pytest.mark.parametrize("bomb", BOMBS)
def test_what_unpacks_to_more_than_it_says_is_not_unpacked(bomb: str) -> None:
    packing, data = bomb.split()[0], BOMBS[bomb]()

    def run() -> None:
        for says in (1000, BOMB_BYTES, 1 << 40):
            if says <= most_bytes_of(len(data)):  # What is packed less is read, if it says so.
                assert says == 1000 or packing == "lz4"
                if packing == "lz4" and says == BOMB_BYTES:
                    continue
            with pytest.raises(Damaged):
                unpacked(packing, data, says)

    assert peak_memory(run) < 60 << 20


def ros1_records(*records: tuple[dict[str, bytes], bytes]) -> bytes:
    content = b""
    for header, data in records:
        fields = [name.encode() + b"=" + value for name, value in header.items()]
        packed = b"".join(struct.pack("<I", len(one)) + one for one in fields)
        content += struct.pack("<I", len(packed)) + packed + struct.pack("<I", len(data)) + data
    return content


def ros1_bag(packing: str, data: bytes, says: int) -> bytes:
    """Of one chunk; the bag was never closed."""
    count = struct.pack("<I", 0)
    head = {"op": b"\x03", "index_pos": struct.pack("<Q", 0), "conn_count": count, "chunk_count": count}
    chunk = {"op": b"\x05", "compression": packing.encode(), "size": struct.pack("<I", says)}
    return b"#ROSBAG V2.0\n" + ros1_records((head, bytes(4000)), (chunk, data))


def mcap_file(path: Path, packing: str, data: bytes, says: int, *, closed: bool) -> None:
    """Of one chunk, in which somebody has put something else."""
    kind = {"zstd": mcap_writer.CompressionType.ZSTD, "lz4": mcap_writer.CompressionType.LZ4}[packing]
    with open(path, "wb") as file:
        writer = mcap_writer.Writer(file, compression=kind)
        writer.start("ros2")
        schema = writer.register_schema("sensor_msgs/msg/LaserScan", "ros2msg", b"")
        writer.add_message(writer.register_channel("/scan", "cdr", schema), 1, b"\0\1\0\0", 1)
        writer.finish()
    content = path.read_bytes()
    at = content.index(b"\x06", 8 + 9 + struct.unpack_from("<Q", content, 9)[0])
    length = struct.unpack_from("<Q", content, at + 1)[0]
    times = content[at + 9 : at + 25]
    name = struct.pack("<I", len(packing)) + packing.encode()
    body = times + struct.pack("<QI", says, 0) + name + struct.pack("<Q", len(data)) + data
    rest = content[at + 9 + length :]
    if closed:  # The summary is where it was, behind the data.
        grown = len(body) - length
        begin = struct.unpack_from("<Q", rest, len(rest) - 28)[0]
        rest = rest[:-28] + struct.pack("<QQI", begin + grown, 0, 0) + rest[-8:]
    else:
        rest = b""
    path.write_bytes(content[:at] + b"\x06" + struct.pack("<Q", len(body)) + body + rest)


@pytest.mark.parametrize(
    "kind, bomb",
    [
        ("ros1", "bz2"),
        ("ros1", "lz4"),
        ("mcap", "zstd"),
        ("mcap", "zstd without its size"),
        ("mcap", "lz4"),
        ("mcap without summary", "zstd"),
        ("file", "zstd"),
    ],
)
def test_a_bag_that_unpacks_to_far_more_is_refused(kind: str, bomb: str, tmp_path: Path) -> None:
    packing, data = bomb.split()[0], BOMBS[bomb]()
    says = BOMB_BYTES if packing != "lz4" else 1000
    if kind == "ros1":
        path = tmp_path / "bomb.bag"
        path.write_bytes(ros1_bag(packing, data, says))
    elif kind == "file":
        path = tmp_path / "bomb.db3.zstd"
        path.write_bytes(data)
    else:
        path = tmp_path / "bomb.mcap"
        mcap_file(path, packing, data, says, closed="without" not in kind)
    outcome, said = outcome_of(info_of(path), tmp_path, seconds=20)
    assert outcome == "refused", (outcome, said[-2000:])
    assert peak_memory(lambda: list(ndtree.read(path))) < 100 << 20
