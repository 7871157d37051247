# SPDX-License-Identifier: BSD-3-Clause
"""Wrong calls of compiled functions, said in one line: which argument, what it is, and what is expected."""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Collection
from difflib import get_close_matches
from typing import Any

from ndtree._native._signatures import parameters_of

UNEXPECTED = re.compile(r"got an unexpected keyword argument '(\w+)'")
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
MISMATCH = re.compile(r"incompatible (?:function|constructor) arguments")
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
#: Of integers: what the compiled functions' types hold.
_OF_INT = (-(2**31), 2**31 - 1)
_BOUNDS = {
    "dim": (2, 4),
    "branching": (2, 4),
    "threads": (0, 2**31 - 1),
    "number": (0, 2**63 - 1),
    **dict.fromkeys(("max_leaves", "max_bytes", "samples", "seed", "scans", "i"), (0, 2**64 - 1)),
}


def error_of(text: str, arguments: tuple[Any, ...], keywords: dict[str, Any]) -> Exception:
    """What is wrong with the call that pybind11 describes in several lines.

    Returns
    -------
    Exception
        ValueError for an integer out of bounds, else TypeError.
    """
    try:
        return TypeError(_said(text, arguments, keywords))
    except ValueError as error:
        error.__context__ = None  # That of pybind11, in several lines.
        return error.with_traceback(None)


#: What the one argument of OctoMap's constructor is called here.
_FIRST = {"AdaptiveMap": "min_cell_size", "FixedMap": "cell_size", "OctoMap": "cell_size"}


def require_known(name: str, given: Collection[str], known: Collection[str]) -> None:
    """Refuse an option that a map does not take, and name the one that is probably meant.

    Raises
    ------
    TypeError
        For the first of `given` that is not `known`.
    """
    for option in given:
        if option in known:
            continue
        own = "cell_size" if "cell_size" in known else "min_cell_size"
        meant = [own if one == "min_cell_size" else one for part, one in ELSEWHERE if part in option]
        near = [one for one in meant if one in known] or get_close_matches(option, known, 1)
        hint = f"did you mean {near[0]}? " if near else ""
        raise TypeError(f"{name}(): no option {option}: {hint}help(ndtree.{name}) lists all")


def _said(text: str, arguments: tuple[Any, ...], keywords: dict[str, Any]) -> str:
    lines = text.splitlines()
    found = parameters_of(lines[1]) if len(lines) > 1 else []
    known = [(name, annotation, default is not None) for name, annotation, default in found if name != "/"]
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
        extra = arguments[len(positional)]
        own = _FIRST.get(name)
        meant = f": did you mean {own} = {_shown(extra)}?" if own and not positional else ""
        count = (
            "1 argument without a name"
            if len(arguments) == 1
            else f"{len(arguments)} arguments without names"
        )
        return f"{name}(): {count}, expected {most}{meant}"
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
                if word == "SupportsInt":
                    _check_bounds(f"{name}(): {one}", value, _BOUNDS.get(one, _OF_INT))
                break
    shown = ", ".join(f"{key} = {_shown(value)}" for key, value in given.items())
    return f"{name}(): {shown or 'no arguments'}: a value is out of bounds, or of another kind than expected"


def _check_bounds(what: str, value: Any, bounds: tuple[int, int]) -> None:
    number = operator.index(value)
    if not bounds[0] <= number <= bounds[1]:
        raise ValueError(f"{what} = {_shown(number)}: must be from {bounds[0]} to {bounds[1]}")


def _called(text: str) -> str:
    """Name of what was called; a class's for its constructor."""
    name = text.partition("(")[0].strip()
    if name == "__init__":
        made = re.search(r"\d+\. (?:[\w.]+\.)?(\w+)\(", text)
        return made[1] if made else name
    return name


def _shown(value: Any) -> str:
    """What a value is, in few words: that of an array would take many."""
    if hasattr(value, "shape") and hasattr(value, "dtype"):
        return f"array of shape {tuple(value.shape)} and dtype {value.dtype}"
    if isinstance(value, int) and value.bit_length() > 200:
        return f"an integer of {value.bit_length()} bits"
    text = repr(value)
    return text if len(text) <= _MOST_SHOWN else text[: _MOST_SHOWN - 3] + "..."
