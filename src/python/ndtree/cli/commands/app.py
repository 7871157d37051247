# SPDX-License-Identifier: BSD-3-Clause
"""The command line itself: its name, its help, and how a command ends where something is wrong."""

import os
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from typing import Annotated, Any, Callable, Union

import typer
import typer.core
import typer.main

from ndtree._errors import leading_key, marked
from ndtree.base.exit_status import BAD_INPUT, WRONG_CALL, WrongCall
from ndtree.cli import interrupt
from ndtree.cli.help import asks_for_all, page, page_asked_for
from ndtree.cli.streams import heard, silenced


class Group(typer.core.TyperGroup):
    """The command ``ndtree``: its pages are files, and a call that cannot be read ends in one line."""

    def get_help(self, ctx: Any) -> str:
        return (page_asked_for(["--help"]) or "").rstrip("\n")

    def main(self, args: Any = None, *more: Any, **keywords: Any) -> Any:
        words = list(sys.argv[1:] if args is None else args)
        if not keywords.pop("standalone_mode", True):
            return super().main(words, *more, standalone_mode=False, **keywords)
        if not words and "_NDTREE_COMPLETE" not in os.environ:  # Shells complete with no words.
            print(self.get_help(None), file=sys.stderr)
            sys.exit(WRONG_CALL)
        try:
            status = super().main(words, *more, standalone_mode=False, **keywords)
        except Exception as error:
            if not isinstance(error, _CLICK):
                raise
            from ndtree.cli.commands.usage import usage_error  # Not for calls that can be read.

            print_error(usage_error(error, words, _LOADED))
            status = WRONG_CALL
        sys.exit(status if isinstance(status, int) else 0)


#: What the parser of the command line raises.
_CLICK = next(one for one in typer.BadParameter.__mro__ if one.__name__ == "ClickException")


app = typer.Typer(
    name="ndtree",
    cls=Group,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help", "--help-all"]},
)

#: By name, the commands whose modules were loaded.
_LOADED: dict[str, Any] = {}


#: By name, the options of a loaded command that people touch.
USUAL: dict[str, list[str]] = {}


def announced(name: str, function: Callable[..., None], usual: list[str], epilog: Sequence[str]) -> None:
    """Makes a function the command of this name; its module is loaded when the command is called."""
    alone = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    alone.command(name, epilog="\n\n".join(epilog))(function)
    _LOADED[name] = typer.main.get_command(alone)
    USUAL[name] = usual


def loaded(name: str, module: str) -> Any:
    """The command of this name, from the module that has it. Ctrl-C meanwhile ends the command quietly."""
    import_module(module)
    interrupt.raise_again()
    return _LOADED[name]


def announce(name: str, module: str) -> None:
    """Puts a command into the help, without its module; what it does, its page says."""

    class Late(typer.core.TyperCommand):
        """What stands in the help; to be called, it becomes the command itself."""

        def make_context(self, info_name: Any, args: list[str], *more: Any, **keywords: Any) -> Any:
            shown = page_asked_for([name, *args])
            if shown is None and asks_for_all(args):
                from ndtree.cli.commands.whole_page import whole_page  # Not for other calls.

                shown = whole_page(name, loaded(name, module))
            if shown is not None:
                print(shown, end="")
                raise typer.Exit
            return loaded(name, module).make_context(info_name, _with_stdout(args), *more, **keywords)

    summary = (page(name) or "").split("\n\n")
    app.command(name, cls=Late, help=" ".join(summary[1:2]))(lambda: None)


def _with_stdout(words: list[str]) -> list[str]:
    """``--json`` without a file prints."""
    ends = words.index("--") if "--" in words else len(words)
    result = []
    for i, word in enumerate(words):
        result.append(word)
        following = words[i + 1] if i + 1 < ends else "--"
        if i < ends and word == "--json" and following.startswith("-") and following != "-":
            result.append("-")
    return result


#: Commands that read a file of keywords, which errors name as the file has them.
_OF_KEYWORDS = ("study",)


@contextmanager
def guarded(name: str, arguments: dict[str, Any]) -> Iterator[None]:
    """Ends a command with clear lines and the right exit status where the input or the call is bad."""
    import numpy as np  # Not for the help alone.

    from ndtree.base.files import replacing_all
    from ndtree.cli.commands.output import check_outputs
    from ndtree.logs.core.failures import WrongOption

    has_flags = name not in _OF_KEYWORDS
    # Absurd numbers are counted or refused, and the commands tell of long beams in a line of theirs.
    force, quiet = arguments["force"], arguments["quiet"]
    try:
        with np.errstate(all="ignore"), warnings.catch_warnings(), silenced(quiet), replacing_all(force):
            warnings.filterwarnings("ignore", r"beam \d+ is ")
            warnings.showwarning = _show_warning  # type: ignore[assignment]
            check_outputs(name, arguments)
            yield
    except (BrokenPipeError, typer.Exit):
        raise
    except (WrongCall, WrongOption, ImportError) as error:
        _end(error, WRONG_CALL, has_flags)
    except (OSError, ValueError, MemoryError, RuntimeError) as error:
        _end(reason_of(error), WRONG_CALL if leading_key(marked(error)) else BAD_INPUT, has_flags)


def reason_of(error: Exception) -> Union[str, Exception]:
    """What is wrong with the input."""
    if isinstance(error, OSError):
        where = f"{error.filename}: " if error.filename else ""
        return f"{where}{error.strerror or error}"
    return error if str(error) else "not enough memory"


def print_error(message: Union[str, Exception], has_flags: bool = True) -> None:
    """Print what is wrong, in the words of the command line if it has some; also where all else is silent."""
    from ndtree.cli.commands.messages import laid_out  # Not for the help alone.

    print(laid_out(message, has_flags), file=heard(sys.stderr))


def _show_warning(message: Any, *_: Any) -> None:
    from ndtree.cli.commands.messages import laid_out  # Not for the help alone.

    print(laid_out(message.args[0] if message.args else message), file=sys.stderr)


def _end(message: Union[str, Exception], status: int, has_flags: bool) -> None:
    print_error(message, has_flags)
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
