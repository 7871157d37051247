# SPDX-License-Identifier: BSD-3-Clause
"""What the pages of ``--help`` and ``--help-all`` say, made of the commands and the table of options."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable
from typing import Any

from ndtree.cli.commands import COMMANDS, every
from ndtree.cli.commands.questions import DEFAULTS, QUESTIONS, TOUCHED, Row, row_of
from ndtree.cli.help import LEFT, WIDTH

#: Lines of a page of ``--help``.
MOST_LINES = 26
_EXAMPLES = 3


def pages() -> dict[tuple[str, bool], str]:
    """Every page, by command and whether it is the one of ``--help-all``; "ndtree" is that of them all."""
    found = {("ndtree", False): _first_page()}
    for name, command in every().items():
        found[name, False] = _short(name, command)
        found[name, True] = _whole(name, command)
    return found


def flags_of(parameter: Any) -> str:
    """A parameter's flags, the shortest first; of a switch that is on by default, also what turns it off."""
    off = parameter.secondary_opts if parameter.name in ("deskew", "loops", "free") else []
    return ", ".join([*sorted(parameter.opts, key=len), *off])


def default_of(command: str, row: Row) -> str:
    """What stands if an option is left out, with its unit."""
    return DEFAULTS.get((command, row.name), row.default)


def _first_page() -> str:
    lines = ["usage: ndtree COMMAND [ARGUMENTS] [OPTIONS]", ""]
    lines += ["Occupancy maps whose cells adapt to what is measured.", ""]
    for name, (_, summary) in COMMANDS.items():
        lines += _entry(name, re.split(r"[:.](?: |$)", summary)[0] + ".", 12)
    lines += ["", "Each with --help, --quiet, and most with --json."]
    lines += _entry("--version", "Print the version.", 22)
    lines += _entry("--install-completion", "The Tab key completes commands and flags.", 22)
    lines += ["", "first steps: ndtree demo; ndtree map LOG; ndtree info FILE"]
    lines += ["exit status: 0 done, 1 the input is bad, 2 the call is wrong, 130 after Ctrl-C"]
    return "\n".join(lines) + "\n"


def _short(name: str, command: Any) -> str:
    by_name = {parameter.name: parameter for parameter in command.params}
    lines = [*_head(name, command), "", *_arguments(command)]
    if "output" in by_name:
        lines += _option(name, by_name["output"])
    lines.append("")
    for one in TOUCHED.get(name, ()):
        lines += _option(name, by_name[one])
    lines += ["", *_examples(command, _EXAMPLES), f"more: ndtree {name} --help-all"]
    return "\n".join(lines) + "\n"


def _whole(name: str, command: Any) -> str:
    by_name = {parameter.name: parameter for parameter in command.params}
    paragraphs = [_plain(part) for part in (command.help or "").split("\n\n")[1:]]
    lines = _head(name, command)
    for paragraph in paragraphs:
        lines += ["", *textwrap.wrap(paragraph, WIDTH)]
    lines += ["", *_arguments(command)]
    listed: set[str] = set()
    for question, rows in QUESTIONS.items():
        mine = [row for row in rows if row.name in by_name and _is_option(by_name[row.name])]
        if mine:
            lines += ["", question]
        for row in mine:
            listed.add(row.name)
            lines += _option(name, by_name[row.name])
    others = [one for one in command.params if _is_option(one) and one.name not in listed]
    if others:
        lines += ["", "Others"]
        for one in others:
            lines += _option(name, one)
    lines += ["", *_examples(command, 99)]
    return "\n".join(lines) + "\n"


def _is_option(parameter: Any) -> bool:
    return parameter.param_type_name == "option" and parameter.name != "help"


def _head(name: str, command: Any) -> list[str]:
    words = [_shown_argument(one) for one in command.params if not _is_option(one)]
    summary = _plain((command.help or "").split("\n\n")[0])
    return [f"usage: ndtree {name} {' '.join(words)} [OPTIONS]", "", *textwrap.wrap(summary, WIDTH)]


def _shown_argument(parameter: Any) -> str:
    shown = parameter.metavar or parameter.name.upper()
    return shown if parameter.required else f"[{shown}]"


def _arguments(command: Any) -> list[str]:
    lines: list[str] = []
    for one in command.params:
        if not _is_option(one):
            lines += _entry(one.metavar or one.name.upper(), _plain(one.help))
    return lines


def _option(command: str, parameter: Any) -> list[str]:
    row = row_of(parameter.name)
    flags = flags_of(parameter)
    said = _plain(parameter.help)
    if row is None:
        return _entry(flags if parameter.is_flag else f"{flags} VALUE", said)
    # The default stands in its own words.
    said = re.sub(r"(; else [^.;]*(?:\.(?! |$)[^.;]*)*| \(default\)|; auto: see)(?=\.|;|$)", "", said)
    return _entry(
        f"{flags} {row.value}".strip(), f"{said.rstrip('.')} (default: {default_of(command, row)})."
    )


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
    commands = every()
    for question, rows in QUESTIONS.items():
        found = []
        for row in rows:
            takers = [
                name
                for name, command in commands.items()
                if any(_is_option(one) and one.name == row.name for one in command.params)
            ]
            parameter = next(
                one for one in commands[takers[0]].params if _is_option(one) and one.name == row.name
            )
            shown = f"{flags_of(parameter)} {row.value}".strip()
            found.append(
                (
                    shown,
                    default_of(takers[-1] if row.name == "output" else takers[0], row),
                    row.when,
                    ", ".join(takers),
                )
            )
        yield question, found
