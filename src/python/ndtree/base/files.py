# SPDX-License-Identifier: BSD-3-Clause
"""Files that appear whole or not at all, around ``ndtree::ReplacedFile``, and never in place of others' data.

Two rules hold for every file that is written: it is none that the same call reads (`require_no_input`), and
it replaces nothing but a file of its own kind (`require_kind`).
"""

from __future__ import annotations

import errno
import os
import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from ndtree._native import _core

#: How files with an ending begin. Of endings that are not here, who writes them says what fits.
_BEGINNINGS = {
    rb"\x89NDT": ("", ".ndt"),
    rb"# Octomap OcTree|\x03\0\0\0": (".bt", ".ot"),
    rb"(?:.*\n)?image:": (".yaml", ".yml"),
    rb"P[25]\s": (".pgm",),
    rb"#ROSBAG V": (".bag",),
    rb"\x89MCAP": (".mcap",),
    rb"SQLite format 3": (".db3",),
    rb"ply\r?\n": (".ply",),
    rb"# \.PCD|VERSION": (".pcd",),
    rb"glTF": (".glb",),
    rb"\s*[{\[]": (".gltf", ".json"),
    rb"<\?xml|<VTKFile|<svg|<!DOCTYPE svg": (".vtu", ".svg"),
    rb"PK\x03\x04": (".npz",),
    rb"\x93NUMPY": (".npy",),
    rb"\x89PNG": (".png",),
    rb"\xff\xd8\xff": (".jpg", ".jpeg"),
    rb"II\*\0|MM\0\*": (".tif", ".tiff"),
    rb"GIF8": (".gif",),
    rb"....ftyp": (".avif", ".mp4"),
    rb"RIFF....WEBP": (".webp",),
    rb"%PDF": (".pdf",),
    rb"%!PS": (".eps", ".ps"),
    rb"\x1f\x8b": (".svgz",),
    rb"RRF|RRIO": (".rrd",),
    rb"(?!)": (".raw", ".rgba"),  # Pixels alone, which nothing tells from data.
}
_BEGINNING = {ending: begins for begins, endings in _BEGINNINGS.items() for ending in endings}

#: Whether files of any kind are replaced; a switch of the command line for the whole process.
_replaces_all = False


@contextmanager
def replacing_all(wanted: bool) -> Iterator[None]:
    """While files of any kind may be replaced, if they may."""
    global _replaces_all
    before, _replaces_all = _replaces_all, wanted
    try:
        yield
    finally:
        _replaces_all = before


def begins_with(path: str | os.PathLike[str], beginning: bytes) -> bool:
    """Whether a file's first bytes match a regular expression."""
    with open(path, "rb") as file:
        return re.match(beginning, file.read(4096), re.DOTALL) is not None


def require_kind(target: str | os.PathLike[str], fits: Callable[[str], bool] | None = None) -> None:
    """Refuse to replace a file that is not of the kind that its ending says, or that does not fit.

    What is empty, and what is no regular file, is not in the way.

    Raises FileExistsError: it names the file.
    """
    name = os.fspath(target)
    if _replaces_all or not os.path.isfile(name) or not os.path.getsize(name):
        return
    beginning = _BEGINNING.get(os.path.splitext(name)[1].lower())
    if (beginning is None or begins_with(name, beginning)) and (fits is None or fits(name)):
        return
    raise FileExistsError(errno.EEXIST, "holds something else, expected a new name", name)


def require_no_input(target: str | os.PathLike[str], inputs: Iterable[str | os.PathLike[str]]) -> None:
    """Refuse to write what is read: a file by whatever name, in an input folder, or an input folder itself.

    Looks at no content. O(1), but of a folder whose files could be the target by a link: O(its files).

    Raises ValueError: it names the target and the input.
    """
    path = os.path.realpath(target)
    own = _identity(path)
    around = []
    while path != os.path.dirname(path):
        path = os.path.dirname(path)
        around.append(_identity(path))
    for one in map(os.fspath, inputs):
        read = _identity(one)
        if read is None:
            continue
        if read == own:
            raise ValueError(f"{os.fspath(target)}: is {one}, which is read, expected another name")
        if read in around:
            raise ValueError(f"{os.fspath(target)}: is in {one}, which is read, expected a place elsewhere")
        if own is not None and os.path.isdir(one):
            _require_not_inside(target, own, one)


def _require_not_inside(target: str | os.PathLike[str], own: tuple[int, int], folder: str) -> None:
    """Refuse a target that is a link's other end, or one of whose files is, in a folder."""
    written = {own}
    if os.path.isdir(target):
        written = {found for name in os.listdir(target) if (found := _identity(os.path.join(target, name)))}
    for at, _, names in os.walk(folder):
        for name in names:
            if _identity(os.path.join(at, name)) in written and not os.path.samefile(at, target):
                raise ValueError(
                    f"{os.fspath(target)}: is linked with {os.path.join(at, name)}, which is read, "
                    "expected another name"
                )


def _identity(path: str | os.PathLike[str]) -> tuple[int, int] | None:
    """Device and number of a file or folder, whatever its name; None where there is none."""
    try:
        found = os.stat(path)
    except (OSError, ValueError):
        return None
    return found.st_dev, found.st_ino


@contextmanager
def replaced(target: str | os.PathLike[str], fits: Callable[[str], bool] | None = None) -> Iterator[Path]:
    """A hidden name with a file's ending, which takes the file's place when all went well.

    Raises OSError if the file cannot be written, or libraries that write it fail for whatever reason; it
    names the file. See `require_kind` for what is not replaced.
    """
    require_kind(target, fits)
    with replaced_together(target) as (part,):
        yield part


@contextmanager
def replaced_together(*targets: str | os.PathLike[str]) -> Iterator[list[Path]]:
    """As `replaced`, of files that belong together; the one that names the others comes last."""
    files: list[_core.ReplacedFile] = []
    try:
        for target in targets:
            require_kind(target)
            files.append(_core.ReplacedFile(target))
        parts = [Path(file.temporary) for file in files]
        try:
            yield parts
        except OSError as error:
            names = {os.fspath(part): os.fspath(target) for part, target in zip(parts, targets)}
            given = None if error.filename is None else os.fspath(error.filename)
            if given is not None and given not in names:
                raise
            name = os.fspath(targets[0]) if given is None else names[given]
            raise OSError(error.errno or errno.EIO, error.strerror or str(error), name) from error
        except (ImportError, MemoryError, TypeError, ValueError):
            raise
        except Exception as error:  # Of a library that has errors of its own for a disk that is full.
            said = " ".join(f"{type(error).__name__}: {error}".split())
            raise OSError(errno.EIO, f"cannot be written ({said[:200]})", os.fspath(targets[0])) from error
        _core.commit_together(files)
    finally:
        for file in files:
            file.discard()
