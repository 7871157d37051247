# SPDX-License-Identifier: BSD-3-Clause
"""The page of ``--help-all``, made of a command and the table of options, and the lines of all pages."""

from __future__ import annotations

import textwrap
from typing import Any

from ndtree.base.option import MUST_BE_GIVEN, Option
from ndtree.base.options import QUESTIONS

#: Columns of a page, and of the names of options in it.
WIDTH, LEFT = 80, 24


def flags_of(option: Option) -> str:
    """An option's flags, the shortest first, with what is typed behind; also what turns a switch off."""
    on, _, off = (option.flags or option.flag).partition("/")
    flags = sorted(on.split(), key=len) + [off] * bool(off)
    return f"{', '.join(flags)} {option.placeholder}".strip()


def whole_page(name: str, command: Any) -> str:
    """A command's page with all of its options."""
    paragraphs = [plain(part) for part in (command.help or "").split("\n\n")[1:]]
    lines = head(name, command)
    for paragraph in paragraphs:
        lines += ["", *textwrap.wrap(paragraph, WIDTH)]
    lines += ["", *arguments(command)]
    for question, options in QUESTIONS.items():
        mine = [one for one in options if one.taken_by(name)]
        lines += ["", question] if mine else []
        for one in mine:
            lines += option(name, one)
    lines += ["", *examples(command, 99)]
    return "\n".join(lines) + "\n"


def _is_option(parameter: Any) -> bool:
    return parameter.param_type_name == "option" and parameter.name != "help"


def head(name: str, command: Any) -> list[str]:
    shown = [(one.metavar or one.name.upper(), one) for one in command.params if not _is_option(one)]
    words = [word if one.required else f"[{word}]" for word, one in shown]
    summary = plain((command.help or "").split("\n\n")[0])
    return [f"usage: ndtree {name} {' '.join(words)} [OPTIONS]", "", *textwrap.wrap(summary, WIDTH)]


def arguments(command: Any) -> list[str]:
    lines: list[str] = []
    for one in command.params:
        if not _is_option(one):
            lines += entry(one.metavar or one.name.upper(), plain(one.help))
    return lines


def option(command: str, option: Option) -> list[str]:
    shown = option.shown(command)
    said = shown if shown == MUST_BE_GIVEN else f"default: {shown}"
    return entry(flags_of(option), f"{option.help.rstrip('.')} ({said}).")


def entry(left: str, right: str, width: int = LEFT) -> list[str]:
    lines = textwrap.wrap(right, WIDTH - width - 2, break_on_hyphens=False) or [""]
    if len(left) > width - 2:
        return [f"  {left}", *(" " * (width + 2) + line for line in lines)]
    return [f"  {left:<{width}}{lines[0]}", *(" " * (width + 2) + line for line in lines[1:])]


def examples(command: Any, most: int) -> list[str]:
    found = [line for line in (command.epilog or "").splitlines() if line.startswith("ndtree")]
    return ["examples:", *(f"  {line}" for line in found[:most])]


def plain(text: str | None) -> str:
    """Help without line breaks and the marks of what prints it."""
    return " ".join((text or "").replace("\\[", "[").split())
