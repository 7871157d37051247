# SPDX-License-Identifier: BSD-3-Clause
"""What a file or a folder is that is no log: its kind by name, and what to do with it."""

from __future__ import annotations

import os
import re
import shlex
import zipfile
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

from ndtree.base.words import number_of
from ndtree.logs.core.failures import NotALog, shown
from ndtree.logs.core.plain_file import wrongly_written
from ndtree.logs.core.source import Source, source_of
from ndtree.logs.folders.text_clouds import ECHOED, is_of_degrees
from ndtree.logs.formats.npz import ZIP_MAGIC
from ndtree.logs.poses.trajectory_files import read_trajectory, trajectory_kind

_NPZ = 'in Python: numpy.savez("scan.npz", origins=[[x, y, z]], points=points, offsets=[0, len(points)])'
_SHEET = "saving it as CSV, with a header that names x, y and z"
_POINTS_ON = "sampling points on it: CloudCompare saves them as PLY"
_OF_VTK = "saving it as PLY in ParaView"
_FRAMES = "COLMAP on its frames, then ndtree map on its text model"
_OF_KARTO = "its map as map_server's (map_saver_cli -f MAP): ndtree info MAP.yaml; or the bag"
#: Of programs that make models of photographs: a file of theirs, words in it, what it is, and what helps.
_OPENSFM = "opensfm export_colmap FOLDER, then ndtree map on the text model that it writes"
_MODELS = (
    ("transforms.json", '"transform_matrix"', "cameras of Nerfstudio or instant-ngp", _FRAMES),
    ("transforms_train.json", '"transform_matrix"', "cameras of Nerfstudio or instant-ngp", _FRAMES),
    ("reconstruction.json", '"shots"', "a reconstruction of OpenSfM", _OPENSFM),
)
_IN_IT = "ndtree map on the folder or the log in it"
_UNPACK = f"unpacking it, then {_IN_IT}"
_OF_PGM = "ndtree info on the .yaml beside it, or ndtree map on a folder of depth images and their poses"
_OF_STATES = "the bag that it was made from, with its trajectory: ndtree map BAG --trajectory FILE"
_OF_CLOUDS = "saving it as E57 or PLY in CloudCompare"
_IMAGES = "its depth images in a folder with their poses"
_POSES = "a trajectory with orientations: t x y z qx qy qz qw a line, in metres"
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
    first: bool = False  # Formats could take it for theirs.

    def fits(self, source: Source) -> bool:
        if self.magic and not source.head.startswith(self.magic, self.at):
            return False
        return not self.endings or source.path.lower().endswith(self.endings)


def _scan(kind: str, program: str, *endings: str) -> _Kind:
    """Files of a maker of scanners, whose own program exports what is read."""
    way = f"exporting E57 or PTX from {program}: these have a pose for each scan"
    return _Kind(kind, way, endings=endings)


#: Tried in this order. ``{path}`` in a help is the file.
_KINDS = (
    _Kind("a pointer of Git LFS", "git lfs pull in its clone", (b"version https://git-lfs",), first=True),
    _Kind("a pointer of git-annex", "git annex get {path}", (b"/annex/objects/",), first=True),
    _Kind("a PNG image", _DEPTH, (b"\x89PNG\r\n",)),
    _Kind("a JPEG image", _DEPTH, (b"\xff\xd8\xff",)),
    _Kind("a TIFF image", _DEPTH, (b"II*\0", b"MM\0*")),
    _Kind("an image of map_server's or a depth image", _OF_PGM, (b"P5", b"P2"), endings=(".pgm",)),
    _Kind("a picture of portable graymap kind", _DEPTH, (b"P5\n", b"P2\n", b"P6\n")),
    _Kind("a BMP image", _DEPTH, (b"BM",), endings=(".bmp",)),
    _Kind("a GIF image", _DEPTH, (b"GIF8",)),
    _Kind("a WebP image", _DEPTH, (b"WEBP",), 8),
    _Kind("a PDF", "", (b"%PDF",)),
    _Kind("a document of an office", _SHEET, (b"PK\3\4",), endings=(".xlsx", ".ods")),
    _Kind("a document of an office", "", (b"PK\3\4",), endings=(".docx", ".pptx", ".odt")),
    _Kind("a table of Excel", _SHEET, (b"\xd0\xcf\x11\xe0",), endings=(".xls",)),
    _Kind("an archive of tar", f"tar xf {{path}}, then {_IN_IT}", (b"ustar",), 257),
    _Kind("an archive of 7-Zip", _UNPACK, (b"7z\xbc\xaf\x27\x1c",)),
    _Kind("an archive of RAR", _UNPACK, (b"Rar!",)),
    _Kind("a file packed by xz", "xz -dk {path}", (b"\xfd7zXZ",)),
    _Kind("a file packed by zstd", "zstd -d {path}", (b"\x28\xb5\x2f\xfd",)),
    _Kind("a file packed by lz4", "lz4 -d {path}", (b"\x04\x22\x4d\x18",)),
    _Kind("a PX4 or other ULog", "its poses as a CSV with a header, for --trajectory", (b"ULog",)),
    _Kind("a log of ArduPilot", "its poses as a CSV with a header, for --trajectory", (b"\xa3\x95\x80",)),
    _Kind("a pose graph of slam_toolbox", _OF_KARTO, (b"serialization::archive",), 8),
    _Kind("an HDF5", _NPZ, (b"\x89HDF",)),
    _Kind("an array of NumPy", _NPZ, (b"\x93NUMPY",)),
    _Kind("a table of Parquet", _NPZ, (b"PAR1",)),
    _Kind("a table of Arrow", _NPZ, (b"ARROW1",)),
    _Kind("a file of MATLAB", _NPZ, (b"MATLAB 5.0",)),
    _Kind("records of TensorFlow", _NPZ, endings=(".tfrecord", ".tfrecords")),
    _Kind("a recording of Rerun", _NPZ, (b"RRF", b"RRIO"), endings=(".rrd",)),
    _Kind("a recording of depth images (klg)", _DEPTH, endings=(".klg",)),
    _Kind("a bag of ROS before 1.0", "rosbag fix {path} OUT.bag", (b"#ROSRECORD", b"#ROSBAG V1")),
    _Kind("a recording of Livox Viewer", "a bag by livox_ros_driver, which reads .lvx", (b"livox_tech",)),
    _Kind("a recording of Ouster (OSF)", _TO_CLOUDS, (b"OSF!",), 8),
    _Kind("a recording of Ouster (OSF)", _TO_CLOUDS, endings=(".osf",)),
    _Kind("a state of Cartographer", _OF_STATES, (b"\xdb\x01\xf5\x5b\x7b\x1f\x1d\x7b",)),
    _Kind("a recording of OpenNI", _IMAGES, (b"NI10",)),
    _Kind("a recording of a ZED camera (SVO)", _IMAGES, endings=(".svo", ".svo2")),
    _scan("a scan of FARO", "SCENE", ".fls", ".fws", ".lsproj"),
    _scan("a scan of Zoller + Fröhlich", "LaserControl", ".zfs", ".zfc", ".zfprj"),
    _scan("a scan of RIEGL", "RiSCAN PRO", ".rxp", ".rdb", ".rdbx", ".rsp"),
    _scan("a scan of Leica", "Cyclone or Register 360", ".lgs", ".lgsx", ".imp", ".blk"),
    _scan("a scan of Trimble", "RealWorks", ".tzf", ".tzs", ".rwp"),
    _scan("a scan of Topcon", "MAGNET Collage", ".clr", ".cl3"),
    _scan("a project of Autodesk ReCap", "ReCap", ".rcs", ".rcp"),
    _Kind("a cloud of CloudCompare", _OF_CLOUDS, (b"CCB2",)),
    _Kind("a cloud of CloudCompare", _OF_CLOUDS, (b"CCB",), endings=(".bin",)),
    _Kind("a mesh (glTF)", _POINTS_ON, (b"glTF",)),
    _Kind("a mesh (STL)", _POINTS_ON, endings=(".stl",)),
    _Kind("a mesh (OBJ)", _POINTS_ON, endings=(".obj",)),
    _Kind("a mesh (OFF)", _POINTS_ON, (b"OFF", b"COFF"), endings=(".off",), first=True),
    _Kind("a model (USD)", _POINTS_ON, (b"PXR-USDC", b"#usda")),
    _Kind("a model (FBX)", _POINTS_ON, (b"Kaydara FBX",)),
    _Kind("a drawing (DXF)", _POINTS_ON, endings=(".dxf", ".dwg")),
    _Kind("a file of VTK", _OF_VTK, (b"# vtk DataFile",), first=True),
    _Kind("positions of a satellite receiver (NMEA)", _POSES, (b"$GP", b"$GN", b"$GL")),
    _Kind("a video", _FRAMES, (b"ftyp",), 4),
    _Kind("a video", _FRAMES, (b"AVI ",), 8),
    _Kind("a video", _FRAMES, (b"\x1a\x45\xdf\xa3",)),
    _Kind("sound", "", (b"WAVE",), 8),
    _Kind("sound", "", (b"ID3", b"OggS", b"fLaC")),
    _Kind("a program", "", (b"\x7fELF", b"MZ\x90", b"\xcf\xfa\xed\xfe")),
    _Kind("a grid of heights (ESRI)", "", (b"ncols", b"NCOLS", b"Ncols"), first=True),
    _Kind("a pickle of Python", _NPZ, endings=(".pkl", ".pickle")),
    _Kind("a model of PyTorch", "", endings=(".pt", ".pth")),
)
#: Single files of scans, in a folder of which each is a log of its own.
_LOGS = (".bag", ".mcap", ".db3", ".e57", ".ptx", ".pcap", ".pcapng", ".npz", ".graph", ".log", ".clf")
_MAPS = (".ndt", ".bt", ".ot")
_SHOWN = 60
#: Files of a folder of no known kind that are looked into.
_LOOKED_INTO = 20


def not_a_log(source: Source) -> NotALog | None:
    """What a source is that no format has recognised; None where that is not known either."""
    path = shlex.quote(source.path)
    if source.is_folder:
        return _of_folder(source, path)
    found = _of_table(source, path, _KINDS)
    if found is not None:
        return found
    if source.head.startswith(ZIP_MAGIC):
        return _of_zip(source, path)
    if b"\0" in source.head:
        return packed(source, "") if source.packed else None
    return _of_text(source, path)


def packed(source: Source, what: str) -> NotALog:
    """What is to be unpacked first; `what` is in it, as in "a PLY", if that is known."""
    command = {"gzip": "gunzip", "bzip2": "bunzip2"}[source.packed]
    of = f" ({what})" if what else ""
    way = f"{command} -k {shlex.quote(source.path)}"
    return NotALog(source.path, f"a file packed by {source.packed}{of}", [way])


def _of_table(source: Source, path: str, rows: Iterable[_Kind]) -> NotALog | None:
    for row in rows:
        if row.fits(source):
            return NotALog(source.path, row.kind, [row.help.format(path=path)] if row.help else [])
    return None


def _of_zip(source: Source, path: str) -> NotALog:
    """An archive that is no recording of ours."""
    try:
        with zipfile.ZipFile(source.path) as archive:
            names = archive.namelist()
    except (OSError, zipfile.BadZipFile, NotImplementedError):
        return NotALog(source.path, "a zip archive, cut off or damaged")
    if names and all(name.endswith(".npy") for name in names):
        some = shown(", ".join(name.removesuffix(".npy") for name in names), _SHOWN)
        return NotALog(source.path, f"a zip archive without points.npy, but with {some}", [_NPZ])
    return NotALog(source.path, "a zip archive", [f"unzip {path}, then {_IN_IT}"])


def before_formats(source: Source) -> NotALog | None:
    """What looks like points or beams in text, and is not."""
    if source.is_folder:
        return None
    path = shlex.quote(source.path)
    wrong = wrongly_written(source.head)
    if wrong is not None:
        return NotALog(source.path, wrong[0], [wrong[1].format(path)])
    return _of_table(source, path, (row for row in _KINDS if row.first))


def _of_folder(source: Source, path: str) -> NotALog | None:
    for name, _, what, helps in _MODELS:
        if name in source.names:
            return NotALog(source.path, what, [helps])
    endings = Counter(os.path.splitext(name)[1].lower() for name in source.names)
    found = [(count, ending) for ending, count in endings.items() if ending in _LOGS]
    if found:
        count, ending = max(found)
        first = next(name for name in source.names if name.lower().endswith(ending))
        ways = [f"ndtree map {shlex.quote(os.path.join(source.path, first))}"]
        if count > 1:
            ways = [f"ndtree map {path}/*{ending} --merge -o OUT.ndt (all in one frame)", *ways]
        return NotALog(source.path, f"a folder with {number_of(count, f'{ending} file')}", ways)
    maps = next((name for name in source.names if name.lower().endswith(_MAPS)), None)
    if maps is not None:
        example = shlex.quote(os.path.join(source.path, maps))
        return NotALog(source.path, "a folder with maps", [f"ndtree info {example}"])
    images = sum(endings[ending] for ending in (".png", ".jpg", ".jpeg", ".tif", ".tiff"))
    if images and images >= len(source.names) / 2:
        return NotALog(source.path, f"a folder with {images} images, without poses", [_DEPTH])
    return _by_a_file_in_it(source)


def _by_a_file_in_it(source: Source) -> NotALog | None:
    """What the first of a folder's files is that the table knows and has help for."""
    for name in source.names[:_LOOKED_INTO]:
        path = os.path.join(source.path, name)
        try:
            inside = None if os.path.isdir(path) else source_of(path, "a log")
        except (OSError, ValueError):
            continue
        found = None if inside is None else _of_table(inside, shlex.quote(path), _KINDS)
        if found is not None and found.help:
            return NotALog(source.path, f"a folder with {found.kind}", found.help)
    return None


def _of_text(source: Source, path: str) -> NotALog | None:
    """Text that is no log: poses, or something else by its beginning."""
    head = source.head.decode("utf-8", "replace")
    kind = trajectory_kind(source.path)
    if kind is not None:
        try:
            read_trajectory(source.path)
        except ValueError as error:
            why = str(error).removeprefix(f"{source.path}: ")
            return NotALog(source.path, f"a table like a trajectory ({shown(why, 100)})")
        what = "poses with times" if kind == "tum" else "poses by their number"
        return NotALog(source.path, f"a trajectory, {what}", [f"ndtree map LOG --trajectory {path}"])
    start = head.lstrip()
    for name, word, what, helps in _MODELS:
        if start.startswith(("{", "[")) and (word in head or os.path.basename(source.path) == name):
            return NotALog(source.path, what, [helps])
    if source.path.lower().endswith((".json", ".geojson")):
        return NotALog(source.path, "text in JSON, and none of the kinds that are read")
    if start.startswith("<"):
        name = re.search(r"<(?!\?|!)([\w:.-]+)", start)
        if name and name[1] == "VTKFile":
            return NotALog(source.path, "a file of VTK", [_OF_VTK])
        return NotALog(source.path, f"text in XML{f' ({name[1][:_SHOWN]})' if name else ''}")
    line = next((line for line in source.head.splitlines() if line.strip()), b"")
    if is_of_degrees(line):
        ways = ["metres instead, as of UTM, with a header: easting,northing,height"]
        return NotALog(source.path, "positions in degrees of latitude and longitude", ways)
    if ECHOED in line:
        ways = ["ndtree map BAG, with the bag that it was made from"]
        return NotALog(source.path, "what rostopic echo -p prints", ways)
    return None
