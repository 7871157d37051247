# SPDX-License-Identifier: BSD-3-Clause
"""Files that commands write, looked at before the work is done."""

import errno
import json
import os
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Callable, Optional

from ndtree._native._core import ReplacedFile
from ndtree.alignment.writing import is_trajectory
from ndtree.base.exit_status import WrongCall
from ndtree.base.files import begins_with, replaced, require_kind, require_no_input
from ndtree.base.options import flag_of, option
from ndtree.cli.streams import heard
from ndtree.evaluation.cleaned import ENDINGS
from ndtree.logs import kind_of
from ndtree.logs.core.archive import is_archive
from ndtree.logs.ros.files.bag import METADATA_BEGINS
from ndtree.maps.open import TILES_SUFFIX, YAML_SUFFIXES, is_map
from ndtree.maps.writers import FORMATS, format_of


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


#: Names of the commands' arguments for inputs, and for outputs.
INPUTS = "log logs other map_name source path config localize trajectory".split()
OUTPUTS = "output map_file write_config picture png reliability record rerun csv_file json_file".split()
_FOLDERS = ("demo", "study", "fleet")  # Commands whose output is one.


def check_outputs(command: str, arguments: dict[str, Any]) -> None:
    """Refuses a call that would lose data, or whose files cannot be written, before anything is read.

    `arguments` are those of the command; the two rules are those of `ndtree.base.files`.
    """
    inputs = _inputs(arguments)
    for name in OUTPUTS:
        value = arguments.get(name)
        if value is None or is_stdout(value) or "://" in str(value):
            continue
        is_argument = command == "convert" and name == "output"
        flag = "OUT" if is_argument else min(option(name, command).flags.split() or [flag_of(name)], key=len)
        if name == "output" and _is_folder(command, Path(value), arguments):
            check_no_input(flag, Path(value), inputs)
            if Path(value).exists() and not Path(value).is_dir():
                raise WrongCall(f"{flag} {value}: is a file, expected a folder")
            _check_folder(Path(value))
        else:
            fits = _fitting(command, name, Path(value), arguments)
            by_ending = fits is fits_map and command != "convert"  # Which has a flag for the format.
            check_output(flag, Path(value), inputs, fits, by_ending=by_ending)
            if (
                fits is is_trajectory
                and not arguments.get("force")
                and any(Path(value).suffix in one.suffixes for one in FORMATS)
            ):
                raise WrongCall(f"{flag} {value}: poses are text, expected another ending, such as .txt")


def check_output(
    flag: str,
    target: Path,
    inputs: Sequence[Path],
    fits: Optional[Callable[[str], bool]] = None,
    *,
    by_ending: bool = False,
) -> None:
    """Refuses a file that is read, that would replace one of another kind, or that cannot be written."""
    for path in _together(flag, target):
        check_no_input(flag, path, inputs)
        if by_ending and path == target and not path.is_dir():
            try:
                format_of(target, None, {})
            except ValueError as error:
                raise WrongCall(f"{flag} {error}") from None
        try:
            require_kind(path, fits if path == target else None)
        except FileExistsError:
            raise WrongCall(
                f"{flag} {path}: is {_kind_of(path)}, expected a new name, or --force to replace it"
            ) from None
    _check_target(target)


def check_dim(flag: str, target: Path, dim: int) -> None:
    """Refuses a file whose format cannot hold the map of a log, before that is mapped."""
    dims = format_of(target, None, {}).dims
    if dim not in dims:
        only = " and ".join(f"{one}-D" for one in dims)
        raise WrongCall(
            f"{flag} {target}: the log is {dim}-D, and such files hold {only} maps alone, expected .ndt"
        )


def check_no_input(flag: str, target: Path, inputs: Sequence[Path]) -> None:
    try:
        require_no_input(target, inputs)
    except ValueError as error:
        raise WrongCall(f"{flag} {error}") from None


def _inputs(arguments: dict[str, Any]) -> list[Path]:
    """Files and folders that a call reads: named by itself, or by one of them."""
    given: list[Path] = []
    for name in INPUTS:
        value = arguments.get(name)
        given += [Path(one) for one in (value if isinstance(value, list) else [value]) if one is not None]
    for path in list(given):
        if path.suffix.lower() not in YAML_SUFFIXES or not path.is_file():
            continue
        if begins_with(path, METADATA_BEGINS):  # Of a bag, which is its folder.
            given.append(path.parent)
        with open(path, "rb") as file:
            image = re.search(rb"^image:[ \t]*['\"]?([^'\"\r\n]+)", file.read(1 << 16), re.MULTILINE)
        if image is not None:
            given.append(path.parent / os.fsdecode(image[1].strip()))
    return given


def _is_folder(command: str, target: Path, arguments: dict[str, Any]) -> bool:
    if command == "map":
        several = len(arguments["logs"]) > 1
        is_folder = not arguments["merge"] and (several or target.is_dir())
        return is_folder or target.suffix.lower() == TILES_SUFFIX
    return command in _FOLDERS or (command == "clean" and target.suffix.lower() not in ENDINGS)


def _fitting(
    command: str, name: str, target: Path, arguments: dict[str, Any]
) -> Optional[Callable[[str], bool]]:
    """What a file that is there must be beside what its ending says, to be replaced."""
    if name == "json_file":
        return lambda path: begins_with(path, rb"\s*[{\[]")
    if name == "csv_file":
        return lambda path: begins_with(path, rb"log,scans,")
    if name not in ("output", "map_file"):
        return None
    if name == "output" and (command == "align" or arguments.get("localize") is not None):
        return is_trajectory
    if command == "plan":
        return lambda path: begins_with(path, rb"x,y|length: |\s*[{\[]")
    if command in ("simulate", "clean"):
        return is_archive if target.suffix.lower() == ".npz" else None
    return fits_map


def fits_map(path: str) -> bool:
    """Whether a file is no recording, and may be replaced by a map."""
    try:
        return format_of(Path(path), None, {}).fits(path)
    except ValueError:  # Said by who writes it.
        return True


def _together(flag: str, target: Path) -> list[Path]:
    """All files of an output: for map_server the YAML file and the image."""
    if flag in ("-o", "OUT", "--map") and target.suffix in (".yaml", ".pgm", ".png"):
        image = target if target.suffix != ".yaml" else target.with_suffix(".pgm")
        return [target, *({target.with_suffix(".yaml"), image} - {target})]
    return [target]


def _kind_of(path: Path) -> str:
    """What a file is, with its article."""
    if is_map(path) and path.suffix.lower() not in YAML_SUFFIXES:
        return "a map"
    known = kind_of(path)
    return known[0] if known is not None else "there already, and something else"


def _check_folder(folder: Path) -> None:
    """Refuses a folder that could not be made, or not be written into, before the work is done."""
    there = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    try:
        ReplacedFile(there / folder.name).discard()
    except OSError as error:
        raise OSError(error.errno, f"cannot be written: {error.strerror}", str(folder)) from None


def _check_target(target: Path) -> None:
    """Refuses a file that could not be written before the work is done, not after it."""
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
    if target is not None and target.suffix.lower() not in plot.FORMATS:
        raise WrongCall(f"{flag} {target}: the name must end in {', '.join(plot.FORMATS)}")
