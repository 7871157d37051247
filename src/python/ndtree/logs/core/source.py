# SPDX-License-Identifier: BSD-3-Clause
"""What a format is, and what it is recognised from."""

from __future__ import annotations

import codecs
import os
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ndtree._errors import WrongValue, key
from ndtree.logs.core.failures import WrongOption
from ndtree.logs.core.log import Log
from ndtree.logs.core.plain_file import open_plain
from ndtree.logs.core.rules import INVALID, NO_ECHO

__all__ = ["TIME_OFFSET", "Format", "ReaderOption", "Source", "WrongOption", "source_of"]

HEAD_BYTES = 1 << 18


@dataclass(frozen=True)
class Source:
    """A file or a folder that somebody wants to read.

    `path`: Its name as it was given.
    `head`: The first 256 KiB of a file, unpacked by gzip, without a byte order mark, cut at the end of a line
        where there is more; empty for a folder.
    `names`: Names of a folder's entries, sorted; empty for a file.
    `packed`: By what a file is packed, "gzip" or "bzip2"; "" for others.
    """

    path: str
    head: bytes
    names: tuple[str, ...] = ()
    is_folder: bool = False
    packed: str = ""

    def inside(self, *parts: str) -> str:
        """Path of something in the folder."""
        return os.path.join(self.path, *parts)


@dataclass(frozen=True)
class ReaderOption:
    """A keyword that `read` hands to a format, and a flag of the command line.

    Formats that mean the same by a name share one object.
    """

    name: str
    type: type
    help: str


TIME_OFFSET = ReaderOption("time_offset", float, "Added to the times of scans to find their poses [s].")
ZERO_IS = ReaderOption(
    "zero_is", str, "Of lasers: what range 0 is, no-echo or invalid; else the log decides."
)


def check_zero_is(path: str, zero_is: str | None) -> None:
    """Refuse what is none of the words for it. @raises WrongOption"""
    if zero_is not in (None, NO_ECHO, INVALID):
        raise WrongOption(f"{path}: {key('zero_is')} = {zero_is!r}: must be {NO_ECHO} or {INVALID}")


@dataclass(frozen=True)
class Format:
    """One row of the table of formats: how to recognise it, and how to open it.

    `name`: The word for ``format=``.
    `description`: With its article, for messages: "a CARMEN log".
    `recognises`: Whether a `Source` is of this format. It may raise ValueError where the source is certainly
        of this format, and damaged.
    `open`: ``open(source, **options)`` makes the `Log`.
    `options`: What ``open`` takes.
    `stored_as` ({"file", "folder", "either"}): Nothing else is handed to ``recognises`` and ``open``.
    `contents`: ``contents(source, whole)`` says as a dictionary what else is in it, also where it cannot be
        opened as a log; unless `whole`, at once and from what an index or the beginning says.
    `dim` ({2, 3} or None): Of all logs of the format. None: of each its own, and ``open`` takes ``dim``,
        None, 2 or 3.
    """

    name: str
    description: str
    recognises: Callable[[Source], bool]
    open: Callable[..., Log]
    options: tuple[ReaderOption, ...] = ()
    stored_as: str = "file"
    contents: Callable[[Source, bool], dict[str, Any]] | None = None
    dim: int | None = 3

    def may_be(self, source: Source) -> bool:
        """Whether it is stored as the source is: as a file or as a folder."""
        return self.stored_as in ("either", "folder" if source.is_folder else "file")

    def log(self, source: Source, dim: int | None, options: dict[str, Any]) -> Log:
        """The log of a source; ValueError where it has another dimension than `dim`."""
        if self.dim is None:
            return self.open(source, dim=dim, **options)
        if dim not in (None, self.dim):
            raise WrongValue(
                f"{source.path}: {self.description} is {self.dim}-D, expected {key('dim')}={self.dim}"
            )
        return self.open(source, **options)


def source_of(path: str, expected: str) -> Source:
    """Look at a file or a folder.

    Raises OSError if there is no such file, or it cannot be read; ValueError if it is empty, or gzip cannot
    unpack its beginning; `expected` says what it should have been.
    """
    if os.path.isdir(path):
        return Source(path, b"", tuple(sorted(os.listdir(path))), is_folder=True)
    head, packed = _head(path, expected)
    return Source(path, head, packed=packed)


def _head(path: str, expected: str) -> tuple[bytes, str]:
    """The first bytes, unpacked, cut at the end of a line if there is more; and by what they were packed."""
    with open_plain(path) as file:
        packed = file.packed
        head, damage = file.beginning(HEAD_BYTES)
    if len(head) == HEAD_BYTES or damage:
        whole = head[: head.rfind(b"\n") + 1]
        head = whole if damage else whole or head
    head = head.removeprefix(codecs.BOM_UTF8)
    if damage and not (damage.is_cut_off and head):  # What there is may still tell the format.
        what = "cut off" if damage.is_cut_off else "damaged"
        raise ValueError(f"{path}: the {damage.kind} stream is {what}, expected {expected}")
    if not head.strip():
        raise ValueError(f"{path}: the file is empty, expected {expected}")
    return head, packed
