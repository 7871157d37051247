# SPDX-License-Identifier: BSD-3-Clause
"""Flags that several commands share, made from tables: options of the maps, and what of a log is read."""

from __future__ import annotations

import functools
import inspect
import math
from collections.abc import Callable, Sequence
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Annotated, Any, Optional, get_type_hints

import typer

from ndtree._errors import WrongOption, marked
from ndtree.base.exit_status import WrongCall
from ndtree.cli.commands.options import Dim, MaxRange, NoReturnKind, NoReturnOption
from ndtree.logs import FORMATS, READER_OPTIONS, Log, contents, require_options
from ndtree.logs.core.rules import Selection
from ndtree.logs.core.source import point_of
from ndtree.logs.ros.placement.mount import mount_of
from ndtree.maps.kinds import MAP_OPTIONS
from ndtree.tuning.config import Config

Command = Callable[..., None]


def _flag(name: str, type: Any, help: str, *flags: str) -> inspect.Parameter:
    """A flag that is None where it was not given."""
    option = typer.Option(*flags, help=help.replace("[", r"\["))
    return inspect.Parameter(
        name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=Annotated[Optional[type], option]
    )


def _adds_flags(flags: Sequence[inspect.Parameter]) -> Callable[[Command], Command]:
    """Gives a command flags; what was given arrives as a `Config` in its argument `given`."""

    def decorate(command: Command) -> Command:
        signature = inspect.signature(command)
        own = [p for p in signature.parameters.values() if p.name != "given"]

        @functools.wraps(command)
        def with_flags(**arguments: Any) -> None:
            values = {flag.name: arguments.pop(flag.name) for flag in flags}
            given = _gathered({name: value for name, value in values.items() if value not in (None, [])})
            command(**arguments, given=given)

        parameters = [p.replace(kind=inspect.Parameter.KEYWORD_ONLY) for p in own] + list(flags)
        with_flags.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
        with_flags.__annotations__ = {p.name: p.annotation for p in parameters}
        return with_flags

    return decorate


def takes(kind: type) -> Callable[[Command], Command]:
    """Gives a command the fields of a dataclass as arguments and flags; they arrive together in `call`."""
    hints = get_type_hints(kind, include_extras=True)

    def decorate(command: Command) -> Command:
        signature = inspect.signature(command)
        own = [one for one in signature.parameters.values() if one.name != "call"]
        typed = [
            inspect.Parameter(
                one.name,
                inspect.Parameter.KEYWORD_ONLY,
                default=inspect.Parameter.empty if one.default is MISSING else one.default,
                annotation=Annotated[hints[one.name], one.metadata["typed"]]
                if "typed" in one.metadata
                else hints[one.name],
            )
            for one in fields(kind)
        ]

        @functools.wraps(command)
        def with_fields(**arguments: Any) -> None:
            call = kind(**{one.name: arguments.pop(one.name) for one in typed})
            command(**arguments, call=call)

        parameters = [*[one.replace(kind=inspect.Parameter.KEYWORD_ONLY) for one in own], *typed]
        with_fields.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
        with_fields.__annotations__ = {one.name: one.annotation for one in parameters}
        return with_fields

    return decorate


def flag_of(name: str) -> str:
    """The flag of an option."""
    return _FLAGS.get(name, f"--{name.replace('_', '-')}")


def opened(given: Config, path: Path) -> Log:
    """The log, or the part of it that was asked for, read as flags and files say."""
    _check_values(given)
    return given.read(path)


def contents_of(given: Config, path: Path, *, whole: bool) -> dict[str, Any]:
    """What a file holds beside its scans."""
    _check_values(given)
    return contents(path, format=given.get("format"), whole=whole)


def require_taken(given: Config, path: Path) -> None:
    """Refuse options that the log's format does not take, and limits of its part that make no sense."""
    _check_values(given)
    parts = {name: value for name, value in given.selection.items() if name not in ("box", "origin")}
    try:
        Selection(3, **parts)
    except ValueError as error:
        raise WrongOption(marked(error)) from None
    require_options(path, given.reading, format=given.get("format"))


def require_none(given: Config, instead_of: str) -> None:
    """Refuses flags that nothing would read."""
    first = ("format", "keep_going", "strict")
    for name in (*given.selection, *given.reading, *(name for name in first if name in given.values)):
        raise WrongCall(f"{flag_of(name)}: is for a LOG, not for {instead_of}")


def _check_values(given: Config) -> None:
    """Refuses values that are wrong for any log."""
    for name, parse in (("mount", mount_of), ("origin_of_scan", point_of)):
        try:
            if given.get(name) is not None:
                parse(given.get(name))
        except ValueError as error:
            raise WrongOption(marked(error)) from None
    if given.get("format", FORMATS[0]) not in FORMATS:
        raise WrongCall(f"--format {given.get('format')}: must be one of {', '.join(FORMATS)}")


#: Of options whose flags have other names.
_FLAGS = {"start": "--from", "stop": "--to", "initial_pose": "--guess"}
_CONFIG = _flag("config", Path, "A file of TOML that says how LOG is read and mapped.")
#: What is read of a log, and of its format.
_READING = (
    _flag("format", str, f"Of {', '.join(FORMATS)}; else recognised from the content."),
    _flag("keep_going", bool, "Skip damaged parts, and count them.", "--keep-going"),
    _flag("strict", bool, "Refuse logs with scans whose pose is not known.", "--strict"),
    _flag("every", int, "Use each n-th scan."),
    _flag("start", float, "From this time since the first scan on [s].", "--from"),
    _flag("stop", float, "Up to this time since the first scan [s].", "--to"),
    _flag("min_range", float, "Leave out shorter beams [m]."),
    _flag("stride", int, "Use each n-th beam of a scan."),
    _flag("box", str, "Cut beams to X,Y[,Z],X,Y[,Z], two corners in the map [m]."),
    _flag("origin", str, "Point X,Y[,Z] of the log that becomes the map's origin [m]."),
    *(_flag(option.name, option.type, option.help) for option in READER_OPTIONS),
)
_MAPPING = tuple(
    inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=annotation)
    for name, annotation in (("dim", Dim), ("max_range", MaxRange), ("no_return", NoReturnOption))
)
_OF_A_MAP = tuple(_flag(option.name, option.type, option.help) for option in MAP_OPTIONS)


def _gathered(values: dict[str, Any]) -> Config:
    file = values.pop("config", None)
    values = {
        name: value.value if isinstance(value, NoReturnKind) else value for name, value in values.items()
    }
    if not values.get("max_range", math.inf) > 0:
        raise WrongCall(f"--max-range {values['max_range']:g}: must be > 0 m")
    given = Config.of(**values)
    return given if file is None else Config.load(file).overridden(given.values)


#: Each gives a command flags, and what was given arrives in `given`: of how a log is read alone; also of its
#: dimension; of how it is mapped; of the map as well; and of all this without the log.
reading_options = _adds_flags((_CONFIG, *_READING))
dim_options = _adds_flags((_CONFIG, *_READING, _MAPPING[0]))
mapping_options = _adds_flags((_CONFIG, *_READING, *_MAPPING))
map_options = _adds_flags((_CONFIG, *_READING, *_MAPPING, *_OF_A_MAP))
fleet_options = _adds_flags((_CONFIG, *_MAPPING, *_OF_A_MAP))
