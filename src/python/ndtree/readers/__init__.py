# SPDX-License-Identifier: BSD-3-Clause
"""Logs in, scans out: one file for each format, recognised by what is in the file."""

from __future__ import annotations

import errno
import gzip
import os
import zlib

from ndtree.readers.carmen import KEYWORDS, CarmenLog
from ndtree.readers.log import Log, SizedLog, open_plain
from ndtree.readers.npz import NpzLog, is_recording
from ndtree.readers.simulated import SimulatedLog, simulate
from ndtree.readers.text import EXPECTED, TextLog, dimension_of, fields_of

__all__ = ["FORMATS", "MAP_MAGIC", "Log", "SimulatedLog", "SizedLog", "read", "simulate"]

FORMATS = ("carmen", "npz", "text")
_KNOWN = "a CARMEN log, an .npz recording, or text with one beam a line"
_HEAD_BYTES = 1 << 18

#: First bytes of a map's own file.
MAP_MAGIC = b"\x89NDT"


def read(path: str | os.PathLike[str], *, format: str | None = None, dim: int | None = None) -> Log:
    """Open a log of range scans.

    Text is read while it is iterated, so that errors far down in a file come only then.

    Parameters
    ----------
    path : str or path
        CARMEN logs and text may be packed by gzip.
    format : {"carmen", "npz", "text"}, optional
        Left out, it is recognised from the content.
    dim : {2, 3}, optional
        Left out, it is what the file says: an .npz recording is 2-D if no point or origin leaves one plane z.

    Returns
    -------
    Log
        An iterable of `Scan` with ``path``, ``format`` and ``dim``.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If the file is not what it should be: which file, where, and what was expected.
    """
    name = os.fspath(path)
    if format is not None and format not in FORMATS:
        raise ValueError(f"format = {format!r}: must be one of {', '.join(FORMATS)}")
    if dim not in (None, 2, 3):
        raise ValueError(f"dim = {dim!r}: must be 2 or 3")
    if os.path.isdir(name):
        raise IsADirectoryError(errno.EISDIR, f"is a directory, expected {_KNOWN}", name)
    head = _head(name)
    if format is None:
        format = _recognised(name, head)
    if format == "npz":
        return NpzLog(name, dim)
    if format == "carmen":
        if dim == 3:
            raise ValueError(f"{name}: a CARMEN log is 2-D, expected dim=2")
        return CarmenLog(name)
    found = _text_dimension(name, head)
    if dim not in (None, found):
        raise ValueError(f"{name}: the first beam is {found}-D, expected dim={found}")
    return TextLog(name, found)


def _head(path: str) -> bytes:
    """The first bytes, unpacked, cut at the end of a line if there is more."""
    try:
        with open_plain(path) as file:
            head = file.read(_HEAD_BYTES)
            if len(head) == _HEAD_BYTES:
                head = head[: head.rfind(b"\n") + 1] or head
    except EOFError:  # Cut off: what there is may still tell the format.
        head = _rescued_head(path)
        if not head:
            raise ValueError(f"{path}: the gzip stream is cut off, expected {_KNOWN}") from None
    except (gzip.BadGzipFile, zlib.error):
        raise ValueError(f"{path}: the gzip stream is damaged, expected {_KNOWN}") from None
    if not head.strip():
        raise ValueError(f"{path}: the file is empty, expected {_KNOWN}")
    return head


def _rescued_head(path: str) -> bytes:
    """The whole lines that can be unpacked of a gzip stream that is cut off."""
    with open(path, "rb") as file:
        try:
            head = zlib.decompressobj(wbits=31).decompress(file.read(_HEAD_BYTES), _HEAD_BYTES)
        except zlib.error:
            return b""
    return head[: head.rfind(b"\n") + 1]


def _recognised(path: str, head: bytes) -> str:
    if head.startswith(b"PK\x03\x04"):
        if is_recording(path):
            return "npz"
        raise ValueError(f"{path}: a zip archive without points.npy, expected {_KNOWN}")
    if head.startswith(MAP_MAGIC):
        raise ValueError(f"{path}: a map, to be opened by ndtree.load(), expected {_KNOWN}")
    if b"\0" in head:
        raise ValueError(f"{path}: binary data, expected {_KNOWN}")
    for number, line in enumerate(head.decode("utf-8", "replace").splitlines(), start=1):
        fields = fields_of(line)
        if not fields:
            continue
        if fields[0] in KEYWORDS:
            return "carmen"
        if dimension_of(fields) is not None:
            return "text"
        start = line.strip()
        start = start if len(start) <= 40 else start[:37] + "..."
        raise ValueError(f"{path}: line {number}: found {start!r}, expected {_KNOWN} ({EXPECTED})")
    raise ValueError(f"{path}: only comments, expected {_KNOWN}")


def _text_dimension(path: str, head: bytes) -> int:
    for number, line in enumerate(head.decode("utf-8", "replace").splitlines(), start=1):
        fields = fields_of(line)
        if not fields:
            continue
        dim = dimension_of(fields)
        if dim is None:
            raise ValueError(f"{path}: line {number}: {EXPECTED}, found {line.strip()[:40]!r}")
        return dim
    raise ValueError(f"{path}: only comments, {EXPECTED}")
