# SPDX-License-Identifier: BSD-3-Clause
"""Ctrl-C while the command ``ndtree`` still imports what it needs.

An interrupt in a module's first lines may be taken for an error of that module, and its traceback helps no
user. So the command ends at once, with the exit status that a shell expects. A program that imports this
module without being the command keeps Python's own handler.
"""

from __future__ import annotations

import os
import signal
import sys
from types import FrameType

from ndtree.base.exit_status import INTERRUPTED


def is_command() -> bool:
    """Whether this process runs the command: its script, or ``python -m ndtree``."""
    folder, name = os.path.split(sys.argv[0] if getattr(sys, "argv", None) else "")
    if name == "__main__.py":
        return os.path.basename(folder) == "ndtree"
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
