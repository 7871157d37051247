# SPDX-License-Identifier: BSD-3-Clause
"""What is printed of errors and notes: in the words of the command line, in lines that fit a terminal.

What the library says of a keyword, as ``min_cell_size = -1``, becomes what was typed: ``--min-cell-size -1``.
A message may have lines of its own: those that are indented are what to type, and stay as they are.
Calls that cannot be read at all are in `ndtree.cli.commands.usage`.
"""

from __future__ import annotations

import os
import re
import sys
import textwrap

from ndtree.cli.commands.flags import flag_of
from ndtree.logs import READER_OPTIONS
from ndtree.maps.kinds import MAP_OPTIONS

#: A message of more characters than this is parted, and into lines of how many; a narrower terminal counts.
MOST, WIDTH = 159, 110
_NARROWEST = 60

_OF_READERS = "|".join([option.name for option in READER_OPTIONS] + ["format", "strict", "keep_going"])
#: How readers name their options in errors, for Python.
_NAMED = re.compile(
    rf"(?<![\w/.-])(?:(?P<set>{_OF_READERS}) ?= ?(?=\S)|(?:(?<=^)|(?<=: ))(?P<of>{_OF_READERS})(?=: )"
    rf"|(?P<as>{_OF_READERS})(?= as one of)|(?<=expected )(?P<dim>dim)=(?=\d)"
    rf"|(?:the )?option (?P<option>{_OF_READERS})\b)"
)
#: Several of them, which exclude each other, or which a format takes.
_LISTED_OF_READERS = re.compile(
    rf"(?:{_OF_READERS})(?: and (?:{_OF_READERS}))+(?=: expected one of them)|(?<=it takes )[\w, ]+$"
)
_OTHERS = (
    "max_range", "no_return", "cell_size", "tile_size", "max_resident", "held_out", "min_range", "save_every",
)  # fmt: skip
_NAMES = "|".join(
    (*sorted((one.name for one in MAP_OPTIONS if "_" in one.name), key=len, reverse=True), *_OTHERS)
)
#: Anywhere these are nothing but options.
_OPTION = re.compile(
    rf"(?<![\w/.-])(?!range_sigma = \S+ m of beam)(?P<name>{_NAMES})(?:(?P<set> = )|(?=: )|(?=[ ,;]|$))"
)
#: These are words, too: they are options where a message begins with them.
_WORD = re.compile(
    r"^(?P<name>box|origin|every|stride|start|stop|min_range|height|states|faces|window|format|branching|refinement|seed|scans|dim)"
    r"(?:(?P<set> = )|(?=: ))"
)
#: Of the maps' constructors, which name what they do not take.
_UNREAD = re.compile(r"^\w+Map\(\): the refinement '(?P<by>\w+)' does not read (?P<name>\w+)$")
_OF_FIXED = re.compile(r"^FixedMap\(\): no option (?P<name>\w+): .*$")
#: Names in a list of what is read instead, where they are no flags yet.
_LISTED = re.compile(r"(?<![-\w])(height|states|faces)\b")
_PHRASES = (
    (re.compile(r"\bneither start nor stop\b"), "neither --from nor --to"),
    (re.compile(r"^map '([^']*)'"), r"--maps \1"),
    (re.compile(r"(--from \S+ s), stop = (.*) start < stop$"), r"\1, --to \2 --from < --to"),
    (re.compile(r", dim = (\d): must be branching"), r", --dim \1: must be branching"),
    # A value as it was typed, not as Python writes it.
    (re.compile(r"(--[\w-]+) \['([^']*)'\]"), r"\1 \2"),
    (re.compile(r"(--[\w-]+) '([^']*)'"), r"\1 \2"),
    (re.compile(r"^box from \["), "--box from ["),
    (re.compile(r"\ba map with dim = (\d)\b"), r"a \1-D map"),
    (re.compile(r"(--[\w-]+ \d+)\.0(?= m\b)"), r"\1"),
    (re.compile(r"(?<= does not read it, but )(.*)$"), lambda found: _LISTED.sub(r"--\1", found[1])),
    (re.compile(r"(?<=\d)\.0(?= to -?\d|(?: \w+)?: )"), ""),
)


def terminal_width() -> int | None:
    """Columns of the terminal that is written to; None where there is none."""
    for stream in (sys.stdout, sys.stderr):
        try:
            if stream.isatty():
                return max(os.get_terminal_size(stream.fileno()).columns, _NARROWEST)
        except (AttributeError, OSError, ValueError):  # Closed, or no file.
            continue
    return None


def line_width() -> int:
    """How long lines are that were parted."""
    columns = terminal_width()
    return WIDTH if columns is None else min(WIDTH, columns)


def _in_flags(text: str) -> str:
    """A message of a reader with its options named as flags."""
    text = _NAMED.sub(
        lambda found: flag_of(found[found.lastgroup or 0]) + " " * bool(found["set"] or found["dim"]), text
    )
    return _LISTED_OF_READERS.sub(
        lambda found: re.sub(_OF_READERS, lambda one: flag_of(one[0]), found[0]), text
    )


def in_words(text: str) -> str:
    """A message of the library with its keywords named as flags."""
    text = _UNREAD.sub(
        lambda found: f"{flag_of(found['name'])}: --refinement {found['by']} has no use for it", text
    )
    text = _OF_FIXED.sub(lambda found: f"{flag_of(found['name'])}: --fixed has no use for it", text)
    text = _in_flags(text)
    for pattern in (_OPTION, _WORD):
        text = pattern.sub(lambda found: flag_of(found["name"]) + " " * bool(found["set"]), text)
    for phrase, better in _PHRASES:
        text = phrase.sub(better, text)
    return text


def laid_out(message: str, has_flags: bool = True) -> str:
    """A message as it is printed, behind the program's name: in lines of less than 160 characters.

    `has_flags` is for what was typed; keywords of a file stay as they are.
    """
    first, *more = (in_words(message) if has_flags else message).split("\n")
    lines = _parted(f"ndtree: {' '.join(first.split())}")
    for line in more:
        lines += [f"    {line.strip()}"] if line.startswith(" ") else _parted(f"  {' '.join(line.split())}")
    return "\n".join(lines)


def _parted(line: str) -> list[str]:
    """A line that is too long as several, without cutting names of files."""
    columns = terminal_width()
    if len(line) <= (MOST if columns is None else min(MOST, columns)):
        return [line]
    return textwrap.wrap(
        line, line_width(), subsequent_indent="  ", break_long_words=False, break_on_hyphens=False
    )
