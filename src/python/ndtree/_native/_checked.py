# SPDX-License-Identifier: BSD-3-Clause
"""Wrong values in calls of public functions of Python, said in one line as those of compiled ones are.

Nothing is looked at before a call fails: then the first argument that is of no kind its annotation names is
the reason, and not whatever the code ran into that met it.
"""

from __future__ import annotations

import functools
import inspect
import re
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

from ndtree._native._calls import is_integer, is_number, is_path, shown

_Any = TypeVar("_Any", bound=Callable[..., Any])

#: By the beginning of an annotation: what suits it, and what that is called.
_KINDS: tuple[tuple[str, Callable[[Any], bool], str], ...] = (
    ("None", lambda value: value is None, "None"),
    ("float", is_number, "a number"),
    ("int", is_integer, "an integer"),
    ("bool", lambda value: isinstance(value, (bool, np.bool_)) or is_integer(value), "True or False"),
    ("str | os.PathLike", is_path, "a path"),
    ("str", lambda value: isinstance(value, str), "a text"),
    ("os.PathLike", is_path, "a path"),
    ("Literal", lambda value: isinstance(value, str), "a text"),
    ("Mapping", lambda value: hasattr(value, "items"), "a dict"),
    ("dict", lambda value: hasattr(value, "items"), "a dict"),
    ("Callable", callable, "a function"),
    *(
        (f"{kind}[{name}]", lambda value, name=name: _are_all(value, name), f"several, each an ndtree.{name}")
        for kind in ("Iterable", "Sequence", "list")
        for name in ("Scan", "Frontier", "Log")
    ),
    *(
        (name, lambda value, name=name: _is_a(value, name), f"an ndtree.{name}")
        for name in ("Scan", "Log", "OccupancyMap", "Config", "Shape")
    ),
    ("Storage", lambda value: hasattr(value, "place"), "a Storage"),
    ("Manifest", lambda value: hasattr(value, "tiles"), "that of a map, as of ndtree.open_tiles()"),
    ("AnyMap", lambda value: is_path(value) or hasattr(value, "state"), "a map or a path"),
    (
        "Iterable[Any]",
        lambda value: not isinstance(value, (str, bytes)) and hasattr(value, "__iter__"),
        "several",
    ),
    ("CutOff", lambda value: _is_a(value, "CutOff"), "a CutOff"),
    ("slice", lambda value: isinstance(value, slice), "a slice"),
    ("tuple[ArrayLike", lambda value: _are_numbers(value), "an array of numbers"),
    ("World", lambda value: isinstance(value, str), "a text"),
    ("ArrayLike", lambda value: _are_numbers(value), "an array of numbers"),
    ("Floats", lambda value: _are_numbers(value), "an array of numbers"),
    ("NDArray", lambda value: _are_numbers(value), "an array of numbers"),
)


def checked(made: _Any) -> _Any:
    """A function, or a class with its public methods, whose wrong arguments are named."""
    if isinstance(made, type):
        for name, held in list(vars(made).items()):
            if isinstance(held, (staticmethod, classmethod)):
                setattr(made, name, type(held)(_checked(held.__func__)))
            elif inspect.isfunction(held) and (name == "__init__" or not name.startswith("_")):
                setattr(made, name, _checked(held, made.__name__ if name == "__init__" else ""))
        return made
    return _checked(made)  # type: ignore[return-value]


def _checked(function: Callable[..., Any], name: str = "") -> Callable[..., Any]:
    """`name`: What is called; left out, the function's own."""
    name = name or function.__qualname__.rpartition(".")[2]

    @functools.wraps(function)
    def call(*arguments: Any, **keywords: Any) -> Any:
        try:
            return function(*arguments, **keywords)
        except (TypeError, ValueError, AttributeError, ArithmeticError, LookupError) as error:
            refused = _refused(function, arguments, keywords)
            if refused is None or re.match(rf"(\w+\(\): )?{refused[0]}\b", str(error)):
                raise
            raise TypeError(f"{name}(): {refused[0]} = {refused[1]}") from error

    return call


def _refused(
    function: Callable[..., Any], arguments: tuple[Any, ...], keywords: dict[str, Any]
) -> tuple[str, str] | None:
    """The first argument that suits no kind of its annotation, its value and what it must be."""
    signature = inspect.signature(function)
    try:
        given = signature.bind(*arguments, **keywords).arguments
    except TypeError:
        return None  # Python says it.
    for name, value in given.items():
        several = value.items() if signature.parameters[name].kind is inspect.Parameter.VAR_KEYWORD else ()
        for one, of_one in several or [(name, value)]:
            words = _words_for(of_one, str(function.__annotations__.get(name, "")))
            if words:
                return one, f"{shown(of_one)}: must be {words}"
    return None


def _words_for(value: Any, wanted: str) -> str:
    """What a value must be; empty if it suits, or the annotation names kinds that nothing is said of."""
    words: list[str] = []
    rest = wanted.strip("'\"")
    while rest:
        found = next((kind for kind in _KINDS if re.match(rf"{re.escape(kind[0])}(?!\w)", rest)), None)
        if found is None or found[1](value):
            return ""
        words.append(found[2])
        rest = _after(rest, len(found[0]))
    return " or ".join(dict.fromkeys(words))


def _after(annotation: str, begin: int) -> str:
    """What follows the next "|" that is in no brackets."""
    depth = 0
    for i, character in enumerate(annotation[begin:], begin):
        depth += (character in "[(") - (character in "])")
        if character == "|" and depth == 0:
            return annotation[i + 1 :].strip()
    return ""


def _are_numbers(value: Any) -> bool:
    try:
        return np.asarray(value).dtype.kind in "biuf"
    except ValueError:  # Rows of several lengths.
        return False


def _is_a(value: Any, name: str) -> bool:
    return any(kind.__name__ == name for kind in type(value).__mro__)


def _are_all(value: Any, name: str) -> bool:
    """Whether it may be an iterable of these: of what can be looked at only once, nothing is known."""
    if isinstance(value, (str, bytes)) or not hasattr(value, "__iter__"):
        return False
    is_log = name == "Scan" and _is_a(value, "Log")
    return is_log or not hasattr(value, "__len__") or all(_is_a(one, name) for one in value)
