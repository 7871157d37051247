# SPDX-License-Identifier: BSD-3-Clause
"""What is printed of errors and notes: in the words of the command line, in lines that fit a terminal.

A message may have lines of its own: those that are indented are what to type, and stay as they are.
Calls that cannot be read at all are in `ndtree.cli.commands.usage`.
"""

from __future__ import annotations

import os
import sys
import textwrap

from ndtree._errors import WrongOption, spelled
from ndtree.base.options import flag_of

#: A message of more characters than this is parted, and into lines of how many; a narrower terminal counts.
MOST, WIDTH = 159, 110
_NARROWEST = 60


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


def in_words(message: str | Exception) -> str:
    """A message of the library, or an error's, with its options named as flags."""
    if isinstance(message, WrongOption) and message.option:
        kind = "--fixed" if message.refinement == "fixed" else f"--refinement {message.refinement}"
        return f"{flag_of(message.option)}: {kind} has no use for it"
    return spelled(message, flag_of)


def laid_out(message: str | Exception, has_flags: bool = True) -> str:
    """A message as it is printed, behind the program's name: in lines of less than 160 characters.

    `has_flags` is for what was typed; keywords of a file stay as they are.
    """
    first, *more = (in_words(message) if has_flags else spelled(message)).split("\n")
    lines = _parted(f"ndtree: {' '.join(first.split())}")
    for line in more:
        lines += [f"    {line.strip()}"] if line.startswith(" ") else _parted(f"  {' '.join(line.split())}")
    return "\n".join(lines)


def indented(text: str) -> str:
    """What is said below a heading, in lines that fit a terminal."""
    return "\n".join(
        row
        for part in in_words(text).split("\n")
        for row in textwrap.wrap(
            part.strip(),
            line_width(),
            initial_indent="  ",
            subsequent_indent="    ",
            break_long_words=False,
            break_on_hyphens=False,
        )
    )


def _parted(line: str) -> list[str]:
    """A line that is too long as several, without cutting names of files."""
    columns = terminal_width()
    if len(line) <= (MOST if columns is None else min(MOST, columns)):
        return [line]
    return textwrap.wrap(
        line, line_width(), subsequent_indent="  ", break_long_words=False, break_on_hyphens=False
    )
