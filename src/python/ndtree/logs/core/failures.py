# SPDX-License-Identifier: BSD-3-Clause
"""What goes wrong while a file is read, as one clear line that names it: one place for all readers."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager

from ndtree._errors import WrongOption, WrongValue, located

#: Characters of what a library said, or of a value, that a message repeats.
MOST_SHOWN = 200
_DIGITS = re.compile(r"\d{41,}")
#: What Rust's libraries raise, which Python does not count among its exceptions.
_PANIC = "PanicException"


@contextmanager
def at_place(where: str, expected: str = "") -> Iterator[None]:
    """A ValueError within says where, and where `expected` is given, what that was."""
    try:
        yield
    except ValueError as error:
        said = f"expected {expected} ({one_line(error)})" if expected else f"{error}"
        raise ValueError(f"{where}: {said}") from None


@contextmanager
def readable(path: str | None, what: str = "cannot be read", *, foreign: bool = False) -> Iterator[None]:
    """Whatever reading a file runs into becomes an error that names it.

    Errors that say it already pass as they are: ValueError with a file's name, OSError with one,
    ImportError, `WrongOption`. Others of these get the name. MemoryError stays one. Anything else becomes a
    ValueError with the original as its cause: libraries at the mercy of foreign bytes raise whatever comes.

    `path`: The file; None passes everything, for logs that have none.
    `what`: What could not be done, as in "cannot be read as a ROS bag".
    `foreign`: All is done by a library: its ValueErrors say nothing without `what`.
    """
    try:
        yield
    except (KeyboardInterrupt, SystemExit, GeneratorExit):
        raise
    except BaseException as error:
        if path is None or not (isinstance(error, Exception) or type(error).__name__ == _PANIC):
            raise
        clear = _clear(path, what, error, foreign)
        if clear is error:
            raise
        raise clear from error


def one_line(error: BaseException) -> str:
    """An exception's message in one line, not too long; its kind where it says nothing."""
    return shown(str(error)) or type(error).__name__


def shown(value: object, most: int = MOST_SHOWN) -> str:
    """A value's text in one line of at most `most` characters, whatever it is."""
    text = str(value)
    cut = len(text) > 4 * most
    text = _shortened(" ".join(text[: 4 * most].split()))
    return text if len(text) <= most and not cut else text[: most - 3] + "..."


def some_of(names: Sequence[str], most: int = 24) -> str:
    """Names for errors: the first ones, and whether there are more."""
    return ", ".join([*names[:most], *(["..."] if len(names) > most else [])])


def _clear(path: str, what: str, error: BaseException, foreign: bool) -> BaseException:
    if isinstance(error, (ImportError, WrongOption)):
        return error
    if isinstance(error, MemoryError):
        return MemoryError(f"{path}: not enough memory to read it")
    if isinstance(error, OSError):
        if error.filename is not None:
            return error
        if error.errno is not None:
            return OSError(error.errno, error.strerror, path)
    elif isinstance(error, ValueError) and not isinstance(error, UnicodeError):
        text = _shortened(str(error))
        if isinstance(error, WrongValue):
            return error if _names_a_file(text, path) else located(path, error)
        if _names_a_file(text, path):
            return error if text == str(error) else ValueError(text)
        if type(error) is ValueError and not foreign:
            return ValueError(f"{path}: {text}")
    said = one_line(error)
    kind = type(error).__name__
    return ValueError(f"{path}: {what}, cut off or damaged ({said if said == kind else f'{kind}: {said}'})")


def _names_a_file(text: str, path: str) -> bool:
    return path in text or os.path.exists(text.partition(": ")[0])


def _shortened(text: str) -> str:
    """Without numbers of hundreds of digits."""
    return _DIGITS.sub(lambda found: f"{found[0][:8]}...({len(found[0])} digits)", text)


class NoPose(ValueError):
    """A time at which a pose is not known.

    `where` ({"before", "after", "in a gap"}): On which side of the poses that are known.
    `seconds`: How far outside of them, or how long the gap is.
    """

    def __init__(self, message: str, where: str, seconds: float) -> None:
        super().__init__(message)
        self.where, self.seconds = where, seconds


class NowhereKnown(WrongValue):
    """Scans of which nothing says where they were taken, and how to say it."""


class NotALog(ValueError):
    """A file or folder whose kind is known, but that alone is no log.

    `kind`: With its article: "a PNG image".
    `help`: What helps, each a command or half a sentence; the best first.
    `has_points`: It can be read with ``points_only``.
    """

    def __init__(self, path: str, kind: str, help: Iterable[str] = (), *, has_points: bool = False) -> None:
        self.kind, self.help, self.has_points = kind, tuple(help), has_points
        ways = "".join(f"\n  {way}" for way in self.help)
        super().__init__(f"{path}: {kind}{f'; try{ways}' if ways else ', expected a log'}")
