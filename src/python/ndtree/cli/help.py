# SPDX-License-Identifier: BSD-3-Clause
"""The pages of ``--help``, which are files, so that they come at once.

`ndtree.cli.commands.pages` makes them of the commands; a test compares, and NDTREE_UPDATE_DOCS=1 writes them.
Those of ``--help-all`` are made when they are asked for.
"""

from __future__ import annotations

import os
from collections.abc import Sequence

FOLDER = os.path.join(os.path.dirname(os.path.abspath(__file__)), "pages")
HELP, HELP_ALL = ("-h", "--help"), "--help-all"


def page_asked_for(arguments: Sequence[str]) -> str | None:
    """The page in a file that a call asks for, of its words behind ``ndtree``; None if it asks for none."""
    words = _before_dashes(arguments)
    if not {*HELP, HELP_ALL} & set(words):
        return None
    command = next((word for word in words if not word.startswith("-")), "ndtree")
    is_first = bool(words) and words[0] == command
    return None if is_first and HELP_ALL in words else page(command if is_first else "ndtree")


def asks_for_all(arguments: Sequence[str]) -> bool:
    """Whether the words behind a command ask for all of its options."""
    return HELP_ALL in _before_dashes(arguments)


def _before_dashes(words: Sequence[str]) -> list[str]:
    return list(words[: words.index("--")] if "--" in words else words)


def page(command: str) -> str | None:
    """A command's page; None if there is no such command."""
    try:
        with open(path_of(command), encoding="utf-8") as file:
            return file.read()
    except OSError:
        return None


def path_of(command: str) -> str:
    """The file of a page."""
    return os.path.join(FOLDER, f"{os.path.basename(command)}.txt")
