# SPDX-License-Identifier: BSD-3-Clause
"""The pages of ``--help`` and ``--help-all``, which are files, so that they come at once.

`ndtree.cli.commands.pages` makes them of the commands; a test compares, and NDTREE_UPDATE_DOCS=1 writes them.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Sequence

FOLDER = os.path.join(os.path.dirname(os.path.abspath(__file__)), "pages")
#: Columns of a page, and of the names of options in it.
WIDTH, LEFT = 100, 26
#: A line with something said behind a name.
_ENTRY = re.compile(r"(  \S.*?\s{2,})(\S.*)$")
HELP, HELP_ALL = ("-h", "--help"), "--help-all"


def page_asked_for(arguments: Sequence[str]) -> str | None:
    """The page that a call asks for, of its words behind ``ndtree``; None if it asks for none."""
    words = list(arguments)
    words = words[: words.index("--")] if "--" in words else words
    whole = HELP_ALL in words
    if not whole and not set(HELP) & set(words):
        return None
    command = next((word for word in words if not word.startswith("-")), "ndtree")
    is_first = bool(words) and words[0] == command
    found = page(command if is_first else "ndtree", whole=whole)
    return None if found is None else fitted(found, _columns())


def _columns() -> int:
    """Of the terminal that is written to; many where there is none."""
    try:
        if sys.stdout.isatty():
            return os.get_terminal_size(sys.stdout.fileno()).columns
    except (AttributeError, OSError, ValueError):  # Closed, or no file.
        pass
    return WIDTH


def fitted(text: str, columns: int) -> str:
    """A page in lines of at most `columns`; what is to be typed stays as it is."""
    if columns >= WIDTH:
        return text
    import textwrap  # Wide terminals have no use for it.

    entries: list[tuple[str, str]] = []  # What stands at the left, and what is said of it.
    for line in text.splitlines():
        said = line.lstrip()
        indent = len(line) - len(said)
        begins = _ENTRY.match(line)
        if entries and said and indent and indent in (len(entries[-1][0]), LEFT + 2):
            left, before = entries[-1]
            entries[-1] = (left, f"{before} {said}".lstrip())
        elif begins is not None and not line.startswith("  ndtree "):
            entries.append((begins[1], begins[2]))
        else:
            entries.append((line, ""))
    width = max(columns, 2 * LEFT)
    lines: list[str] = []
    for left, said in entries:
        is_alone = not said or len(left.rstrip()) > LEFT
        if is_alone:
            is_prose = bool(left) and not left.startswith((" ", "usage:", "more:"))
            lines += textwrap.wrap(left, width) if is_prose else [left]
        if said:
            indent = " " * (LEFT + 2 if is_alone else len(left))
            lines += textwrap.wrap(
                said,
                width,
                initial_indent=indent if is_alone else left,
                subsequent_indent=indent,
                break_on_hyphens=False,
                break_long_words=False,
            )
    return "\n".join(lines) + "\n"


def page(command: str, *, whole: bool = False) -> str | None:
    """A command's page; None if there is no such command."""
    try:
        with open(path_of(command, whole=whole), encoding="utf-8") as file:
            return file.read()
    except OSError:
        return None


def path_of(command: str, *, whole: bool = False) -> str:
    """The file of a page."""
    name = os.path.basename(command)
    return os.path.join(FOLDER, f"{name}-all.txt" if whole and name != "ndtree" else f"{name}.txt")
