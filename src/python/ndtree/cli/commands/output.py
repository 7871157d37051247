# SPDX-License-Identifier: BSD-3-Clause
"""Files that commands write, looked at before the work is done."""

import errno
import json
import sys
from pathlib import Path
from typing import Any, Callable, Optional

from ndtree._native._core import ReplacedFile
from ndtree.base.exit_status import WrongCall
from ndtree.base.files import replaced
from ndtree.cli.streams import heard


def write_json(figures: dict[str, Any], target: Optional[Path]) -> None:
    write(lambda: json.dumps(figures, indent=2, allow_nan=False) + "\n", target)


def write(text: Callable[[], str], target: Optional[Path]) -> None:
    if target is None:
        return
    if is_stdout(target):
        heard(sys.stdout).write(text())
        return
    with replaced(target) as path:
        path.write_text(text(), encoding="utf-8")


def is_stdout(target: Optional[Path]) -> bool:
    return str(target) == "-"


def check_json(target: Optional[Path]) -> None:
    """Refuses a file that is there and is no JSON: ``--json LOG`` would replace the log."""
    if target is None or is_stdout(target) or target.suffix.lower() == ".json":
        return
    if target.is_file() and target.stat().st_size:
        raise WrongCall(f"--json {target}: is there already, expected a name in .json, or nothing, to print")


def check_target(target: Optional[Path]) -> None:
    """Refuses a file that could not be written before the work is done, not after it."""
    if target is None or is_stdout(target):
        return
    if target.is_dir():
        raise IsADirectoryError(
            errno.EISDIR, "is a folder, expected the name of a file to write", str(target)
        )
    try:
        if not target.is_fifo():  # Whose reader would take the end of this for the end of all.
            ReplacedFile(target).discard()
    except OSError as error:
        raise OSError(error.errno, f"cannot be written: {error.strerror}", str(target)) from None


def check_picture(plot: Any, target: Optional[Path], flag: str = "--picture") -> None:
    check_target(target)
    if target is not None and target.suffix.lower() not in plot.FORMATS:
        raise WrongCall(f"{flag} {target}: the name must end in {', '.join(plot.FORMATS)}")
