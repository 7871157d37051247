# SPDX-License-Identifier: BSD-3-Clause
"""Files for reading: regular ones only, unpacked where gzip or bzip2 has packed them, and never endless."""

from __future__ import annotations

import bz2
import codecs
import gzip
import io
import os
import re
import shlex
import stat
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from ndtree.logs.core.arrays import Floats
from ndtree.logs.core.failures import one_line

GZIP_MAGIC = b"\x1f\x8b"
BZIP2_MAGIC = b"BZh"

#: Longer lines are no text of anybody's.
LINE_BYTES = 1 << 24
#: FREE_BYTES are unpacked from however little; beyond that, a packed byte stands for MOST_PACKED at most.
FREE_BYTES, MOST_PACKED = 1 << 26, 1000
_PART = 1 << 17
_LOOKED_AT = 200


class DamagedStream(ValueError):
    """What gzip or bzip2 has packed cannot be unpacked to its end.

    `kind`: "gzip" or "bzip2".
    `is_cut_off`: It only ends too early.
    """

    def __init__(self, message: str, kind: str, is_cut_off: bool) -> None:
        super().__init__(message)
        self.kind = kind
        self.is_cut_off = is_cut_off


def open_regular(path: str | os.PathLike[str]) -> IO[bytes]:
    """Open a file for reading, if it is one: a FIFO would wait for a writer, and a device may have no end.

    Raises OSError if there is none, it cannot be read, or is a folder or anything else; it names the file.
    """
    return open(path, "rb", opener=_opened)


def _opened(path: str, flags: int) -> int:
    handle = os.open(path, flags | os.O_NONBLOCK)
    mode = os.fstat(handle).st_mode
    if stat.S_ISREG(mode):
        return handle
    os.close(handle)
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(21, os.strerror(21), path)
    raise OSError(22, "is not a regular file, expected one", path)


class PlainFile:
    """Content of a file, unpacked on the way.

    Iterating gives its lines, each with its end, the first without a byte order mark. Reading stops with a
    ValueError that names file and line where the file is damaged, where a line is longer than `LINE_BYTES`,
    and where it unpacks to more than any log does: beyond `FREE_BYTES`, `MOST_PACKED` for each byte that is
    packed.

    `line`: Number of the line that was read last, from 1.
    `packed`: "gzip" or "bzip2"; "" for a file that is not packed.
    """

    def __init__(self, path: str, file: IO[bytes]) -> None:
        self.path = path
        self.line = 0
        self._file = file
        magic = file.read(max(len(GZIP_MAGIC), len(BZIP2_MAGIC)))
        file.seek(0)
        raw: Any = None
        self.packed = ""
        if magic.startswith(GZIP_MAGIC):
            self.packed = "gzip"
            raw = _Unpacked(path, self.packed, gzip.GzipFile(fileobj=file), file)
        elif magic == BZIP2_MAGIC:
            self.packed = "bzip2"
            raw = _Unpacked(path, self.packed, bz2.BZ2File(file), file)
        self._content: Any = file if raw is None else io.BufferedReader(raw, _PART)

    @property
    def place(self) -> int:
        """How much of the file, packed as it is, has been read [bytes]."""
        return self._file.tell()

    def __iter__(self) -> Iterator[bytes]:
        readline = self._content.readline
        while True:
            try:
                line = readline(LINE_BYTES + 1)
            except DamagedStream as error:
                what = f"{self.path}: after line {self.line}: {error}, expected a whole one"
                raise DamagedStream(what, error.kind, error.is_cut_off) from None
            if not line:
                return
            self.line += 1
            if self.line == 1 and line.startswith(codecs.BOM_UTF8):
                line = line[len(codecs.BOM_UTF8) :] or b"\n"
            if len(line) > LINE_BYTES:
                most = f"{LINE_BYTES >> 20} MiB"
                raise ValueError(f"{self.path}: line {self.line}: longer than {most}, expected text")
            yield line

    def read(self, size: int) -> bytes:
        """At most `size` bytes: fewer at the end."""
        content: bytes = self._content.read(size)
        return content

    def beginning(self, size: int) -> tuple[bytes, DamagedStream | None]:
        """The first bytes, and why there are fewer than asked for, if that is because of damage."""
        head = b""
        try:
            while len(head) < size:
                part = self._content.read1(size - len(head))
                if not part:
                    break
                head += part
        except DamagedStream as error:
            return head, error
        return head, None


class _Unpacked(io.RawIOBase):
    """What is packed, as far as it may be unpacked."""

    def __init__(self, path: str, kind: str, stream: Any, file: IO[bytes]) -> None:
        self._path, self._kind, self._stream, self._file = path, kind, stream, file
        self._count = 0

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        try:
            part = self._stream.read1(len(buffer))
        except EOFError:
            raise DamagedStream(f"the {self._kind} stream is cut off or damaged", self._kind, True) from None
        except (OSError, zlib.error) as error:
            if isinstance(error, OSError) and error.errno is not None:
                raise  # Not what the unpackers say of their data.
            what = f"the {self._kind} stream is cut off or damaged ({one_line(error)})"
            raise DamagedStream(what, self._kind, False) from None
        self._count += len(part)
        if self._count > FREE_BYTES + MOST_PACKED * self._file.tell():
            said = f"{self._file.tell()} bytes of {self._kind} unpack to more than {self._count >> 20} MiB"
            raise ValueError(f"{self._path}: {said}, expected at most {MOST_PACKED} for one")
        buffer[: len(part)] = part
        return len(part)


@contextmanager
def open_plain(path: str | os.PathLike[str]) -> Iterator[PlainFile]:
    """Open a file for reading; what gzip or bzip2 has packed is unpacked on the way."""
    with open_regular(path) as file:
        yield PlainFile(os.fspath(path), file)


def wrongly_written(head: bytes) -> tuple[str, str] | None:
    """Why a text cannot be read, by its beginning, and the command that mends it; None if it can, or is none.

    The command has ``{}`` where the file's name belongs.
    """
    for mark, name in ((codecs.BOM_UTF16_LE, "UTF-16"), (codecs.BOM_UTF16_BE, "UTF-16")):
        if head.startswith(mark):
            return "text in UTF-16", f"iconv -f {name} -t UTF-8 {{}} > text.csv"
    first = head[:_LOOKED_AT]
    if len(first) > 3 and b"\0" in first:
        for name, letters, zeros in (
            ("UTF-16LE", first[::2], first[1::2]),
            ("UTF-16BE", first[1::2], first[::2]),
        ):
            if not any(zeros) and _is_ascii_text(letters):
                return "text in UTF-16", f"iconv -f {name} -t UTF-8 {{}} > text.csv"
    elif b"\r" in first.rstrip() and b"\n" not in head and _is_ascii_text(first):
        return "text whose lines end as on old Macs", "tr '\\r' '\\n' < {} > text.csv"
    return None


def _is_ascii_text(head: bytes) -> bool:
    return all(9 <= byte <= 13 or 32 <= byte < 127 for byte in head)


def text_lines(path: str | os.PathLike[str]) -> Iterator[tuple[int, str]]:
    """Lines of a text file, packed or not, with their numbers from 1; bytes that are no UTF-8: U+FFFD."""
    with open_plain(path) as file:
        for line in file:
            if file.line == 1 and (wrong := wrongly_written(line)) is not None:
                raise ValueError(f"{file.path}: {wrong[0]}:\n  {wrong[1].format(shlex.quote(file.path))}")
            yield file.line, line.decode("utf-8", "replace")


_DECIMAL_COMMA = re.compile(rb"[-+]?\d*,\d+(?:[eE][-+]?\d+)?|[-+]?\d+")


def separator_of(line: bytes) -> tuple[bytes | None, bool]:
    """What separates the fields of a line, None for blanks, and whether its commas are decimal points."""
    if b";" in line:
        return b";", b"," in line
    fields = line.split()
    if b"," in line and len(fields) >= 3 and all(_DECIMAL_COMMA.fullmatch(field) for field in fields):
        return None, True
    return (b",", False) if b"," in line else (None, False)


def with_points(line: str) -> str:
    """A line with decimal points where it has decimal commas."""
    if "," in line and separator_of(line.encode())[1]:
        return line.replace(",", ".")
    return line


def are_numbers(fields: list[str]) -> bool:
    """Whether there are fields, and all are numbers."""
    try:
        return bool([float(field) for field in fields])
    except ValueError:
        return False


def table_of(lines: Sequence[bytes], width: int) -> Floats | None:
    """(n, width) numbers of some lines; None where they are others."""
    if not any(line.strip() for line in lines):
        return None
    try:
        table = np.loadtxt(lines, comments=None, ndmin=2, dtype=np.float64)
    except ValueError:
        return None
    return table if table.shape == (len(lines), width) else None


def numbers_of(fields: Sequence[bytes], kind: np.dtype[Any]) -> NDArray[Any]:
    """Numbers in text, in a type if it is one of floating point; ValueError if one is none."""
    if not fields:
        return np.zeros(0, np.float32)
    return np.array(fields, dtype="S").astype(np.float64).astype(kind if kind.kind == "f" else np.float64)


def wrong_line(path: str, number: int, found: str | bytes, expected: str) -> ValueError:
    """The error of a line, or a part of it, that is not what was expected."""
    text = found.decode("utf-8", "replace") if isinstance(found, bytes) else found
    return ValueError(f"{path}: line {number}: found {text.strip()[:40]!r}, expected {expected}")


def floats_of(path: str, number: int, fields: list[str]) -> list[float]:
    """Numbers of a line's fields; ValueError if one is none."""
    if fields and not are_numbers(fields):
        raise wrong_line(path, number, " ".join(fields), "only numbers")
    return [float(field) for field in fields]
