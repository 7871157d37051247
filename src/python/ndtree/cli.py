# SPDX-License-Identifier: BSD-3-Clause
"""The command ``ndtree``: its entry point, and how it ends when something is wrong."""

from __future__ import annotations

import os
import sys
from typing import NoReturn

from ndtree import _interrupt
from ndtree.exit_status import DONE, WRONG_CALL


def main() -> NoReturn:
    """Run the command line and leave the process with its exit status."""
    try:
        from ndtree.commands import app
    except ImportError as error:
        if error.name is None or error.name.split(".")[0] not in ("typer", "rich"):
            raise
        print(
            f"ndtree: the command line needs {error.name}; "
            "install it with: pip install 'ndtree-mapping[cli]'",
            file=sys.stderr,
        )
        sys.exit(WRONG_CALL)
    _interrupt.raise_again()
    try:
        app()
    except BrokenPipeError:  # The reader of our output has seen enough.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(DONE)


if __name__ == "__main__":
    main()
