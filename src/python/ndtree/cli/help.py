# SPDX-License-Identifier: BSD-3-Clause
"""The pages of ``--help`` and ``--help-all``, which are files, so that they come at once.

`ndtree.cli.commands.pages` makes them of the commands; a test compares, and NDTREE_UPDATE_DOCS=1 writes them.
"""

from __future__ import annotations

import os
from collections.abc import Sequence

FOLDER = os.path.join(os.path.dirname(os.path.abspath(__file__)), "pages")
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
    return page(command if is_first else "ndtree", whole=whole)


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
