# SPDX-License-Identifier: BSD-3-Clause
"""Flags that several commands share, made from tables: options of the maps, and what of a log is read."""

from __future__ import annotations

import functools
import inspect
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Optional

import typer

from ndtree.base.exit_status import WrongCall
from ndtree.logs import (
    FORMATS,
    READER_OPTIONS,
    Log,
    NotALog,
    WrongOption,
    contents,
    read,
    require_options,
)
from ndtree.logs.core.selection import Selection
from ndtree.maps.kinds import MAP_OPTIONS

Command = Callable[..., None]

_OF_MAPS = "Options of the maps (default: their own)"
_OF_LOGS = "What is read of the log"
_OF_FORMATS = "Options of single formats"


def _flag(name: str, type: Any, help: str, panel: str, flag: str | None = None) -> inspect.Parameter:
    """A flag that is None where it was not given."""
    option = typer.Option(
        *([flag] if flag else []),
        help=help.replace("[", r"\["),
        show_default=False,
        rich_help_panel=panel,
    )
    return inspect.Parameter(
        name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=Annotated[Optional[type], option]
    )


def _adds_flags(
    argument: str, flags: Sequence[inspect.Parameter], gather: Callable[[dict[str, Any]], Any]
) -> Callable[[Command], Command]:
    """Gives a command flags; what `gather` makes of those that were given arrives in one argument."""

    def decorate(command: Command) -> Command:
        signature = inspect.signature(command)
        own = [p for p in signature.parameters.values() if p.name != argument]

        @functools.wraps(command)
        def with_flags(**arguments: Any) -> None:
            values = {flag.name: arguments.pop(flag.name) for flag in flags}
            gathered = gather({name: value for name, value in values.items() if value not in (None, [])})
            command(**arguments, **{argument: gathered})

        parameters = [p.replace(kind=inspect.Parameter.KEYWORD_ONLY) for p in own] + list(flags)
        with_flags.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
        with_flags.__annotations__ = {p.name: p.annotation for p in parameters}
        return with_flags

    return decorate


#: Gives a command a flag for each option of the maps; those given arrive in `options`.
map_options = _adds_flags(
    "options",
    [_flag(option.name, option.type, option.help, _OF_MAPS) for option in MAP_OPTIONS],
    lambda given: given,
)


_NAMES = "|".join([option.name for option in READER_OPTIONS] + ["format", "strict", "keep_going"])
#: How readers name their options in errors, for Python.
_NAMED = re.compile(
    rf"(?<![\w/.-])(?:(?P<set>{_NAMES}) ?= ?(?=\S)|(?:(?<=^)|(?<=: ))(?P<of>{_NAMES})(?=: )"
    rf"|(?P<as>{_NAMES})(?= as one of)|(?<=expected )(?P<dim>dim)=(?=\d)"
    rf"|(?:the )?option (?P<option>{_NAMES})\b)"
)
#: Several of them: those that exclude each other, and those that a format takes.
_LISTED = re.compile(rf"(?:{_NAMES})(?: and (?:{_NAMES}))+(?=: expected one of them)|(?<=it takes )[\w, ]+$")


def in_flags(text: str) -> str:
    """An error of a reader with its options named as flags."""
    text = _NAMED.sub(
        lambda found: flag_of(found[found.lastgroup or 0]) + " " * bool(found["set"] or found["dim"]), text
    )
    return _LISTED.sub(lambda found: re.sub(_NAMES, lambda one: flag_of(one[0]), found[0]), text)


def flag_of(name: str) -> str:
    """The flag of an option."""
    return f"--{name.replace('_', '-')}"


@dataclass(frozen=True)
class Reading:
    """What of a log is read, and how."""

    format: str | None = None
    keep_going: bool = False
    strict: bool = False
    selection: dict[str, Any] = field(default_factory=dict)
    options: dict[str, Any] = field(default_factory=dict)

    def contents(self, path: Path, *, whole: bool) -> dict[str, Any]:
        """What a file holds beside its scans."""
        self._check_format()
        return contents(path, format=self.format, whole=whole)

    @property
    def is_given(self) -> bool:
        """Whether something is said of how the log is read."""
        return bool(self.selection or self.options or self.keep_going or self.strict)

    def open(self, path: Path, dim: int | None, max_range: float | None = None) -> Log:
        """The log, or the part of it that was asked for; no beam is free beyond `max_range`."""
        self._check_format()
        try:
            log = read(
                path,
                format=self.format,
                dim=dim,
                keep_going=self.keep_going,
                strict=self.strict,
                **self.options,
            )
        except WrongOption as error:
            raise WrongCall(in_flags(str(error))) from None
        except NotALog:
            raise
        except ValueError as error:
            raise ValueError(in_flags(str(error))) from error
        log.no_return_range = max_range
        if not self.selection:
            return log
        try:
            return log.select(**self.parts(log.dim))
        except ValueError as error:
            raise WrongCall(str(error)) from None

    def parts(self, dim: int) -> dict[str, Any]:
        """What of a log of a dimension is selected, as for `Log.select`."""
        selection = dict(self.selection)
        for name, count in (("box", 2 * dim), ("origin", dim)):
            if name in selection:
                selection[name] = _numbers(name, selection[name], count)
        if "box" in selection:
            selection["box"] = (selection["box"][:dim], selection["box"][dim:])
        return selection

    def require_taken(self, path: Path) -> None:
        """Refuse options that the log's format does not take, and limits of its part that make no sense."""
        limits = {name: value for name, value in self.selection.items() if name not in ("box", "origin")}
        try:
            Selection(3, **limits)
        except ValueError as error:
            raise WrongCall(str(error)) from None
        try:
            require_options(path, self.options, format=self.format)
        except WrongOption as error:
            raise WrongCall(in_flags(str(error))) from None

    def with_default(self, name: str, value: Any) -> Reading:
        """These flags with an option of the format added, unless it was given."""
        return replace(self, options={name: value, **self.options})

    def require_none(self, instead_of: str) -> None:
        """Refuses flags that nothing would read."""
        given = [*self.selection, *self.options, *(["format"] if self.format else [])]
        given += [name for name in ("keep_going", "strict") if getattr(self, name)]
        if given:
            name = {"start": "from", "stop": "to"}.get(given[0], given[0])
            raise WrongCall(f"--{name.replace('_', '-')}: is for a LOG, not for {instead_of}")

    def _check_format(self) -> None:
        if self.format is not None and self.format not in FORMATS:
            raise WrongCall(f"--format {self.format}: must be one of {', '.join(FORMATS)}")


def _numbers(name: str, text: str, count: int) -> list[float]:
    try:
        numbers = [float(field) for field in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != count:
        raise WrongCall(f"--{name} {text}: expected {count} numbers with commas between them")
    return numbers


_SELECTION = (
    _flag("every", int, "Use each n-th scan.", _OF_LOGS),
    _flag("start", float, "From this time since the first scan on [s].", _OF_LOGS, "--from"),
    _flag("stop", float, "Up to this time since the first scan [s].", _OF_LOGS, "--to"),
    _flag("min_range", float, "Leave out shorter beams [m].", _OF_LOGS),
    _flag("stride", int, "Use each n-th beam of a scan.", _OF_LOGS),
    _flag("box", str, "Cut beams to X,Y[,Z],X,Y[,Z], two corners in the map [m].", _OF_LOGS),
    _flag("origin", str, "Point X,Y[,Z] of the log that becomes the map's origin [m].", _OF_LOGS),
)
_SELECTION_NAMES = tuple(flag.name for flag in _SELECTION)


def _reading(given: dict[str, Any]) -> Reading:
    return Reading(
        given.pop("format", None),
        given.pop("keep_going", False),
        given.pop("strict", False),
        {name: given.pop(name) for name in _SELECTION_NAMES if name in given},
        given,
    )


#: Gives a command flags for the formats and parts of logs; what was given arrives in `reading`.
reading_options = _adds_flags(
    "reading",
    [
        _flag("format", str, f"Of {', '.join(FORMATS)}; else recognised from the content.", _OF_LOGS),
        _flag("keep_going", bool, "Pass over what is damaged, and say how often.", _OF_LOGS, "--keep-going"),
        _flag("strict", bool, "Refuse logs with scans whose pose is not known.", _OF_LOGS, "--strict"),
        *_SELECTION,
        *(_flag(option.name, option.type, option.help, _OF_FORMATS) for option in READER_OPTIONS),
    ],
    _reading,
)
