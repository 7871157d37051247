# SPDX-License-Identifier: BSD-3-Clause
"""Ctrl-C while the command ``ndtree`` still imports what it needs.

It arrives in some module's first lines, which may take it for an error of theirs; a traceback of it is no
help. So the command ends at once, with the exit status that a shell expects. A program that imports the
package as a library keeps Python's own handler.
"""

from __future__ import annotations

import os
import signal
import sys
from types import FrameType

from ndtree.exit_status import INTERRUPTED


def is_command() -> bool:
    """Whether this process runs the command: its script, or ``python -m ndtree``."""
    started = getattr(sys, "orig_argv", [])  # Python 3.10.
    name = os.path.basename(sys.argv[0]) if getattr(sys, "argv", None) else ""
    if name == "-m":  # As long as the module itself is looked for.
        return not started or any(
            pair in (("-m", "ndtree"), ("-m", "ndtree.cli")) for pair in zip(started, started[1:])
        )
    return name in ("ndtree", "ndtree.exe", "ndtree-script.py")


def end_quietly() -> None:
    """From now on an interrupt ends the process, unless the program has a handler of its own."""
    try:
        if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
            signal.signal(signal.SIGINT, _end)
    except ValueError:  # Not in the main thread.
        pass


def raise_again() -> None:
    """Undo `end_quietly`."""
    if signal.getsignal(signal.SIGINT) is _end:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _end(_number: int, _frame: FrameType | None) -> None:
    os._exit(INTERRUPTED)
