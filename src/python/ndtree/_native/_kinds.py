# SPDX-License-Identifier: BSD-3-Clause
"""Kinds of arguments: what suits an annotation, and what that is called."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np

_MOST_SHOWN = 60
_CLASSES = (
    *("Scan", "Log", "Config", "ScanHistory", "HeldOutTruth", "Reliability", "SeenSpace"),
    *("OccupancyMap", "AdaptiveMap", "FixedMap", "OctoMap"),
)
_OF_SHAPES = "an ndtree.Sphere, Capsule or Box, or several joined by |"


def _are_texts(value: Any) -> bool:
    return isinstance(value, (list, tuple)) and all(isinstance(one, str) for one in value)


def _are_makers(value: Any) -> bool:
    return hasattr(value, "items") and all(callable(one) for one in value.values())


def is_number(value: Any) -> bool:
    """Whether it is one, of Python or NumPy; arrays of one value are none, nor are times."""
    if isinstance(value, (np.datetime64, np.timedelta64)):
        return False
    return not getattr(value, "ndim", 0) and (hasattr(value, "__float__") or hasattr(value, "__index__"))


def is_integer(value: Any) -> bool:
    return not getattr(value, "ndim", 0) and hasattr(value, "__index__")


def is_path(value: Any) -> bool:
    return isinstance(value, (str, bytes)) or hasattr(value, "__fspath__")


def shown(value: Any) -> str:
    """What a value is, in few words: that of an array would take many."""
    if hasattr(value, "shape") and hasattr(value, "dtype") and value.shape:
        return f"array of shape {tuple(value.shape)} and dtype {value.dtype}"
    if isinstance(value, int) and value.bit_length() > 200:
        return f"an integer of {value.bit_length()} bits"
    text = repr(value.item() if hasattr(value, "dtype") else value)
    return text if len(text) <= _MOST_SHOWN else text[: _MOST_SHOWN - 3] + "..."


def _are_numbers(value: Any) -> bool:
    try:
        return np.asarray(value).dtype.kind in "biuf"
    except ValueError:  # Rows of several lengths.
        return False


def _are(value: Any, is_one: Callable[[Any], bool], count: int | None = None) -> bool:
    """Whether it is a sequence, or an array, of these, of as many if that is said."""
    if isinstance(value, (str, bytes)) or not hasattr(value, "__len__") or not hasattr(value, "__iter__"):
        return False
    return count in (None, len(value)) and all(map(is_one, value))


def _is_a(value: Any, name: str) -> bool:
    return any(kind.__name__ == name for kind in type(value).__mro__)


def _are_all(value: Any, name: str) -> bool:
    """Whether it may be an iterable of these: of what can be looked at only once, nothing is known."""
    if isinstance(value, (str, bytes)) or not hasattr(value, "__iter__"):
        return False
    is_log = name == "Scan" and _is_a(value, "Log")
    return is_log or not hasattr(value, "__len__") or all(_is_a(one, name) for one in value)


#: By the beginning of an annotation: what suits it, and what that is called.
KINDS: tuple[tuple[str, Callable[[Any], bool], str], ...] = (
    ("None", lambda value: value is None, "None"),
    ("float", is_number, "a number"),
    ("int", is_integer, "an integer"),
    ("bool", lambda value: isinstance(value, (bool, np.bool_)) or is_integer(value), "True or False"),
    *((kind, is_path, "a path") for kind in ("str | os.PathLike", "os.PathLike")),
    *((kind, lambda value: isinstance(value, str), "a text") for kind in ("str", "Literal", "World")),
    ("Maps", lambda value: _are_texts(value) or _are_makers(value), "different names of maps"),
    ("Sequence[str]", _are_texts, "several texts, as ['...', '...']"),
    ("Sequence[int]", lambda value: _are(value, is_integer), "several integers, as [0, 1]"),
    ("bytes", lambda value: isinstance(value, bytes), "bytes"),
    *((kind, lambda value: hasattr(value, "items"), "a dict") for kind in ("Mapping", "dict")),
    ("Callable", callable, "a function"),
    *(
        (f"{kind}[{name}]", lambda value, name=name: _are_all(value, name), f"several, each an ndtree.{name}")
        for kind in ("Iterable", "Sequence", "list")
        for name in ("Scan", "Frontier", "Log")
    ),
    ("OccupancyMap | PlacedMap", lambda value: hasattr(value, "state"), "a map"),
    *((name, lambda value, name=name: _is_a(value, name), f"an ndtree.{name}") for name in _CLASSES),
    ("Shape", lambda value: _is_a(value, "Shape"), _OF_SHAPES),
    ("Storage", lambda value: hasattr(value, "place"), "a Storage"),
    ("Manifest", lambda value: hasattr(value, "tiles"), "that of a map, as of ndtree.open_tiles()"),
    ("AnyMap", lambda value: is_path(value) or hasattr(value, "state"), "a map or a path"),
    ("Iterable[Any]", lambda value: not is_path(value) and hasattr(value, "__iter__"), "several"),
    ("CutOff", lambda value: _is_a(value, "CutOff"), "a CutOff"),
    ("slice", lambda value: isinstance(value, slice), "a slice"),
    *(
        (kind, _are_numbers, "an array of numbers")
        for kind in ("tuple[ArrayLike", "ArrayLike", "Floats", "NDArray")
    ),
    ("tuple[float, float]", lambda value: _are(value, is_number, 2), "a pair of numbers"),
    ("tuple", lambda value: isinstance(value, (tuple, list)), "a pair of numbers"),
)


def words_for(value: Any, wanted: str) -> str:
    """What a value must be; empty if it suits, or the annotation names kinds that nothing is said of."""
    words: list[str] = []
    rest = wanted.strip("'\"")
    while rest:
        found = next((kind for kind in KINDS if re.match(rf"{re.escape(kind[0])}(?!\w)", rest)), None)
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
