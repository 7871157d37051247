# SPDX-License-Identifier: BSD-3-Clause
"""The pages of ``--help``, made of the commands and the table of options."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

from ndtree.base.option import Option
from ndtree.base.options import QUESTIONS, options_of
from ndtree.cli.commands import COMMANDS, every
from ndtree.cli.commands.app import USUAL
from ndtree.cli.commands.whole_page import (
    arguments,
    entry,
    examples,
    flags_of,
    head,
    option,
    plain,
    whole_page,
)

#: Lines of a page of ``--help``.
MOST_LINES = 30
_EXAMPLES = 3


def pages() -> dict[tuple[str, bool], str]:
    """Every page, by command and whether it is the one of ``--help-all``; "ndtree" is that of them all."""
    found = {("ndtree", False): _first_page()}
    for name, command in every().items():
        found[name, False] = _short(name, command)
        found[name, True] = whole_page(name, command)
    return found


def _first_page() -> str:
    lines = ["usage: ndtree COMMAND [ARGUMENTS] [OPTIONS]", ""]
    lines += ["Occupancy maps whose cells adapt to the measurements.", ""]
    for name, command in every().items():
        lines += entry(name, re.split(r"[:.](?: |$)", plain(command.help))[0] + ".", 12)
    lines += ["", "Each with --help, --quiet, and most with --json."]
    lines += entry("--version", "Print the version.", 22)
    lines += entry("--install-completion", "The Tab key completes commands and flags.", 22)
    lines += ["", "first steps: ndtree demo; ndtree map LOG; ndtree info FILE"]
    lines += ["exit status: 0 done, 1 the input is bad, 2 the call is wrong, 130 after Ctrl-C"]
    return "\n".join(lines) + "\n"


def _short(name: str, command: Any) -> str:
    by_name = {one.name: one for one in options_of(name)}
    lines = [*head(name, command), "", *arguments(command)]
    if "output" in by_name:
        lines += option(name, by_name["output"])
    lines.append("")
    for one in USUAL[name]:
        lines += option(name, by_name[one])
    lines += ["", *examples(command, _EXAMPLES), f"more: ndtree {name} --help-all"]
    return "\n".join(lines) + "\n"


def table_of_options() -> Iterable[tuple[str, list[tuple[str, str, str, str]]]]:
    """By question: flag with its value, default, when to touch it, and the commands that take it."""
    for question, options in QUESTIONS.items():
        found: dict[str, list[Option]] = {}
        for one in options:
            if one.of != "node":
                found.setdefault(flags_of(one), []).append(one)
        rows = []
        for flags, same in found.items():
            takers = [name for name in COMMANDS if any(one.taken_by(name) for one in same)]
            first = next(name for name in COMMANDS if same[0].taken_by(name))
            rows.append((flags, same[0].shown(first), same[0].when, ", ".join(takers)))
        if rows:
            yield question, rows
