# SPDX-License-Identifier: BSD-3-Clause
"""Values of a TOML file, each taken once and checked; errors name file, key, value and what was expected."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ndtree._lazy import install_of


@dataclass(frozen=True)
class Check:
    """What a value must be: a function that returns it, or raises ValueError, and the same in words."""

    take: Callable[[Any], Any]
    expected: str

    def __call__(self, value: Any) -> Any:
        return self.take(value)


def _checked(
    is_right: Callable[[Any], bool], expected: str, made: Callable[[Any], Any] = lambda v: v
) -> Check:
    def take(value: Any) -> Any:
        if not is_right(value):
            raise ValueError
        return made(value)

    return Check(take, expected)


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def _within(least: float, most: float, above: bool = False) -> str:
    """What stands behind "a number"."""
    low, high = (f"{one:,.0f}" if one == round(one, 0) else f"{one:g}" for one in (least, most))
    if math.isfinite(least) and math.isfinite(most):
        return f" from {low} to {high}"
    return f" {'>' if above else '>='} {low}" if math.isfinite(least) else ""


def integer(least: float, most: float = math.inf) -> Check:
    """A whole number from the least to the most."""
    words = f"a whole number{_within(least, most)}"
    return _checked(lambda v: isinstance(v, int) and not isinstance(v, bool) and least <= v <= most, words)


def number(least: float, most: float = math.inf, *, above: bool = False) -> Check:
    """A finite number from the least, or from above it, to the most."""
    words = f"a number{_within(least, most, above)}"
    return _checked(
        lambda v: _is_number(v) and (v > least if above else v >= least) and v <= most, words, float
    )


def one_of(*known: Any) -> Check:
    """One of some values."""
    words = f"one of {', '.join(map(str, known))}"
    return _checked(lambda v: not isinstance(v, bool) and v in known, words)


text = _checked(lambda v: isinstance(v, str) and bool(v), "a text")
true_or_false = _checked(lambda v: isinstance(v, bool), "true or false")
numbers = _checked(
    lambda v: isinstance(v, list) and bool(v) and all(map(_is_number, v)),
    "a list of numbers",
    lambda v: [float(one) for one in v],
)


def list_of(check: Check) -> Check:
    """A list of values."""

    def checked(value: Any) -> list[Any]:
        if not isinstance(value, list):
            raise ValueError(f"a list, each {check.expected}")
        return [check(one) for one in value]

    return Check(checked, f"a list, each {check.expected}")


def one_or_more(check: Check) -> Check:
    """A value, or several different ones in a list."""

    def checked(value: Any) -> Any:
        if not isinstance(value, list):
            return check(value)
        found = [check(one) for one in value]
        if not found or len(set(found)) != len(found):
            raise ValueError
        return found

    return Check(checked, f"{check.expected}, or a list of different ones")


def parsed(file: Path) -> dict[str, Any]:
    """What a TOML file says.

    Raises OSError if it cannot be read; ValueError if it is no TOML; ImportError if Python is older than 3.11
    and has no tomli.
    """
    try:
        import tomllib
    except ModuleNotFoundError:
        try:
            import tomli as tomllib  # type: ignore[no-redef]
        except ImportError:
            raise ImportError(
                f"before Python 3.11 files of TOML need tomli; install it with:\n  {install_of('cli')}"
            ) from None
    try:
        with open(file, "rb") as opened:
            return tomllib.load(opened)
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        said = "is no text" if isinstance(error, UnicodeDecodeError) else error
        raise ValueError(f"{file}: {said}, expected TOML") from None


pair_or_none = _checked(
    lambda v: isinstance(v, list) and len(v) in (0, 2) and all(map(_is_number, v)),
    "a list of two numbers, or []",
)


class Table:
    """A table of the file; keys that are never read are refused in the end."""

    def __init__(self, file: Path, name: str, values: dict[str, Any]) -> None:
        self._file, self._name = file, name
        self._left = dict(values)

    def take(self, key: str, check: Check, default: Any) -> Any:
        """A value; the default where there is none."""
        if key not in self._left:
            return default
        value = self._left.pop(key)
        try:
            return check(value)
        except ValueError:
            raise self.wrong(key, value, check.expected) from None

    def take_all(self, checks: Mapping[str, Check]) -> dict[str, Any]:
        """Those of some values that are there."""
        return {key: self.take(key, check, None) for key, check in checks.items() if key in self._left}

    def tables(self, key: str) -> Iterator[tuple[str, Table]]:
        """The tables in a table, of which there must be one."""
        found = self._left.pop(key, None)
        if not isinstance(found, dict) or not found:
            raise ValueError(f"{self._file}: {key}: expected at least one table [{key}.NAME]")
        for name, values in found.items():
            if not isinstance(values, dict):
                raise self.wrong(f"{key}.{name}", values, f"a table [{key}.{name}]")
            yield name, Table(self._file, f"{key}.{name}", values)

    def finish(self, *known: str) -> None:
        """Refuse what was not taken."""
        for key, value in self._left.items():
            raise self.wrong(key, value, f"no such key{', but ' + ', '.join(known) if known else ''}")

    def wrong(self, key: str, value: Any, expected: str) -> ValueError:
        where = f"{self._name}.{key}" if self._name else key
        said = repr(value)
        said = said if len(said) <= 80 else said[:77] + "..."
        return ValueError(f"{self._file}: {where} = {said}: expected {expected}")
