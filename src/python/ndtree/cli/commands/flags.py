# SPDX-License-Identifier: BSD-3-Clause
"""Makes commands of functions: with the flags that the table of options has for them, read into one call."""

from __future__ import annotations

import functools
import inspect
import math
from collections.abc import Callable
from enum import Enum
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated, Any, Optional

import typer

from ndtree._errors import WrongOption, marked
from ndtree.base.exit_status import WrongCall
from ndtree.base.option import Option
from ndtree.base.options import flag_of, options_of
from ndtree.cli.commands.app import announced, guarded
from ndtree.logs import FORMATS, Log, contents, require_options
from ndtree.logs.core.rules import Selection
from ndtree.logs.core.source import point_of
from ndtree.logs.poses.pose import mount_of
from ndtree.tuning.config import Config

_LOGS = ", ".join(FORMATS)
LogArgument = Annotated[Optional[Path], typer.Argument(metavar="LOG", help=f"File or folder: {_LOGS}.")]
GivenLog = Annotated[Path, typer.Argument(metavar="LOG", help=f"File or folder: {_LOGS}.")]
GivenLogs = Annotated[list[Path], typer.Argument(metavar="LOG...", help=f"Files or folders: {_LOGS}.")]
MapArgument = Annotated[Path, typer.Argument(metavar="MAP", help=".ndt, .bt, .ot, or map_server's .yaml.")]


class Call(SimpleNamespace):
    """What was typed, by the names of options and arguments; None where nothing was."""


def command(name: str, *, usual: str, examples: tuple[str, ...]) -> Callable[[Callable[..., None]], Any]:
    """Makes a function the command of a name, with the options of the table that it takes.

    What was typed arrives in its argument `call`, and what of it says how a log is read and mapped as a
    `Config` in `given`. Its other arguments are typed without flags.

    `usual`: Names of the options that people touch, for the short help.
    """
    options = options_of(name)

    def decorate(function: Callable[..., None]) -> Callable[..., None]:
        takes = inspect.signature(function).parameters.values()
        own = [one for one in takes if one.name not in ("call", "given")]

        @functools.wraps(function)
        def run(**typed: Any) -> None:
            typed = {key: _plain(value) for key, value in typed.items()}
            arguments = {one.name: typed[one.name] for one in own}
            with guarded(name, typed):
                _require_within_limits(options, typed)
                if any(one.name == "given" for one in takes):
                    arguments["given"] = _given(options, typed)
                function(**arguments, call=Call(**typed))

        parameters = [
            *(one.replace(kind=inspect.Parameter.KEYWORD_ONLY) for one in own), *map(_parameter, options)
        ]  # fmt: skip
        run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        run.__annotations__ = {one.name: one.annotation for one in parameters}
        announced(name, run, usual.split(), ("Examples:", *examples))
        return function

    return decorate


def _parameter(option: Option) -> inspect.Parameter:
    """An option as the parser of the command line takes it."""
    kind: Any = str if option.type == list[float] else option.type
    if option.words:
        kind = Enum(option.name, {word: word for word in option.words}, type=str)
    if option.repeated:
        kind = list[kind]
    flags = [option.flags] if "/" in option.flags else option.flags.split() or [option.flag]
    bounds = {} if option.above else dict(zip(("min", "max"), option.limits or ()))
    typed = typer.Option(
        *flags,
        help=option.help.replace("[", r"\["),
        **{name: bound for name, bound in bounds.items() if math.isfinite(bound)},
    )
    is_required = option.default is ...
    # What a file of a `Config` says holds where nothing is typed.
    default = inspect.Parameter.empty if is_required else None if option.role else option.default
    return inspect.Parameter(
        option.name,
        inspect.Parameter.KEYWORD_ONLY,
        default=default,
        annotation=Annotated[kind if is_required else Optional[kind], typed],
    )


def _plain(value: Any) -> Any:
    """A word, or words, without what the parser makes of them."""
    if isinstance(value, list):
        return [_plain(one) for one in value] or None
    return value.value if isinstance(value, Enum) else value


#: Infinite where there is no limit.
_ENDLESS = ("max_range", "max_seconds")


def _require_within_limits(options: list[Option], typed: dict[str, Any]) -> None:
    """Refuses numbers that the parser lets through: infinity, NaN, and the bound itself."""
    for one in options:
        value = typed[one.name]
        if one.limits and isinstance(value, float) and not (value == math.inf and one.name in _ENDLESS):
            try:
                one.check(value)
            except ValueError:
                said = f"{one.flag} {value:g}: must be {one.expected} {one.unit}"
                raise WrongCall(said.rstrip()) from None


def _given(options: list[Option], typed: dict[str, Any]) -> Config:
    """What was typed, instead of what a file says."""
    given = Config.of(**{one.name: typed[one.name] for one in options if one.role})
    file = typed.get("config")
    return given if file is None else Config.load(file).overridden(given.values)


def typed(context: typer.Context) -> list[Any]:
    """The parameters of a command that were typed."""
    sources = [(one, context.get_parameter_source(one.name or "")) for one in context.command.params]
    return [one for one, source in sources if source is not None and source.name == "COMMANDLINE"]


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


def check_ranges(given: Config, farthest: float) -> None:
    """Refuses a shortest range that leaves no beam."""
    nearest = given.get("min_range", 0.0)
    if not nearest < farthest:
        raise WrongCall(f"--min-range {nearest:g} m: must be < --max-range {farthest:g} m")


def _check_values(given: Config) -> None:
    """Refuses values that are wrong for any log."""
    check_ranges(given, given.get("max_range", math.inf))
    if given.get("fixed") and given.get("refinement", "fixed") != "fixed":
        raise WrongCall("--refinement: not with --fixed, whose cells neither split nor merge")
    for name, parse in (("mount", mount_of), ("origin_of_scan", point_of)):
        try:
            if given.get(name) is not None:
                parse(given.get(name))
        except ValueError as error:
            raise WrongOption(marked(error)) from None
    if given.get("format", FORMATS[0]) not in FORMATS:
        raise WrongCall(f"--format {given.get('format')}: must be one of {', '.join(FORMATS)}")
