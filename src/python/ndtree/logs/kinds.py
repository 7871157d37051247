# SPDX-License-Identifier: BSD-3-Clause
"""What a file or a folder is that is no log: its kind by name, and what to do with it."""

from __future__ import annotations

import json
import os
import re
import shlex
from collections import Counter
from dataclasses import dataclass

from ndtree.logs.core.failures import NotALog, shown
from ndtree.logs.core.source import Source
from ndtree.logs.poses.trajectory_files import trajectory_kind

_UNPACK = "unpacking it, then ndtree map on the folder or the log in it"
_EXPORT = "exporting E57 or PTX from {program}: these have a pose for each scan"
_TO_CLOUDS = "ouster-cli source {path} save scans.csv (pip install ouster-sdk), then their folder"
_DEPTH = "ndtree map FOLDER, with its depth images and their poses, as Open3D, TUM or 7-Scenes have them"


@dataclass(frozen=True)
class _Kind:
    """One row: first bytes at a place of the file, or endings of its name, or both."""

    kind: str
    help: str = ""
    magic: tuple[bytes, ...] = ()
    at: int = 0
    endings: tuple[str, ...] = ()

    def fits(self, source: Source) -> bool:
        if self.magic and not source.head.startswith(self.magic, self.at):
            return False
        return not self.endings or source.path.lower().endswith(self.endings)


#: Tried in this order. ``{path}`` in a help is the file.
_KINDS = (
    _Kind("a PNG image", _DEPTH, (b"\x89PNG\r\n",)),
    _Kind("a JPEG image", _DEPTH, (b"\xff\xd8\xff",)),
    _Kind("a TIFF image", _DEPTH, (b"II*\0", b"MM\0*")),
    _Kind(
        "an image of map_server's", "ndtree info on the .yaml beside it", (b"P5", b"P2"), endings=(".pgm",)
    ),
    _Kind("a picture of portable graymap kind", _DEPTH, (b"P5\n", b"P2\n", b"P6\n")),
    _Kind("a PDF", "", (b"%PDF",)),
    _Kind(
        "an archive of tar", "tar xf {path}, then ndtree map on the folder or the log in it", (b"ustar",), 257
    ),
    _Kind("an archive of 7-Zip", _UNPACK, (b"7z\xbc\xaf\x27\x1c",)),
    _Kind("an archive of RAR", _UNPACK, (b"Rar!",)),
    _Kind("a file packed by xz", "xz -dk {path}", (b"\xfd7zXZ",)),
    _Kind("a file packed by zstd", "zstd -d {path}", (b"\x28\xb5\x2f\xfd",)),
    _Kind("a PX4 or other ULog", "its poses as a CSV with a header, for --trajectory", (b"ULog",)),
    _Kind("an HDF5", "an .npz of its points and poses: origins, points, offsets", (b"\x89HDF",)),
    _Kind(
        "an array of NumPy",
        "an .npz with origins, points, offsets",
        (b"\x93NUMPY",),
    ),
    _Kind("a table of Parquet", "an .npz of its points and poses: origins, points, offsets", (b"PAR1",)),
    _Kind("a file of MATLAB", "an .npz of its points and poses: origins, points, offsets", (b"MATLAB 5.0",)),
    _Kind("a bag of ROS before 1.0", "rosbag fix {path} OUT.bag", (b"#ROSRECORD", b"#ROSBAG V1")),
    _Kind("a recording of Livox Viewer", "a bag by livox_ros_driver, which reads .lvx", (b"livox_tech",)),
    _Kind("a recording of Ouster (OSF)", _TO_CLOUDS, (b"OSF!",), 8),
    _Kind("a recording of Ouster (OSF)", _TO_CLOUDS, endings=(".osf",)),
    _Kind(
        "a state of Cartographer",
        "the bag that it was made from, with its trajectory: ndtree map BAG --trajectory FILE",
        (b"\xdb\x01\xf5\x5b\x7b\x1f\x1d\x7b",),
    ),
    _Kind("a recording of OpenNI", "its depth images in a folder with their poses", (b"NI10",)),
    _Kind(
        "a recording of a ZED camera (SVO)",
        "its depth images in a folder with their poses",
        endings=(".svo", ".svo2"),
    ),
    _Kind("a scan of FARO", _EXPORT.format(program="SCENE"), endings=(".fls", ".fws", ".lsproj")),
    _Kind(
        "a scan of Zoller + Fröhlich",
        _EXPORT.format(program="LaserControl"),
        endings=(".zfs", ".zfc", ".zfprj"),
    ),
    _Kind("a scan of RIEGL", _EXPORT.format(program="RiSCAN PRO"), endings=(".rxp", ".rdb", ".rdbx", ".rsp")),
    _Kind(
        "a scan of Leica",
        _EXPORT.format(program="Cyclone or Register 360"),
        endings=(".lgs", ".lgsx", ".imp", ".blk"),
    ),
    _Kind("a scan of Trimble", _EXPORT.format(program="RealWorks"), endings=(".tzf", ".tzs", ".rwp")),
    _Kind("a scan of Topcon", _EXPORT.format(program="MAGNET Collage"), endings=(".clr", ".cl3")),
    _Kind("a project of Autodesk ReCap", _EXPORT.format(program="ReCap"), endings=(".rcs", ".rcp")),
    _Kind("a cloud of CloudCompare", "saving it as E57 or PLY in CloudCompare", (b"CCB2",)),
    _Kind(
        "a cloud of CloudCompare",
        "saving it as E57 or PLY in CloudCompare",
        endings=(".bin",),
        magic=(b"CCB",),
    ),
    _Kind("a mesh (glTF)", "sampling points on it: CloudCompare saves them as PLY", (b"glTF",)),
    _Kind("a mesh (STL)", "sampling points on it: CloudCompare saves them as PLY", endings=(".stl",)),
    _Kind("a mesh (OBJ)", "sampling points on it: CloudCompare saves them as PLY", endings=(".obj",)),
    _Kind(
        "a mesh (OFF)",
        "sampling points on it: CloudCompare saves them as PLY",
        (b"OFF", b"COFF"),
        endings=(".off",),
    ),
    _Kind("a video", "", (b"ftyp",), 4),
    _Kind("a program", "", (b"\x7fELF", b"MZ\x90", b"\xcf\xfa\xed\xfe")),
    _Kind("a database of SQLite without a bag in it", "", (b"SQLite format 3",)),
    _Kind("text in UTF-16", "iconv -f UTF-16 -t UTF-8 {path} > text.csv", (b"\xff\xfe", b"\xfe\xff")),
    _Kind("a grid of heights (ESRI)", "", (b"ncols", b"NCOLS")),
    _Kind(
        "a pickle of Python",
        "an .npz of its points and poses: origins, points, offsets",
        endings=(".pkl", ".pickle"),
    ),
    _Kind("a model of PyTorch", "", endings=(".pt", ".pth")),
)
#: Single files of scans, in a folder of which each is a log of its own.
_LOGS = (".bag", ".mcap", ".db3", ".e57", ".ptx", ".pcap", ".pcapng", ".npz", ".graph", ".log", ".clf")
_SHOWN = 60
#: Endings of text that is written by people, or configures programs.
_TEXTS = (
    ".yaml", ".yml", ".md", ".rst", ".py", ".cpp", ".hpp", ".h", ".m", ".sh", ".launch", ".toml", ".ini",
    ".cfg",
)  # fmt: skip


def not_a_log(source: Source) -> NotALog | None:
    """What a source is that no format has recognised; None where that is not known either."""
    path = shlex.quote(source.path)
    if source.is_folder:
        return _of_folder(source, path)
    for row in _KINDS:
        if row.fits(source):
            return NotALog(source.path, row.kind, [row.help.format(path=path)] if row.help else [])
    if b"\0" in source.head:
        return None
    return _of_text(source, path)


def before_formats(source: Source) -> NotALog | None:
    """What looks like points or beams in text, and is not."""
    if source.is_folder or b"\0" in source.head:
        return None
    if source.head[:5].lower() == b"ncols":
        return not_a_log(source)
    return None


def _of_folder(source: Source, path: str) -> NotALog | None:
    endings = Counter(os.path.splitext(name)[1].lower() for name in source.names)
    found = [(count, ending) for ending, count in endings.items() if ending in _LOGS]
    if found:
        count, ending = max(found)
        first = next(name for name in source.names if name.lower().endswith(ending))
        ways = [f"ndtree map {shlex.quote(os.path.join(source.path, first))}"]
        if count > 1:
            ways = [f"ndtree map {path}/*{ending} --merge -o OUT.ndt (all in one frame)", *ways]
        return NotALog(source.path, f"a folder with {count} {ending} file{'s' if count > 1 else ''}", ways)
    images = sum(endings[ending] for ending in (".png", ".jpg", ".jpeg", ".tif", ".tiff"))
    if images and images >= len(source.names) / 2:
        return NotALog(source.path, f"a folder with {images} images, without poses", [_DEPTH])
    return None


def _of_text(source: Source, path: str) -> NotALog | None:
    """Text that is no log: poses, or something else by its beginning."""
    head = source.head.decode("utf-8", "replace")
    kind = trajectory_kind(source.path)
    if kind is not None:
        what = "poses with times" if kind == "tum" else "poses by their number"
        return NotALog(source.path, f"a trajectory, {what}", [f"ndtree map LOG --trajectory {path}"])
    start = head.lstrip()
    if start.startswith(("{", "[")) and _is_json(head, source):
        return NotALog(source.path, "text in JSON, and none of the kinds that are read")
    if start.startswith("<"):
        name = re.search(r"<(?!\?|!)([\w:.-]+)", start)
        return NotALog(source.path, f"text in XML{f' ({name[1][:_SHOWN]})' if name else ''}")
    names = _columns_in(head)
    if names is not None:
        some = shown(", ".join(names), _SHOWN)
        return NotALog(
            source.path, f"a table with columns {some}", ["a header that names x, y and z of points"]
        )
    if source.path.lower().endswith(_TEXTS):
        ending = os.path.splitext(source.path)[1]
        return NotALog(source.path, f"text ({ending}), and no log")
    return None


def _columns_in(head: str) -> list[str] | None:
    """Names of a table's columns: words in the first line, and as many fields with numbers in the second."""
    lines = [line for line in head.splitlines()[:20] if line.strip()][:2]
    if len(lines) < 2:
        return None
    for separator in (",", ";", "\t"):
        names, values = ([field.strip(" \"'#") for field in line.split(separator)] for line in lines)
        if len(names) > 1 and len(names) == len(values) and all(re.match(r"[^\W\d]", name) for name in names):
            return names if any(re.fullmatch(r"[-+.\deE]+", value) for value in values) else None
    return None


def _is_json(head: str, source: Source) -> bool:
    try:
        json.loads(head)
    except (ValueError, RecursionError):
        return source.path.lower().endswith((".json", ".geojson"))
    return True
