# SPDX-License-Identifier: BSD-3-Clause
"""The command line itself: its name, its help, and how a command ends where something is wrong."""

import functools
import sys
import warnings
from typing import Annotated, Any, Callable

import numpy as np
import typer

from ndtree._native import _core
from ndtree.base.exit_status import BAD_INPUT, WRONG_CALL, WrongCall


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


def reports_errors(command: Callable[..., None]) -> Callable[..., None]:
    """Ends a command with one line and the right exit status where the input or the call is bad."""

    @functools.wraps(command)
    def guarded(**arguments: Any) -> None:
        try:
            with (
                np.errstate(all="ignore"),
                warnings.catch_warnings(),
            ):  # Absurd numbers are counted or refused.
                warnings.filterwarnings(
                    "ignore", r"beam \d+ is "
                )  # The commands tell of them in a line of theirs.
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
        print(f"ndtree {_core.__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    pass
