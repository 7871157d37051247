# SPDX-License-Identifier: BSD-3-Clause
"""Errors that carry the names of options and their values, so that each front end spells them in its own way.

What Python calls ``no_return`` is ``--no-return`` on the command line, and a parameter of the nodes. Texts
name an option by `key`, and `spelled` puts in the name that is read. This module imports nothing of the
package, so every folder may use it.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

#: Around an option's name: invisible where a text is printed as it is.
_MARK = "\u2063"
_KEY = re.compile(f"{_MARK}(\\w+){_MARK}(?P<set> ?= ?(?P<quote>'(?P<value>[^']*)')?)?")


def key(name: str) -> str:
    """An option's name for a text."""
    return f"{_MARK}{name}{_MARK}"


def leading_key(text: str) -> str:
    """Name of the option that a text begins with; empty if it begins with none."""
    found = _KEY.match(text)
    return found[1] if found else ""


def marked(text: Any) -> str:
    """A text, or an error's, with its options as `key` has them."""
    return str(getattr(text, "marked", text))


def spelled(text: Any, spell: Callable[[str], str] | None = None, equals: str = " ") -> str:
    """A text, or an error's, in which a front end has spelled the names of options.

    Parameters
    ----------
    text : str or Exception
    spell : callable, optional
        Of an option's name, that of the front end. Without: as keywords of Python.
    equals : str
        What stands between the front end's name and a value: a blank, as it is typed.
    """
    if spell is None:
        return marked(text).replace(_MARK, "")
    if isinstance(text, WrongValue) and text.option:
        value = text.value.removesuffix(".0").replace(".0 ", " ").strip("[]").replace("'", "")
        head = f"{text.where}: " if text.where else ""
        said = f"{key(text.option)} = {value}: must be {text.expected}"
        return head + spelled(said, spell, equals)
    return _KEY.sub(
        lambda found: spell(found[1]) + equals * bool(found["set"]) + (found["value"] or ""), marked(text)
    )


def naming(error: ValueError, *options: str) -> WrongValue:
    """An error of the library, in whose text these options are as `key` has them."""
    if isinstance(error, WrongValue):
        return error
    return WrongValue(re.sub(rf"\b({'|'.join(options)})\b", lambda found: key(found[1]), str(error)))


class Text(str):
    """A text with options, which are keywords of Python where it is printed as it is."""

    marked: str

    def __new__(cls, text: str) -> Text:
        made = super().__new__(cls, spelled(text))
        made.marked = marked(text)
        return made


class _Spelled(Exception):
    """Of an error with options in its message, which stand there as keywords of Python."""

    def __init__(self, message: str) -> None:
        super().__init__(spelled(message))
        self.marked = marked(message)

    def __reduce__(self) -> Any:
        return _again, (type(self), self.__dict__)


def _again(kind: Any, state: dict[str, Any]) -> Any:
    made = kind(state["marked"])
    made.__dict__.update(state)
    return made


class WrongValue(_Spelled, ValueError):
    """A value that cannot be taken.

    Attributes
    ----------
    option : str
        Its name, a keyword of Python; empty where the message names none or several.
    value : str
        As it is written, with its unit.
    expected : str
        What it must be, in which other options are as `key` has them.
    where : str
        The file or the place in it; empty if it is wrong everywhere.
    """

    option = value = expected = where = ""

    @classmethod
    def of(cls, option: str, value: Any, expected: str) -> WrongValue:
        """Of one option; `expected` stands behind "must be"."""
        made = cls(f"{key(option)} = {value}: must be {expected}")
        made.option, made.value, made.expected = option, str(value), str(expected)
        return made

    @classmethod
    def of_library(cls, option: str, value: str, expected: str, other: str, of_other: str) -> WrongValue:
        """Of the library's `OptionError`; other options may stand behind the value, as in "7, dim = 2"."""
        value = re.sub(r"(?<=, )(\w+)(?= = )", lambda found: key(found[1]), value)
        expected += (key(other) if other else "") + of_other
        return cls.of(option, value, expected) if value else cls(f"{key(option)}: {expected}")


class WrongOption(_Spelled, TypeError):
    """An option that a map, or a format, does not take, or not together with another.

    Attributes
    ----------
    option : str
        Its name, of an option that a map does not read; else empty.
    refinement : str
        That of the map.
    """

    option = refinement = ""

    @classmethod
    def unread(cls, message: str, option: str, refinement: str) -> WrongOption:
        """Of an option that maps of a refinement have no use for."""
        made = cls(message)
        made.option, made.refinement = option, refinement
        return made


def located(where: Any, error: Exception) -> ValueError:
    """A ValueError that says the same of a place: a file, or one in it."""
    made = WrongValue(f"{where}: {marked(error)}")
    if isinstance(error, WrongValue):
        made.option, made.value, made.expected = error.option, error.value, error.expected
        made.where = f"{where}: {error.where}" if error.where else str(where)
    return made
