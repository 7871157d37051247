# SPDX-License-Identifier: BSD-3-Clause
"""Files that are no log are named by their kind, with what helps; missing libraries by their extra."""

from __future__ import annotations

import bz2
import gzip
import io
import json
import re
import sqlite3
import struct
import sys
import tarfile
import zipfile
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
import rooms

from ndtree._lazy import install_of
from ndtree.logs import NotALog, read
from ndtree.maps.conversion import convert


def tar(path: Path) -> None:
    with tarfile.open(path, "w:gz") as archive:
        entry = tarfile.TarInfo("a.txt")
        entry.size = 5
        archive.addfile(entry, io.BytesIO(b"hello"))


def save(content: bytes) -> Callable[[Path], None]:
    return lambda path: path.write_bytes(content) and None


def zipped(name: str) -> Callable[[Path], None]:
    def write(path: Path) -> None:
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr(name, "1 2 3")

    return write


def database(*tables: str) -> Callable[[Path], None]:
    def write(path: Path) -> None:
        with closing(sqlite3.connect(path)) as base, base:
            for table in tables:
                base.execute(f"CREATE TABLE {table}(id INTEGER)")

    return write


#: By the name of a file: its content, its kind, and what helps.
FILES: dict[str, tuple[Callable[[Path], None], str, str]] = {
    "a.png": (save(b"\x89PNG\r\n\x1a\n" + bytes(20)), "a PNG image", "ndtree map FOLDER"),
    "a.jpg": (save(b"\xff\xd8\xff\xe0" + bytes(20)), "a JPEG image", "ndtree map FOLDER"),
    "a.pdf": (save(b"%PDF-1.4\n%\xe2\xe3\n\0"), "a PDF", ""),
    "a.bmp": (save(b"BM" + bytes(20)), "a BMP image", "ndtree map FOLDER"),
    "a.webp": (save(b"RIFF\0\0\0\0WEBPVP8 "), "a WebP image", "ndtree map FOLDER"),
    "a.mp4": (save(b"\0\0\0\x18ftypmp42\0"), "a video", "COLMAP"),
    "a.mkv": (save(b"\x1a\x45\xdf\xa3" + bytes(20)), "a video", "COLMAP"),
    "a.wav": (save(b"RIFF\0\0\0\0WAVEfmt "), "sound", ""),
    "a.lz4": (save(b"\x04\x22\x4d\x18" + bytes(20)), "a file packed by lz4", "lz4 -d "),
    "a.zip": (zipped("scan.xyz"), "a zip archive", "unzip "),
    "a.xlsx": (zipped("xl/workbook.xml"), "a document of an office", "CSV"),
    "other.npz": (zipped("a.npy"), "a zip archive without points.npy, but with a", "numpy.savez"),
    "a.ply.gz": (save(gzip.compress(b"ply\nformat ascii 1.0\n")), "a file packed by gzip", "gunzip -k "),
    "a.bag.gz": (save(gzip.compress(b"#ROSBAG V2.0\n\0")), r"a file packed by gzip \(a ROS bag", "gunzip "),
    "a.gz": (save(gzip.compress(bytes(20))), "a file packed by gzip", "gunzip -k "),
    "a.bz2": (save(bz2.compress(bytes(20))), "a file packed by bzip2", "bunzip2 -k "),
    "a.vtk": (save(b"# vtk DataFile Version 3.0\na\nASCII\n1 2 3\n4 5 6\n"), "a file of VTK", "PLY"),
    "a.vtp": (save(b"<?xml version='1.0'?>\n<VTKFile/>\n"), "a file of VTK", "PLY"),
    "a.off": (save(b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"), r"a mesh \(OFF\)", "PLY"),
    "a.feather": (save(b"ARROW1\0\0" + bytes(20)), "a table of Arrow", "numpy.savez"),
    "mac.csv": (save(b"x,y,z\r1,2,3\r4,5,6\r"), "text whose lines end as on old Macs", "tr "),
    "utf16.csv": (save("x,y,z\n1,2,3\n".encode("utf-16-be")), "text in UTF-16", "iconv -f UTF-16BE "),
    "gps.csv": (save(b"lat,lon,alt\n48.1,11.5,520\n"), "positions in degrees", "easting,northing,height"),
    "gps.txt": (save(b"$GPGGA,123519,4807.038,N,01131.000,E,1,08\n"), "positions of a satellite", "t x y z"),
    "echo.csv": (save(b"%time,field.header.seq,field.x\n1,2,3\n"), "what rostopic echo -p", "ndtree map BAG"),
    "links.txt": (save(b"1 2 0.1 0.2 0 0 0 0.1\n" * 3), r"a table like a trajectory \(quaternion", ""),
    "some.db": (database("notes"), "a database of SQLite without a bag in it, but with notes", ""),
    "rtabmap.db": (database("Node", "Link", "Data"), "a database of RTAB-Map", "exporting"),
    "a.tar.gz": (tar, "an archive of tar", "tar xf "),
    "a.xz": (save(b"\xfd7zXZ\0" + bytes(20)), "a file packed by xz", "xz -dk "),
    "a.h5": (save(b"\x89HDF\r\n\x1a\n" + bytes(20)), "an HDF5", "npz"),
    "a.npy": (lambda path: np.save(path, np.zeros((3, 3))), "an array of NumPy", "npz"),
    "a.npz": (save(b"version https://git-lfs.github.com/spec/v1\n"), "a pointer of Git LFS", "git lfs pull"),
    "a.ulg": (save(b"ULog\x01\x12\x35" + bytes(20)), "a PX4 or other ULog", "--trajectory"),
    "00000012.BIN": (save(b"\xa3\x95\x80\x80\x59FMT" + bytes(20)), "a log of ArduPilot", "--trajectory"),
    "a.posegraph": (save(struct.pack("<Q", 22) + b"serialization::archive"), "a pose graph of", "map_saver"),
    "a.data": (save(struct.pack("<Q", 22) + b"serialization::archive"), "a pose graph of", "the bag"),
    "transforms.json": (save(b'{"frames": [{"transform_matrix": 1}]}'), "cameras of Nerfstudio", "COLMAP"),
    "b.json": (save(b'[{"shots": {}, "points": {}}]'), "a reconstruction of OpenSfM", "export_colmap"),
    "a.osf": (save(struct.pack("<II", 20, 0) + b"OSF!" + bytes(20)), "a recording of Ouster", "ouster-cli"),
    "a.lvx": (save(b"livox_tech" + bytes(20)), "a recording of Livox Viewer", "livox_ros_driver"),
    "a.fls": (save(b"\xd0\xcf\x11\xe0" + bytes(20)), "a scan of FARO", "E57 or PTX from SCENE"),
    "a.zfs": (save(bytes(20)), "a scan of Zoller", "E57 or PTX"),
    "a.rcp": (save(b"<?xml version='1.0'?><a/>"), "a project of Autodesk ReCap", "E57"),
    "a.glb": (save(b"glTF" + bytes(20)), r"a mesh \(glTF\)", "PLY"),
    "a.stl": (save(bytes(84)), r"a mesh \(STL\)", "PLY"),
    "a.txt": (save("\ufeff1 2 3\n".encode("utf-16-le")), "text in UTF-16", "iconv -f UTF-16 -t UTF-8 "),
    "a.pbstream": (save(b"\xdb\x01\xf5\x5b\x7b\x1f\x1d\x7b"), "a state of Cartographer", "--traj"),
    "a.json": (save(b'{"scans": [1, 2]}'), "text in JSON", ""),
    "a.xml": (save(b"<?xml version='1.0'?>\n<robot name='a'/>"), r"text in XML \(robot\)", ""),
    "a": (save(b"\x7fELF" + bytes(20)), "a program", ""),
    "graph.g2o": (save(b"VERTEX_SE2 0 0 0 0\nEDGE_SE2 0 1 1 0 0\n"), "a trajectory", "--trajectory "),
}  # fmt: skip


@pytest.mark.parametrize("name", FILES)
def test_files_are_named_by_their_kind_with_what_helps(name: str, tmp_path: Path) -> None:
    write, kind, help = FILES[name]
    write(tmp_path / name)
    with pytest.raises(NotALog, match=rf"(?s)^{tmp_path / name}: {kind}.*{help}") as caught:
        read(tmp_path / name)
    kind_of_it, *ways = str(caught.value).replace(str(tmp_path), "").splitlines()
    assert bool(ways) == bool(help) and kind_of_it.endswith("; try") == bool(ways)
    assert all(way.startswith("  ") for way in ways) and max(map(len, (kind_of_it, *ways))) < 130


def test_packed_files_are_named_by_what_is_in_them(tmp_path: Path) -> None:
    (tmp_path / "a.png.gz").write_bytes(gzip.compress(b"\x89PNG\r\n\x1a\n" + bytes(20)))
    with pytest.raises(NotALog, match="a PNG image"):
        read(tmp_path / "a.png.gz")


def test_folders_are_named_by_what_is_in_them(tmp_path: Path) -> None:
    for name in ("a.ptx", "b.ptx"):
        (tmp_path / name).write_text("1\n")
    with pytest.raises(NotALog, match=r"a folder with 2 \.ptx files; try\n  ndtree map .*/\*\.ptx --merge"):
        read(tmp_path)
    pictures = tmp_path / "pictures"
    pictures.mkdir()
    for name in ("1.png", "2.png"):
        (pictures / name).write_bytes(b"\x89PNG\r\n\x1a\n")
    with pytest.raises(NotALog, match=r"a folder with 2 images, without poses; try\n  ndtree map FOLDER"):
        read(pictures)
    (tmp_path / "maps").mkdir()
    (tmp_path / "maps" / "hall.bt").write_bytes(b"# Octomap OcTree binary file\n")
    with pytest.raises(NotALog, match=r"a folder with maps; try\n  ndtree info .*/maps/hall\.bt$"):
        read(tmp_path / "maps")
    (tmp_path / "karto").mkdir()
    for name in ("hall.data", "hall.posegraph", "notes.txt"):
        (tmp_path / "karto" / name).write_bytes(struct.pack("<Q", 22) + b"serialization::archive")
    with pytest.raises(NotALog, match=r"a folder with a pose graph of slam_toolbox; try\n  its map as"):
        read(tmp_path / "karto")
    with pytest.raises(ValueError, match=r"karto: a folder with a pose graph .* expected a map of ndtree's"):
        convert(tmp_path / "karto", tmp_path / "a.ndt")


def ndtree(*arguments: str | Path) -> tuple[int, list[str], list[str]]:
    from calling import cli

    done = cli(*arguments)
    return done.exit_code, done.stdout.splitlines(), done.stderr.splitlines()


def test_info_says_what_a_file_is_and_what_to_type(tmp_path: Path) -> None:
    pytest.importorskip("typer", reason="no typer: no command line")
    rooms.as_text(tmp_path / "hall.xyz", rooms.scanned(1, 100)[0].in_map)
    status, said, wrong = ndtree("info", tmp_path / "hall.xyz")
    assert (status, wrong) == (0, [])
    assert said[0] == f"{tmp_path}/hall.xyz: points in text without a pose"
    assert said[1].startswith("  100 points from (-3.03, -2.54, -1.23) to ")
    assert said[2] == f"  try ndtree map {tmp_path}/hall.xyz --points-only (occupied cells alone)"
    assert "  try --origin-of-scan X,Y,Z (all measured from one place)" in said
    status, said, _ = ndtree("info", tmp_path / "hall.xyz", "--json", "-")
    figures = json.loads("\n".join(said))
    assert status == 0 and figures["points"] == 100 and figures["kind"] == "points in text without a pose"
    status, said, wrong = ndtree("map", tmp_path / "hall.xyz", "-o", tmp_path / "a.ndt")
    assert (status, said) == (1, [])
    assert wrong[0].startswith("ndtree: ") and all(line.startswith("  ") for line in wrong[1:])
    assert any("--points-only" in line for line in wrong)


def test_points_only_are_mapped_by_the_command_line(tmp_path: Path) -> None:
    pytest.importorskip("typer", reason="no typer: no command line")
    import ndtree as package

    points = rooms.scanned(1, 100)[0].in_map
    rooms.as_text(tmp_path / "hall.xyz", points)
    status, _, wrong = ndtree("map", tmp_path / "hall.xyz", "--points-only", "-o", tmp_path / "a.ndt")
    assert (status, wrong) == (0, [])
    made = package.load(tmp_path / "a.ndt")
    assert (made.state(points.round(6)) == 1).all() and not (made.leaves().state == 0).any()
    status, said, _ = ndtree(
        "map", tmp_path / "hall.xyz", "--points-only", "--range-sigma", "0.06", "-o", tmp_path / "b.ndt"
    )
    assert status == 0 and any("cells of 0.12 m" in line for line in said), "twice the noise"
    refused = {
        ("-o", tmp_path / "a.tiles"): "maps in tiles need some",
        ("--max-cell-size", "0.4"): "--max-cell-size 0.4 m",
        ("--origin-of-scan", "0,0,0"): "expected one of them",
    }
    for arguments, expected in refused.items():
        status, _, wrong = ndtree("map", tmp_path / "hall.xyz", "--points-only", *arguments)
        message = " ".join(line.strip() for line in wrong)
        assert status in (1, 2) and message.count("ndtree: ") == 1 and expected in message, wrong


LIBRARIES = {
    "pye57": (lambda folder: save(b"ASTM-E57" + bytes(60))(folder / "a") or folder / "a", "e57", {}),
    "velodyne_decoder": (
        lambda folder: rooms.pcap(
            folder / "a",
            [(rooms.START, rooms.udp(rooms.velodyne_packets(lambda stamp: np.eye(4), 1)[0][1], 2368))],
        ),
        "velodyne",
        {"still": True},
    ),
}


@pytest.mark.parametrize("library", LIBRARIES)
def test_a_library_that_is_not_there_is_named_with_its_extra(
    library: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write, extra, options = LIBRARIES[library]
    path = write(tmp_path)
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(ImportError, match=re.escape(install_of(extra))) as caught:
        list(read(path, **options))
    assert str(path) in str(caught.value) and str(caught.value).splitlines()[1].startswith("  pip install ")
