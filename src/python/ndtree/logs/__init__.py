# SPDX-License-Identifier: BSD-3-Clause
"""Logs in, scans out: one file for each format, recognised by what is in the file or folder."""

from __future__ import annotations

import errno
import os
import shlex
from typing import Any

from ndtree._errors import WrongValue, key
from ndtree._native._checked import checked
from ndtree.base.option import Option
from ndtree.base.options import option
from ndtree.base.words import number_of
from ndtree.logs.core.failures import NotALog, readable, some_of
from ndtree.logs.core.joined import JoinedLog
from ndtree.logs.core.log import Log, SizedLog
from ndtree.logs.core.plain_file import are_numbers
from ndtree.logs.core.source import Format, Source, WrongOption, source_of
from ndtree.logs.folders.cloud_files import kind_of_file
from ndtree.logs.folders.depth_folders import DEPTH_FOLDER, SEVEN_SCENES, TUM_RGBD
from ndtree.logs.folders.kitti import KITTI, KITTI_RAW
from ndtree.logs.folders.point_clouds import POINT_CLOUDS
from ndtree.logs.folders.three_dtk import THREE_DTK
from ndtree.logs.formats.carmen import CARMEN
from ndtree.logs.formats.e57 import E57
from ndtree.logs.formats.npz import NPZ
from ndtree.logs.formats.octomap_graph import OCTOMAP_GRAPH
from ndtree.logs.formats.ptx import PTX
from ndtree.logs.formats.simulated import SimulatedLog, simulate
from ndtree.logs.formats.text import TEXT, fields_of, first_line
from ndtree.logs.formats.velodyne import VELODYNE
from ndtree.logs.kinds import before_formats, not_a_log, packed
from ndtree.logs.ros.rosbag import ROSBAG
from ndtree.logs.sfm.bal import BAL
from ndtree.logs.sfm.bundler import BUNDLER
from ndtree.logs.sfm.colmap import COLMAP

__all__ = [
    "FORMATS",
    "MAP_MAGIC",
    "READER_OPTIONS",
    "JoinedLog",
    "Log",
    "NotALog",
    "SimulatedLog",
    "SizedLog",
    "WrongOption",
    "contents",
    "kind_of",
    "read",
    "recognised",
    "simulate",
]

#: The table of formats, tried in this order: a format that others could be taken as comes late.
_TABLE: tuple[Format, ...] = (
    CARMEN, NPZ, ROSBAG, E57, VELODYNE, PTX, SEVEN_SCENES, TUM_RGBD, KITTI, KITTI_RAW, DEPTH_FOLDER,
    THREE_DTK, COLMAP, BUNDLER, BAL, OCTOMAP_GRAPH, POINT_CLOUDS, TEXT,
)  # fmt: skip

#: Those that are read where they are, and not unpacked on the way.
_UNPACKED = (NPZ, ROSBAG, E57, VELODYNE)

#: The words for ``format=``.
FORMATS = tuple(sorted(format.name for format in _TABLE))

#: Every option that at least one format takes.
READER_OPTIONS: tuple[Option, ...] = tuple(
    option(name) for name in dict.fromkeys(name for format in _TABLE for name in format.options)
)

_A_LOG = "a log"
_LOOKED_INTO = 20  # Of what is in a folder.
_KINDS_ARE = f"expected {_A_LOG}; which kinds there are:\n  ndtree map --help"

#: First bytes of a map's own file, and of one of OctoMap's.
MAP_MAGIC = b"\x89NDT"
OCTOMAP_MAGIC = b"# Octomap OcTree"


@checked
def read(
    path: str | os.PathLike[str],
    *,
    format: str | None = None,
    dim: int | None = None,
    keep_going: bool = False,
    strict: bool = False,
    **options: Any,
) -> Log:
    """Open a log of range scans.

    Logs are read while they are iterated, so that errors far down in a file come only then.

    Parameters
    ----------
    path : str or path
        A file or a folder. CARMEN logs and text may be packed by gzip.
    format : str, optional
        One of ``ndtree.logs.FORMATS``. Left out, it is recognised from the content.
    dim : {2, 3}, optional
        Left out, it is what the file says: an .npz recording is 2-D if no point or origin leaves one plane z.
    keep_going : bool
        Pass over damaged lines, messages and the like; the log's ``skipped`` counts them.
    strict : bool
        Raise for a scan whose pose is not known, and for a file that ends too early. Else such scans are left
        out, what there is of the file is read, and the log's ``skipped`` says so.
    **options
        What the format takes, see ``ndtree.logs.READER_OPTIONS``; None is as if left out.

    Returns
    -------
    Log
        An iterable of `Scan` with ``path``, ``format`` and ``dim``.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If the file is not what it should be: which file, where, and what was expected.
    WrongOption
        A TypeError, if the format does not take one of the options.
    """
    if dim not in (None, 2, 3):
        raise WrongValue.of("dim", f"{dim!r}", "2 or 3")
    source, chosen = _looked_up(path, format)
    given = {name: value for name, value in options.items() if value is not None}
    _require_taken(source, chosen, given)
    with readable(source.path, f"cannot be read as {chosen.description}"):
        log = chosen.log(source, dim, given)
    return log.ruled(keep_going=keep_going, strict=strict)


def contents(
    path: str | os.PathLike[str], *, format: str | None = None, whole: bool = True
) -> dict[str, Any]:
    """Say what a file or folder holds, also where it takes options to read it as a log.

    `whole`: Read all of it; else only the index and the first messages, which takes no time.
    Returns of a ROS bag: "start" and "end" [s], and "topics", each with "topic", "type", "messages" and
        "frame"; of formats that hold nothing but one log: nothing.
    """
    source, chosen = _looked_up(path, format)
    with readable(source.path, f"cannot be read as {chosen.description}"):
        return chosen.contents(source, whole) if chosen.contents else {}


def recognised(path: str | os.PathLike[str], *, format: str | None = None) -> str:
    """The format of a file or folder, one of `FORMATS`; raises as `read`, without reading the log."""
    return _looked_up(path, format)[1].name


def kind_of(path: str | os.PathLike[str]) -> tuple[str, tuple[str, ...]] | None:
    """What a file or folder that is no map is, with its article, and the commands that make a map of it.

    None where neither a format nor the table of kinds knows it.
    """
    try:
        source, chosen = _looked_up(path, None)
    except NotALog as found:
        return found.kind, found.help
    except (OSError, ValueError, ImportError):
        return None
    is_cloud = chosen is POINT_CLOUDS and not source.is_folder
    return "a point cloud" if is_cloud else chosen.description, (f"ndtree map {shlex.quote(source.path)}",)


def _looked_up(path: str | os.PathLike[str], format: str | None) -> tuple[Source, Format]:
    name = os.fspath(path)
    by_name = {row.name: row for row in _TABLE}
    if format is not None and format not in by_name:
        raise WrongValue.of("format", f"{format!r}", f"one of {', '.join(FORMATS)}")
    with readable(name):
        source = source_of(name, _A_LOG)
        chosen = by_name[format] if format is not None else _recognised(source)
    if not chosen.may_be(source):
        if source.is_folder:
            raise IsADirectoryError(errno.EISDIR, f"is a directory, expected {chosen.description}", name)
        raise NotADirectoryError(errno.ENOTDIR, f"is a file, expected {chosen.description}", name)
    return source, chosen


def _recognised(source: Source) -> Format:
    if source.head.startswith((MAP_MAGIC, OCTOMAP_MAGIC)):
        kind = "a map" if source.head.startswith(MAP_MAGIC) else "a map of OctoMap's"
        if source.packed:
            raise packed(source, kind)
        way = f"ndtree view {shlex.quote(source.path)}"
        raise ValueError(f"{source.path}: is {kind}, expected a log; to look at it:\n  {way}")
    other = before_formats(source)
    if other is not None:
        raise other
    for row in _TABLE:
        if row.may_be(source) and row.recognises(source):
            if source.packed and (row in _UNPACKED or kind_of_file(source.head) is not None):
                raise packed(source, row.description if row in _UNPACKED else "points")
            return row
    other = not_a_log(source)
    if other is not None:
        raise other
    if source.is_folder:
        if inside := [name for name in source.names[:_LOOKED_INTO] if _is_log(source.inside(name))]:
            ways = [f"ndtree map {shlex.quote(source.inside(name))}" for name in inside]
            raise NotALog(source.path, f"a folder with {number_of(len(inside), 'log')} in it", ways)
        found = f"a directory with {some_of(source.names, 6)}" if source.names else "an empty directory"
        raise IsADirectoryError(errno.EISDIR, f"is {found}, {_KINDS_ARE}", source.path)
    if b"\0" in source.head:
        raise ValueError(f"{source.path}: binary data, {_KINDS_ARE}")
    line = first_line(source)
    if line is None:
        raise ValueError(f"{source.path}: only comments, {_KINDS_ARE}")
    fields = fields_of(line[1])
    start = line[1].strip()
    start = repr(start if len(start) <= 40 else start[:37] + "...")
    if len(fields) > 7 and are_numbers(fields):
        start = f"{len(fields)} numbers"
    raise ValueError(
        f"{source.path}: line {line[0]}: found {start}, expected x y z of a point, 4 to 7 numbers of a beam, "
        "or another log; which kinds there are:\n  ndtree map --help"
    )


def _is_log(path: str) -> bool:
    """Whether a folder is a log itself."""
    try:
        source = source_of(path, _A_LOG)
        return source.is_folder and any(row.may_be(source) and row.recognises(source) for row in _TABLE)
    except (OSError, ValueError):
        return False


def require_options(
    path: str | os.PathLike[str], options: dict[str, Any], *, format: str | None = None
) -> None:
    """Refuse options that the format of a file or folder does not take, as `read` does.

    Raises WrongOption with those that it takes.
    """
    _require_taken(*_looked_up(path, format), options)


def _require_taken(source: Source, format: Format, options: dict[str, Any]) -> None:
    for name in options:
        if name not in format.options:
            taken = ", ".join(map(key, format.options)) or "none"
            said = f"{key(name)}: {format.description} takes no such option"
            raise WrongOption(f"{source.path}: {said}, it takes {taken}")
