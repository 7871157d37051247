# SPDX-License-Identifier: BSD-3-Clause
"""Wrong calls of compiled functions, said in one line: which argument, what it is, and what is expected."""

from __future__ import annotations

import functools
import re
import types
from collections.abc import Callable
from typing import Any

from ndtree import _core

_MISMATCH = re.compile(r"incompatible (?:function|constructor) arguments")
_SIGNATURE = re.compile(r"\((.*)\)(?: -> .*)?$")
_PARAMETER = re.compile(r"(\*{0,2}\w+|\*)(?:: (.*?))?(?: = (.*))?")
#: By what is in an annotation: a type that suits, and what it is called.
_WANTED: tuple[tuple[str, Callable[[Any], bool], str], ...] = (
    ("SupportsFloat", lambda value: hasattr(value, "__float__") or hasattr(value, "__index__"), "a number"),
    ("SupportsInt", lambda value: hasattr(value, "__index__"), "an integer"),
    ("PathLike", lambda value: isinstance(value, (str, bytes)) or hasattr(value, "__fspath__"), "a path"),
    ("tuple", lambda value: isinstance(value, (tuple, list)), "a pair of numbers"),
    ("bytes", lambda value: isinstance(value, bytes), "bytes"),
    ("str", lambda value: isinstance(value, str), "a text"),
    ("bool", lambda value: isinstance(value, bool), "True or False"),
)
_MOST_SHOWN = 60


def explained(module: types.ModuleType) -> None:
    """Have every function and method of a compiled module say so where a call does not fit."""
    for name, held in list(vars(module).items()):
        if isinstance(held, type):
            for member, method in list(vars(held).items()):
                is_own = member == "__init__" or not member.startswith("__")
                if is_own and _is_compiled(method):
                    setattr(held, member, _wrapped(method, f"{name}.{member}"))
        elif _is_compiled(held) and not name.startswith("__"):
            setattr(module, name, _wrapped(held, name))


def _is_compiled(held: Any) -> bool:
    return callable(held) and not isinstance(held, (type, types.FunctionType)) and bool(held.__doc__)


def _wrapped(function: Any, name: str) -> Callable[..., Any]:
    @functools.wraps(function)
    def call(*arguments: Any, **keywords: Any) -> Any:
        try:
            return function(*arguments, **keywords)
        except TypeError as error:
            text = str(error)
            if not _MISMATCH.search(text):
                raise
            said = _said(text, arguments, keywords)
        raise TypeError(said)

    call.__qualname__ = name  # pybind11's own is that of a class of its.
    return call


def _said(text: str, arguments: tuple[Any, ...], keywords: dict[str, Any]) -> str:
    """What is wrong with the call that pybind11 describes in several lines."""
    lines = text.splitlines()
    found = _SIGNATURE.search(lines[1]) if len(lines) > 1 else None
    parameters = [_PARAMETER.fullmatch(part) for part in _split(found[1])] if found else []
    known = [(part[1], part[2] or "", part[3] is not None) for part in parameters if part]
    is_method = bool(known) and known[0][0] == "self"
    if is_method or text.startswith("__init__"):
        arguments = arguments[1:]
    known = known[1:] if is_method else known
    name = _called(text)
    names = [one for one, _, _ in known if not one.startswith("*")]
    positional = [
        one for one, _, _ in known[: next((i for i, one in enumerate(known) if one[0] == "*"), None)]
    ]
    if len(arguments) > len(positional):
        most = f"at most {len(positional)} ({', '.join(positional)})" if positional else "none"
        return f"{name}(): {len(arguments)} arguments without names, expected {most}"
    given = {**dict(zip(positional, arguments)), **keywords}
    if not any(one.startswith("**") for one, _, _ in known):
        for key in keywords:
            if key not in names:
                return f"{name}(): no argument {key}, expected {', '.join(names) or 'none'}"
    for one, wanted, has_default in known:
        if one.startswith("*"):
            continue
        if one not in given:
            if not has_default:
                return f"{name}(): {one} is missing, expected {', '.join(names)}"
            continue
        value = given[one]
        if value is None and "None" in wanted:
            continue
        for word, suits, words in _WANTED:
            if word in wanted:
                if not suits(value):
                    return f"{name}(): {one} = {_shown(value)}: must be {words}"
                break
    shown = ", ".join(f"{key} = {_shown(value)}" for key, value in given.items())
    return f"{name}(): {shown or 'no arguments'}: a value is out of bounds, or of another kind than expected"


def _called(text: str) -> str:
    """Name of what was called; a class's for its constructor."""
    name = text.partition("(")[0].strip()
    if name == "__init__":
        made = re.search(r"\d+\. (?:[\w.]+\.)?(\w+)\(", text)
        return made[1] if made else name
    return name


def _split(signature: str) -> list[str]:
    """Parameters, at the commas that are in no brackets."""
    parts, depth, start = [], 0, 0
    for i, character in enumerate(signature):
        depth += (character in "[(") - (character in "])")
        if character == "," and depth == 0:
            parts.append(signature[start:i].strip())
            start = i + 1
    return [part for part in [*parts, signature[start:].strip()] if part]


def _shown(value: Any) -> str:
    """What a value is, in few words: that of an array would take many."""
    if hasattr(value, "shape") and hasattr(value, "dtype"):
        return f"array of shape {tuple(value.shape)} and dtype {value.dtype}"
    if isinstance(value, int) and value.bit_length() > 200:
        return f"an integer of {value.bit_length()} bits"
    text = repr(value)
    return text if len(text) <= _MOST_SHOWN else text[: _MOST_SHOWN - 3] + "..."


explained(_core)
