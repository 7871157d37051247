# SPDX-License-Identifier: BSD-3-Clause
"""The command line itself: its name, its help, and how a command ends where something is wrong."""

import functools
import sys
import warnings
from importlib import import_module
from typing import Annotated, Any, Callable

import typer
import typer.core
import typer.main

from ndtree.base.exit_status import BAD_INPUT, WRONG_CALL, WrongCall
from ndtree.cli import interrupt


def examples(*lines: str) -> str:
    return "\n\n".join(("Examples:", *lines))


app = typer.Typer(
    name="ndtree",
    help="Occupancy maps whose cells adapt to what is measured.",
    epilog="Exit status: 0 done, 1 the input is bad, 2 the call is wrong.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)

#: By name, the commands whose modules were loaded.
_LOADED: dict[str, Any] = {}


def command(name: str, *, epilog: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Makes a function the command of this name; its module is loaded when the command is called."""

    def decorate(function: Callable[..., None]) -> Callable[..., None]:
        alone = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode="rich")
        alone.command(name, epilog=epilog)(function)
        _LOADED[name] = typer.main.get_command(alone)
        return function

    return decorate


def loaded(name: str, module: str) -> Any:
    """The command of this name, from the module that has it. Ctrl-C meanwhile ends the command quietly."""
    import_module(module)
    interrupt.raise_again()
    return _LOADED[name]


def announce(name: str, module: str, summary: str) -> None:
    """Puts a command into the help, without its module."""

    class Late(typer.core.TyperCommand):
        """What stands in the help; to be called, it becomes the command itself."""

        def make_context(self, *arguments: Any, **keywords: Any) -> Any:
            return loaded(name, module).make_context(*arguments, **keywords)

    app.command(name, cls=Late, help=summary)(lambda: None)


def reports_errors(command: Callable[..., None]) -> Callable[..., None]:
    """Ends a command with one line and the right exit status where the input or the call is bad."""

    @functools.wraps(command)
    def guarded(**arguments: Any) -> None:
        import numpy as np  # Not for the help alone.

        try:
            # Absurd numbers are counted or refused, and the commands tell of long beams in a line of theirs.
            with np.errstate(all="ignore"), warnings.catch_warnings():
                warnings.filterwarnings("ignore", r"beam \d+ is ")
                command(**arguments)
        except (BrokenPipeError, typer.Exit):
            raise
        except (WrongCall, ImportError) as error:
            _end(str(error), WRONG_CALL)
        except (OSError, ValueError, MemoryError, RuntimeError) as error:
            _end(reason_of(error), BAD_INPUT)

    return guarded


def reason_of(error: BaseException) -> str:
    """What is wrong with the input, in one line."""
    if isinstance(error, OSError):
        where = f"{error.filename}: " if error.filename else ""
        text = f"{where}{error.strerror or error}"
    else:
        text = str(error) or "not enough memory"
    return " ".join(text.split())


def _end(message: str, status: int) -> None:
    print(f"ndtree: {' '.join(message.split())}", file=sys.stderr)
    raise typer.Exit(status)


def _show_version(wanted: bool) -> None:
    if wanted:
        from ndtree._native._core import __version__  # Not for the help alone.

        print(f"ndtree {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    pass
