# SPDX-License-Identifier: BSD-3-Clause
"""Signatures of compiled functions, from the line that pybind11 writes above their docstrings."""

from __future__ import annotations

import ast
import inspect
import math
import re
from collections.abc import Mapping
from typing import Any

_LINE = re.compile(r"\w*\((?P<inside>.*)\)(?: -> (?P<result>.*))?$")
_NAMED_LINE = re.compile(rf"(?=\w){_LINE.pattern}")
_PARAMETER = re.compile(r"(\*{0,2}\w+|[*/])(?:: (.*?))?(?: = (.*))?")
#: What pybind11 says that it takes, and what a reader wants to know.
_PLAIN = (
    ("typing.SupportsFloat | typing.SupportsIndex", "float"),
    ("typing.SupportsInt | typing.SupportsIndex", "int"),
    ("os.PathLike | str | bytes", "str | os.PathLike[str]"),
    ("typing.Annotated[numpy.typing.ArrayLike, numpy.float64]", "ArrayLike"),
    ("typing.Annotated[numpy.typing.ArrayLike, numpy.uint32]", "ArrayLike"),
    ("collections.abc.", ""),
    ("numpy.typing.", ""),
    ("numpy.", "np."),
    ("ndtree._native._core.", ""),
)


def parameters_of(line: str) -> list[tuple[str, str, str | None]]:
    """Name, annotation and default of each parameter, as they are written; bare ``*`` and ``/`` too."""
    found = _LINE.search(line)
    parts = [_PARAMETER.fullmatch(part) for part in _split(found["inside"])] if found else []
    return [(part[1], part[2] or "", part[3]) for part in parts if part]


def signature_of(doc: str, options: Mapping[str, object] | None = None) -> inspect.Signature | None:
    """What `inspect` shows of a function; None if its docstring does not begin with pybind11's line.

    `doc`: With pybind11's line.
    `options`: Keywords and their defaults that stand for ``**kwargs``.
    """
    line = doc.partition("\n")[0]
    found = _NAMED_LINE.fullmatch(line)
    if found is None:
        return None
    kind: Any = inspect.Parameter.POSITIONAL_OR_KEYWORD
    result = []
    for name, annotation, default in parameters_of(line):
        if name == "*":
            kind = inspect.Parameter.KEYWORD_ONLY
        elif name == "/":
            result = [one.replace(kind=inspect.Parameter.POSITIONAL_ONLY) for one in result]
        elif name == "**kwargs" and options is not None:
            result += [
                inspect.Parameter(key, inspect.Parameter.KEYWORD_ONLY, default=value, annotation="float")
                for key, value in options.items()
            ]
        elif name.startswith("**"):
            result.append(inspect.Parameter(name[2:], inspect.Parameter.VAR_KEYWORD))
        else:
            result.append(
                inspect.Parameter(name, kind, default=_value(default), annotation=_annotation(annotation))
            )
    return inspect.Signature(result, return_annotation=_annotation(found["result"] or ""))


def text_of(doc: str) -> str | None:
    """A docstring without pybind11's line; None if there is no more."""
    line, _, rest = doc.partition("\n")
    return (rest.strip("\n") or None) if _NAMED_LINE.fullmatch(line) else doc


def _annotation(written: str) -> Any:
    """As text; none where all that is said is that it is an object, or is that of ``self``."""
    for long, short in _PLAIN:
        written = written.replace(long, short)
    return inspect.Parameter.empty if written in ("", "object") else written


def _value(written: str | None) -> Any:
    if written is None:
        return inspect.Parameter.empty
    return math.inf if written == "inf" else ast.literal_eval(written)


def _split(inside: str) -> list[str]:
    """Parameters, at the commas that are in no brackets."""
    parts, depth, start = [], 0, 0
    for i, character in enumerate(inside):
        depth += (character in "[(") - (character in "])")
        if character == "," and depth == 0:
            parts.append(inside[start:i].strip())
            start = i + 1
    return [part for part in [*parts, inside[start:].strip()] if part]
