# SPDX-License-Identifier: BSD-3-Clause
"""Wrong values in calls of public functions of Python, said in one line as those of compiled ones are.

Nothing is looked at before a call fails: then the first argument that is of no kind its annotation names is
the reason, and not whatever the code ran into that met it.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
import re
from collections.abc import Callable
from typing import Any, TypeVar

from ndtree._native._kinds import shown, words_for

_Settings = TypeVar("_Settings", bound=Any)
_Any = TypeVar("_Any", bound=Callable[..., Any])


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
            words = words_for(of_one, str(function.__annotations__.get(name, "")))
            if words:
                return one, f"{shown(of_one)}: must be {words}"
    return None


def settings_of(usual: _Settings, call: str, given: dict[str, Any]) -> _Settings:
    """A frozen dataclass with the keywords that a call was given; what is wrong with them names the call."""
    known = [one.name for one in dataclasses.fields(usual)]
    for name in given:
        if name not in known:
            raise TypeError(f"{call}(): no argument {name}, expected {', '.join(known)}")
    try:
        return dataclasses.replace(usual, **given)
    except TypeError as error:
        raise TypeError(str(error).replace(f"{type(usual).__name__}()", f"{call}()", 1)) from error.__cause__
