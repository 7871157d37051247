# SPDX-License-Identifier: BSD-3-Clause
"""What the pages of ``--help`` and ``--help-all`` say, made of the commands and the table of options."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable
from typing import Any

from ndtree.base.option import Option
from ndtree.base.options import QUESTIONS, options_of
from ndtree.cli.commands import COMMANDS, every
from ndtree.cli.commands.app import USUAL

#: Columns of a page, and of the names of options in it.
WIDTH, LEFT = 80, 24
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


def flags_of(option: Option) -> str:
    """An option's flags, the shortest first, with what is typed behind; also what turns a switch off."""
    on, _, off = (option.flags or option.flag).partition("/")
    flags = sorted(on.split(), key=len) + [off] * bool(off)
    return f"{', '.join(flags)} {option.placeholder}".strip()


def _first_page() -> str:
    lines = ["usage: ndtree COMMAND [ARGUMENTS] [OPTIONS]", ""]
    lines += ["Occupancy maps whose cells adapt to the measurements.", ""]
    for name, command in every().items():
        lines += _entry(name, re.split(r"[:.](?: |$)", _plain(command.help))[0] + ".", 12)
    lines += ["", "Each with --help, --quiet, and most with --json."]
    lines += _entry("--version", "Print the version.", 22)
    lines += _entry("--install-completion", "The Tab key completes commands and flags.", 22)
    lines += ["", "first steps: ndtree demo; ndtree map LOG; ndtree info FILE"]
    lines += ["exit status: 0 done, 1 the input is bad, 2 the call is wrong, 130 after Ctrl-C"]
    return "\n".join(lines) + "\n"


def _short(name: str, command: Any) -> str:
    by_name = {one.name: one for one in options_of(name)}
    lines = [*_head(name, command), "", *_arguments(command)]
    if "output" in by_name:
        lines += _option(name, by_name["output"])
    lines.append("")
    for one in USUAL[name]:
        lines += _option(name, by_name[one])
    lines += ["", *_examples(command, _EXAMPLES), f"more: ndtree {name} --help-all"]
    return "\n".join(lines) + "\n"


def whole_page(name: str, command: Any) -> str:
    """A command's page with all of its options."""
    paragraphs = [_plain(part) for part in (command.help or "").split("\n\n")[1:]]
    lines = _head(name, command)
    for paragraph in paragraphs:
        lines += ["", *textwrap.wrap(paragraph, WIDTH)]
    lines += ["", *_arguments(command)]
    for question, options in QUESTIONS.items():
        mine = [one for one in options if one.taken_by(name)]
        lines += ["", question] if mine else []
        for one in mine:
            lines += _option(name, one)
    lines += ["", *_examples(command, 99)]
    return "\n".join(lines) + "\n"


def _is_option(parameter: Any) -> bool:
    return parameter.param_type_name == "option" and parameter.name != "help"


def _head(name: str, command: Any) -> list[str]:
    shown = [(one.metavar or one.name.upper(), one) for one in command.params if not _is_option(one)]
    words = [word if one.required else f"[{word}]" for word, one in shown]
    summary = _plain((command.help or "").split("\n\n")[0])
    return [f"usage: ndtree {name} {' '.join(words)} [OPTIONS]", "", *textwrap.wrap(summary, WIDTH)]


def _arguments(command: Any) -> list[str]:
    lines: list[str] = []
    for one in command.params:
        if not _is_option(one):
            lines += _entry(one.metavar or one.name.upper(), _plain(one.help))
    return lines


def _option(command: str, option: Option) -> list[str]:
    return _entry(flags_of(option), f"{option.help.rstrip('.')} (default: {option.shown(command)}).")


def _entry(left: str, right: str, width: int = LEFT) -> list[str]:
    lines = textwrap.wrap(right, WIDTH - width - 2, break_on_hyphens=False) or [""]
    if len(left) > width - 2:
        return [f"  {left}", *(" " * (width + 2) + line for line in lines)]
    return [f"  {left:<{width}}{lines[0]}", *(" " * (width + 2) + line for line in lines[1:])]


def _examples(command: Any, most: int) -> list[str]:
    found = [line for line in (command.epilog or "").splitlines() if line.startswith("ndtree")]
    return ["examples:", *(f"  {line}" for line in found[:most])]


def _plain(text: str | None) -> str:
    """Help without line breaks and the marks of what prints it."""
    return " ".join((text or "").replace("\\[", "[").split())


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
