# SPDX-License-Identifier: BSD-3-Clause
"""What all logs have in common, and the lines of text files, compressed or not."""

from __future__ import annotations

import gzip
import zlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import IO

from ndtree.scan import Scan

GZIP_MAGIC = b"\x1f\x8b"


class Log(ABC):
    """An iterable of `Scan`; every loop starts again from the first.

    Attributes
    ----------
    path : str or None
        The file; None for a simulated log.
    format : str
        "carmen", "npz", "text" or "simulated".
    dim : int
        Number of coordinates of a point.
    """

    format: str

    def __init__(self, path: str | None, dim: int) -> None:
        self.path = path
        self.dim = dim

    @property
    def name(self) -> str:
        """How reports call the log: by its path."""
        return self.path or self.format

    @abstractmethod
    def __iter__(self) -> Iterator[Scan]: ...

    def __repr__(self) -> str:
        return f"<{self.format} log {self.path or self.name!r}, {self.dim}-D>"


class SizedLog(Log):
    """A log that knows its number of scans without being read."""

    @abstractmethod
    def __len__(self) -> int: ...

    def __repr__(self) -> str:
        return f"<{self.format} log {self.path or self.name!r}, {self.dim}-D, {len(self)} scans>"


@contextmanager
def open_plain(path: str) -> Iterator[IO[bytes]]:
    """Open a file for reading; what gzip has packed is unpacked on the way."""
    with open(path, "rb") as file:
        packed = file.read(len(GZIP_MAGIC)) == GZIP_MAGIC
        file.seek(0)
        if not packed:
            yield file
            return
        with gzip.GzipFile(fileobj=file) as unpacked:
            yield unpacked


def parsed_lines(path: str, parse: Callable[[str], Scan | None]) -> Iterator[Scan]:
    """Scans that a parser finds in the lines of a file; its errors get the file's name."""
    number = 0
    with open_plain(path) as file:
        try:
            for line in file:
                number += 1
                scan = parse(line.decode("utf-8", "replace").rstrip("\r\n"))
                if scan is not None:
                    yield scan
        except (EOFError, gzip.BadGzipFile, zlib.error):
            raise ValueError(
                f"{path}: behind line {number}: the gzip stream is cut off or damaged, expected a whole one"
            ) from None
