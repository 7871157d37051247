# SPDX-License-Identifier: BSD-3-Clause
"""What bags hold packed: unpacked within bounds; and chunks, of which the messages come in order."""

from __future__ import annotations

import bz2
import heapq
import io
from collections.abc import Callable, Iterable, Iterator
from typing import Protocol, TypeVar

from ndtree.logs.core.plain_file import FREE_BYTES, MOST_PACKED
from ndtree.logs.ros.storage import Raw, line_of

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


def in_order(chunks: Iterable[AnyChunk], messages_of: Callable[[AnyChunk], Iterable[Raw]]) -> Iterator[Raw]:
    """Messages of all chunks in the order of recording, also where chunks overlap in time."""
    waiting: list[tuple[int, int, Raw]] = []
    number = 0
    for chunk in sorted(chunks, key=lambda one: one.first):
        while waiting and waiting[0][0] < chunk.first:
            yield heapq.heappop(waiting)[2]
        for raw in messages_of(chunk):
            heapq.heappush(waiting, (raw.received, number, raw))
            number += 1
    while waiting:
        yield heapq.heappop(waiting)[2]


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
}
