# SPDX-License-Identifier: BSD-3-Clause
"""The command ``ndtree``: its entry point, and how it ends when something is wrong."""

from __future__ import annotations

import os
import sys
from typing import Any, NoReturn, TextIO

from ndtree._lazy import install_of
from ndtree.base.exit_status import WRONG_CALL
from ndtree.cli import interrupt
from ndtree.cli.help import page_asked_for

if interrupt.is_command():
    interrupt.end_quietly()


class _Heard:
    """Output whose reader may leave when it has seen enough: the work goes on without it."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        try:
            return self._stream.write(text)
        except BrokenPipeError:
            self._leave()
            return len(text)

    def flush(self) -> None:
        try:
            self._stream.flush()
        except BrokenPipeError:
            self._leave()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def _leave(self) -> None:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, self._stream.fileno())
        os.close(nowhere)


def main() -> NoReturn:
    """Run the command line and leave the process with its exit status."""
    shown = page_asked_for(sys.argv[1:])
    if shown is not None:  # At once: nothing else is loaded for it.
        sys.stdout = _Heard(sys.stdout)  # type: ignore[assignment]
        sys.stdout.write(shown)
        sys.stdout.flush()
        sys.exit(0)
    try:
        import rich  # noqa: F401

        from ndtree.cli.commands import app
    except ImportError as error:
        if error.name is None or error.name.split(".")[0] not in ("typer", "rich"):
            raise
        print(
            f"ndtree: the command line needs {error.name}; install it with:\n    {install_of('cli')}",
            file=sys.stderr,
        )
        sys.exit(WRONG_CALL)
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is not None:
            setattr(sys, name, _Heard(stream))
    app()
