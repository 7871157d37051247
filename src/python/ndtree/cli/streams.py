# SPDX-License-Identifier: BSD-3-Clause
"""Standard output and error while a command says nothing but what is wrong."""

from __future__ import annotations

import io
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from typing import TextIO


class Silent(io.TextIOBase):
    """A stream that says nothing; what must be said goes to the one whose place it takes."""

    def __init__(self, stream: TextIO) -> None:
        self.heard = stream

    def write(self, text: str) -> int:
        return len(text)


def heard(stream: TextIO) -> TextIO:
    """A stream, also where a command says nothing."""
    return stream.heard if isinstance(stream, Silent) else stream


@contextmanager
def silenced(quiet: bool) -> Iterator[None]:
    """While a command says nothing but what is wrong, if it is to."""
    if not quiet:
        yield
        return
    with redirect_stdout(Silent(sys.stdout)), redirect_stderr(Silent(sys.stderr)):  # type: ignore[type-var]
        yield
