# SPDX-License-Identifier: BSD-3-Clause
"""Calls that cannot be read: which word is wrong, what was expected, and what to type to see more."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from enum import Enum
from typing import Any

from ndtree._native._calls import ELSEWHERE
from ndtree.base.options import OPTIONS, option

#: What others call an option, by a part of the flag.
_ELSEWHERE = (
    *((part.replace("_", "-"), f"--{name.replace('_', '-')}") for part, name in ELSEWHERE),
    ("range", "--max-range"),
    ("out", "--output"),
    ("image", "--picture"),
    ("png", "--picture"),
    ("picture", "--png"),
    ("image", "--png"),
    ("output", "--png"),
    ("pose", "--poses"),
    ("frame", "--fixed-frame"),
    ("resolution", "--cell-size"),
    ("start", "--from"),
    ("goal", "--to"),
    ("radius", "--body"),
    ("verbose", "--json"),
)


#: How alike two words must be for a suggestion (--body and --world: 0.6), and how alike for it to come before
#: the names that other programs use.
_ALIKE, _NEARLY = 0.67, 0.8


def usage_error(error: Any, words: Sequence[str], commands: Mapping[str, Any]) -> str:
    """The error of a call that could not be read, of its words behind ``ndtree``; `commands` were loaded."""
    context: Any = getattr(error, "ctx", None)
    command = getattr(context, "command", None)
    # Of the command that was called; none for ``ndtree`` itself.
    name = str(context.info_name) if getattr(context, "parent", None) is not None else ""
    if command is None and words and words[0] in commands:
        command, name = commands[words[0]], words[0]
    said = re.sub(r"(?<!\.)\.$", "", _said(error, command, words))
    return f"{said}\n  ndtree {name + ' ' if name else ''}--help"


def _said(error: Any, command: Any, words: Sequence[str]) -> str:
    kind = type(error).__name__
    parameter = getattr(error, "param", None)
    if kind == "NoSuchOption":
        return f"{error.option_name}: no such option{_meant(error.option_name, command)}"
    if kind == "MissingParameter" and parameter is not None:
        if parameter.param_type_name == "argument":
            whole = f"ndtree {error.ctx.info_name} {_arguments(command)}"
            return f"{_called(parameter)} is missing, expected {whole}"
        return f"{_called(parameter)} is missing, expected {_expected(command, parameter)}"
    if kind == "BadOptionUsage":
        known = command.params if command is not None else []
        found = next((one for one in known if error.option_name in one.opts), None)
        expected = f", expected {_expected(command, found)}" if found is not None else ""
        return f"{error.option_name}: a value is missing{expected}"
    if kind == "BadParameter" and parameter is not None:
        value = _value_of(parameter, words)
        return f"{_called(parameter)}{value}: must be {_expected(command, parameter)}"
    known = getattr(command, "commands", None)
    if known is not None and words and words[0] not in known:
        near = get_close_matches(words[0], known, 1)
        hint = f": did you mean {near[0]}?" if near else f", expected one of {', '.join(known)}"
        return f"{words[0]}: no such command{hint}"
    text = " ".join(error.format_message().split())
    found = re.search(r"unexpected extra arguments? ?\((.*)\)", text.replace("argument(s)", "arguments"))
    if found and command is not None:
        return f"{found[1]}: more than the command takes, expected {_arguments(command)}"
    return text


def _arguments(command: Any) -> str:
    return " ".join(_called(one) for one in command.params if one.param_type_name == "argument")


def _called(parameter: Any) -> str:
    if parameter.param_type_name == "argument":
        return str(parameter.metavar or parameter.name.upper())
    return str(max(parameter.opts, key=len))


def _expected(command: Any, parameter: Any) -> str:
    """What a parameter takes, in words."""
    if parameter.param_type_name == "option":
        return option(parameter.name, command.name).expected
    kind = getattr(getattr(parameter, "type_descriptor", None), "annotation", None)
    choices = getattr(getattr(parameter, "type", None), "choices", None)
    choices = [one.value for one in kind] if isinstance(kind, type(Enum)) else choices
    if choices:
        return f"one of {', '.join(map(str, choices))}"
    return " ".join(str(parameter.help or "a file").replace("\\[", "[").rstrip(".").split())


def _value_of(parameter: Any, words: Sequence[str]) -> str:
    """The value that was given, as it was typed behind a blank; nothing where it is not found."""
    if parameter.param_type_name == "argument":
        given = [word for word in words[1:] if not word.startswith("-")]
        return f" {given[0]}" if given else ""
    for i, word in enumerate(words):
        flag, equals, value = word.partition("=")
        if flag in parameter.opts:
            return f" {value}" if equals else f" {words[i + 1]}" if i + 1 < len(words) else ""
    return ""


def _meant(flag: str, command: Any) -> str:
    known = [one for parameter in command.params for one in parameter.opts if one.startswith("--")]
    begun = [one for one in known if len(flag) > 4 and one.startswith(flag)]
    near = begun if len(begun) == 1 else get_close_matches(flag, known, 1, _NEARLY)
    near = near or [meant for part, meant in _ELSEWHERE if part in flag and meant in known]
    near = near or [one for one in ("--output", "--png") if flag == "-o" and one in known]
    commands = (name for one in OPTIONS if one.flag == flag for name in one.of.split())
    takers = [f"ndtree {name}" for name in commands if name != "node"]
    if takers and not near:
        return f" here: it is one of {' and '.join(takers[:2])}"
    near = near or get_close_matches(flag, known, 1, _ALIKE)
    return f": did you mean {near[0]}?" if near else ""
