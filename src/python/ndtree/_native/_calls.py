# SPDX-License-Identifier: BSD-3-Clause
"""Calls of compiled functions: their signatures, and wrong ones said in one line."""

from __future__ import annotations

import ast
import functools
import inspect
import math
import operator
import os
import re
import warnings
from collections.abc import Collection, Mapping, Sequence
from difflib import get_close_matches
from typing import Any

from ndtree._errors import Text, WrongOption, key
from ndtree._native import _core
from ndtree._native._kinds import shown, words_for

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


#: What other libraries call an option, by a part of the name.
ELSEWHERE = (
    ("max_cell", "max_cell_size"),
    ("max_size", "max_cell_size"),
    ("resolution", "min_cell_size"),
    ("voxel", "min_cell_size"),
    ("leaf", "min_cell_size"),
    ("cell", "min_cell_size"),
    ("size", "min_cell_size"),
    ("sigma", "range_sigma"),
    ("noise", "range_sigma"),
    ("clamp_min", "log_odds_min"),
    ("clamp_max", "log_odds_max"),
    ("dimension", "dim"),
)
#: Of arguments whose type the compiled functions leave open.
_OF_OBJECTS = {"max_seconds": "float | None", "scans": "Iterable[Scan]"}
#: Of integers: what the compiled functions' types hold.
_OF_INT = (-(2**31), 2**31 - 1)
_BOUNDS = {
    "dim": (2, 4),
    "branching": (2, 4),
    "threads": (0, 2**31 - 1),
    "number": (0, 2**63 - 1),
    **dict.fromkeys(("max_leaves", "max_bytes", "samples", "seed", "scans", "i"), (0, 2**64 - 1)),
}


#: Arguments that go by name, of which at most this many are listed.
_MOST_NAMED = 4
#: What the one argument of OctoMap's constructor is called here.
_FIRST = {"AdaptiveMap": "min_cell_size", "FixedMap": "min_cell_size", "OctoMap": "min_cell_size"}


def require_options(name: str, keywords: Mapping[str, Any], known: Collection[str]) -> None:
    """Refuse an option that a map does not take, and name the one that is probably meant.

    Raises WrongOption for the first keyword that is not `known`, or that maps of the refinement do not read.
    """
    refinement = keywords.get("refinement", "fixed" if name == "FixedMap" else "evidence")
    if not isinstance(refinement, str):
        return  # Said by the call itself.
    if {"cell_size", "min_cell_size"} <= keywords.keys() and "cell_size" in INTERNAL_KEYWORDS.get(name, ()):
        raise WrongOption(f"{name}(): cell_size and {key('min_cell_size')}: expected one of them")
    for option in keywords:
        if option in INTERNAL_KEYWORDS.get(name, ()):
            continue
        if option not in known:
            meant = [one for part, one in ELSEWHERE if part in option]
            near = [one for one in meant if one in known] or get_close_matches(option, known, 1)
            hint = f"did you mean {key(near[0])}? " if near else ""
            said = f"{name}(): no option {key(option)}: {hint}help(ndtree.{name}) lists all"
            if option in _readers():
                raise WrongOption.unread(said, option, "octomap" if name == "OctoMap" else refinement)
            raise WrongOption(said)
        readers = _readers().get(option, (refinement,))
        if name == "AdaptiveMap" and refinement in ("evidence", "paper") and refinement not in readers:
            said = f"{name}(): the refinement {refinement!r} does not read {key(option)}"
            raise WrongOption.unread(said, option, refinement)


def warn_of_noise(sigma: object, largest: object) -> None:
    """Warn of a noise that is given and larger than the largest cells: it was hardly meant in metres."""
    if isinstance(sigma, (int, float)) and isinstance(largest, (int, float)) and sigma > largest:
        said = f"{key('range_sigma')} = {sigma:g}: is more than the largest cells, {largest:g} m: "
        warnings.warn(Text(f"{said}expected metres"), stacklevel=3)


#: Words that constructors take and that are no options: another name, and constants of older files.
INTERNAL_KEYWORDS = {
    "AdaptiveMap": ("constants",),
    "FixedMap": ("cell_size", "constants"),
    "OctoMap": ("cell_size",),
    "ScanHistory": ("constants",),
}


@functools.lru_cache(maxsize=1)
def _readers() -> dict[str, list[str]]:
    return {name: readers for name, *_, readers, kind, _, _ in _core.option_table() if kind is not None}


def error_of(
    call: str, parameters: Sequence[inspect.Parameter], arguments: Sequence[Any], keywords: dict[str, Any]
) -> Exception:
    """What is wrong with a call of a compiled function, whose name is `call`.

    ValueError for an integer out of bounds, else TypeError.
    """
    positional = [one.name for one in parameters if one.kind not in (one.KEYWORD_ONLY, one.VAR_KEYWORD)]
    if len(arguments) > len(positional):
        return TypeError(f"{call}(): {_too_many(call, parameters, arguments, positional)}")
    given = {**dict(zip(positional, arguments)), **keywords}
    known = [one for one in parameters if one.kind is not one.VAR_KEYWORD]
    names = ", ".join(one.name for one in known)
    for name in positional[: len(arguments)]:
        if name in keywords:
            return TypeError(f"{call}(): {name} is given twice, by its place and by its name")
    for name in keywords:
        if len(known) == len(parameters) and name not in (one.name for one in known):
            return TypeError(f"{call}(): no argument {name}, expected {names or 'none'}")
    for one in known:
        if one.name not in given and one.default is one.empty:
            return TypeError(f"{call}(): {one.name} is missing, expected {names}")
    said = ", ".join(f"{name} = {shown(value)}" for name, value in given.items()) or "no arguments"
    return refused(call, known, given) or TypeError(
        f"{call}(): {said}: a value is out of bounds, or of another kind than expected"
    )


def refused(call: str, parameters: Sequence[inspect.Parameter], given: Mapping[str, Any]) -> Exception | None:
    """The error of the first argument that cannot be what its annotation says; None where all suit."""
    for one in parameters:
        if one.name not in given:
            continue
        value, wanted = given[one.name], str(one.annotation)
        if one.annotation is one.empty or wanted.endswith("Iterable"):
            wanted = _OF_OBJECTS.get(one.name, "")
        words = words_for(value, wanted)
        if wanted == "bool" and not isinstance(value, bool):  # An integer, which pybind11 takes for none.
            words = "True or False"
        if words:
            return TypeError(f"{call}(): {one.name} = {shown(value)}: must be {words}")
        low, high = _BOUNDS.get(one.name, _OF_INT)
        if value is not None and wanted.startswith("int") and not low <= operator.index(value) <= high:
            number = shown(operator.index(value))
            return ValueError(f"{call}(): {one.name} = {number}: must be from {low} to {high}")
    return None


def _too_many(
    call: str, parameters: Sequence[inspect.Parameter], arguments: Sequence[Any], positional: list[str]
) -> str:
    most = f"at most {len(positional)} ({', '.join(positional)})" if positional else "none"
    own = [_FIRST[call]] if call in _FIRST else []
    named = dict.fromkeys([*own, *(one.name for one in parameters if one.kind is one.KEYWORD_ONLY)])
    one = len(arguments) == 1
    meant = f"; the others by name: {', '.join([*named][:_MOST_NAMED])}" if named else ""
    if own and one:
        given = shown(arguments[0])
        is_file = isinstance(arguments[0], (str, os.PathLike))
        meant = f": did you mean {f'ndtree.load({given})' if is_file else f'{own[0]} = {given}'}?"
    said = "1 argument without a name" if one else f"{len(arguments)} arguments without names"
    return f"{said}, expected {most}{meant}"
