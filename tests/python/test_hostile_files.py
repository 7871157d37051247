# SPDX-License-Identifier: BSD-3-Clause
"""Files that somebody made to hurt: what they would cost, and that one line says what is wrong."""

from __future__ import annotations

import bz2
import gzip
import json
import os
import resource
import struct
import subprocess
import sys
import time
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("typer")

from outcomes import info_of, outcome_of

import ndtree
from ndtree.cli.commands import every
from ndtree.logs.core.failures import readable, shown
from ndtree.logs.core.plain_file import open_regular
from ndtree.maps.open import open_map

every()  # Commands are loaded once, and not in each fork.


def refused(path: Path, tmp_path: Path, *more: str, seconds: int = 10) -> str:
    """The one line that the command line ends with, in little memory and time."""
    outcome, said = outcome_of(info_of(path, *more), tmp_path, seconds=seconds)
    assert outcome == "refused", (outcome, said[-2000:])
    return said


def peak_memory(run: Callable[[], object]) -> int:
    """By how much the process grows [bytes], in a fork of its own."""
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        try:
            run()
        except (ValueError, MemoryError):
            pass
        finally:
            grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
            os.write(write, struct.pack("<q", 1024 * grown))
            os._exit(0)
    os.waitpid(child, 0)
    os.close(write)
    return int(struct.unpack("<q", os.read(read, 8))[0])


# --- Packed ----------------------------------------------------------------------------------------


def test_a_line_without_end_is_not_held(tmp_path: Path) -> None:
    path = tmp_path / "bomb.log.bz2"
    begin = bz2.compress(b"FLASER 3 1 2 3 0 0 0 0 0 0 1 h 1\nFLASER ")
    path.write_bytes(begin + 60 * bz2.compress(b"1" * (1 << 20)))  # One behind the other are one file.
    assert path.stat().st_size < 4000
    assert "bomb.log.bz2: line 2: longer than 16 MiB" in refused(path, tmp_path)
    assert peak_memory(lambda: list(ndtree.read(path))) < 60 << 20


def test_what_unpacks_to_far_more_than_a_log_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "bomb.txt"
    once = bz2.compress(b"0 0 1 1\n" + (b"#" * 20_000 + b"\n") * 500)
    path.write_bytes(once * 20)
    assert "expected at most 1000 for one" in refused(path, tmp_path, seconds=30)
    assert peak_memory(lambda: list(ndtree.read(path))) < 100 << 20


def test_a_log_that_packs_well_is_read(tmp_path: Path) -> None:
    path = tmp_path / "still.txt.gz"
    path.write_bytes(gzip.compress(b"0 0 1 1\n" * 40_000))
    assert sum(len(scan) for scan in ndtree.read(path)) == 40_000


def test_a_long_line_in_a_plain_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "long.txt"
    path.write_bytes(b"0 0 1 1\n" + b"1 " * (1 << 23) + b"1\n")
    assert "line 2: longer than 16 MiB" in refused(path, tmp_path)


# --- What is no file -------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["a.txt", "a.ndt", "a.yaml", "a.bag", "a.pcd"])
def test_a_fifo_is_refused_and_does_not_wait(name: str, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / name)
    assert "is not a regular file, expected one" in refused(tmp_path / name, tmp_path)


def test_devices_are_refused() -> None:
    for call in (ndtree.read, ndtree.load, ndtree.load_octomap, open_map, open_regular):
        with pytest.raises(OSError, match="is not a regular file") as caught:
            call("/dev/zero")
        assert caught.value.filename == "/dev/zero"


def test_a_fifo_in_a_folder_of_scans_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a" / "velodyne").mkdir(parents=True)
    os.mkfifo(tmp_path / "a" / "velodyne" / "000000.bin")
    (tmp_path / "a" / "poses.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n")
    (tmp_path / "a" / "calib.txt").write_text("Tr: 1 0 0 0 0 1 0 0 0 0 1 0\n")
    assert "000000.bin: is not a regular file" in refused(tmp_path / "a", tmp_path)


# --- Images of map_server --------------------------------------------------------------------------

WHOLE = {
    "image": "a.pgm", "resolution": "0.05", "origin": "[0, 0, 0]", "negate": "0", "occupied_thresh": "0.65",
    "free_thresh": "0.196",
}  # fmt: skip
BOMB = "\n".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9 if i else ['x'] * 9)}]" for i in range(12))
HOSTILE = {
    "alias as resolution": {"head": BOMB, "resolution": "*a11"},
    "alias as origin": {"head": BOMB, "origin": "*a11"},
    "alias as mode": {"head": BOMB, "mode": "*a11"},
    "alias as image": {"head": BOMB, "image": "*a11"},
    "list as image": {"image": "[a.pgm]"},
    "map as mode": {"mode": "{a: b}"},
    "deep": {"origin": "[" * 5000 + "]" * 5000},
    "long number": {"resolution": "9" * 400},
    "longest number": {"resolution": "9" * 5000},
    "long list": {"origin": "[" + "1, " * 15000 + "1]"},
    "wrong bool": {"negate": "!!bool maybe"},
    "wrong time": {"origin": "!!timestamp never"},
    "wrong date": {"resolution": "2001-99-99"},
    "wrong binary": {"image": "!!binary '*'"},
    "python": {"image": "!!python/object/apply:os.system ['touch hurt']"},
    "unhashable": {"head": "? [a, b]\n: c"},
    "zero in the name": {"image": '"a\\0b.pgm"'},
    "not there": {"image": "other.pgm"},
    "a folder": {"image": "."},
    "itself": {"image": "a.yaml"},
    "huge": {"image": "huge.png"},
    "postscript": {"image": "a.eps"},
    "large file": {"head": "# " + "x" * 70000},
    "infinite": {"origin": "[.inf, 0, 0]"},
    "tiny": {"resolution": "1e-300"},
    "far": {"origin": "[1e300, 0, 0]"},
}


@pytest.fixture()
def image(tmp_path: Path) -> Callable[..., Path]:
    pytest.importorskip("PIL")
    pytest.importorskip("yaml")

    def write(head: str = "", **changes: str) -> Path:
        entries = {**WHOLE, **changes}
        path = tmp_path / "a.yaml"
        path.write_text(f"{head}\n" + "".join(f"{key}: {value}\n" for key, value in entries.items()))
        (tmp_path / "a.pgm").write_bytes(b"P5\n4 3\n255\n" + bytes([0, 254, 205, 254] * 3))
        (tmp_path / "a.eps").write_text("%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\nshowpage\n")
        return path

    return write


@pytest.mark.parametrize("case", HOSTILE)
def test_hostile_yaml_is_refused(case: str, image: Callable[..., Path], tmp_path: Path) -> None:
    import zlib

    def chunk(name: bytes, content: bytes) -> bytes:
        packed = name + content
        return struct.pack(">I", len(content)) + packed + struct.pack(">I", zlib.crc32(packed))

    path = image(**HOSTILE[case])
    size = struct.pack(">IIBBBBB", 60000, 60000, 8, 0, 0, 0, 0)
    (tmp_path / "huge.png").write_bytes(
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", size) + chunk(b"IDAT", zlib.compress(b"")) + chunk(b"IEND", b"")
    )
    said = refused(path, tmp_path)
    assert len(said.replace(str(tmp_path), "")) < 400
    assert not Path("hurt").exists()


def test_an_image_that_is_a_fifo_does_not_wait(image: Callable[..., Path], tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.pgm")
    assert "pipe.pgm: is not a regular file" in refused(image(image="pipe.pgm"), tmp_path)
    with pytest.raises(OSError, match="/dev/zero"):
        open_map(image(image="/dev/zero"))


def test_a_pixel_costs_a_few_bytes(image: Callable[..., Path], tmp_path: Path) -> None:
    """A large image, all of it unknown, so that the map's own memory does not count."""
    from ndtree.maps.images import map_image

    path = image(image="large.pgm")
    side = 4000
    (tmp_path / "large.pgm").write_bytes(b"P5\n4000 4000\n255\n" + bytes([205]) * side**2)
    map_image(str(path))  # Once, for what is imported.
    assert peak_memory(lambda: map_image(str(path))) < 8 * side**2


# --- Bags -----------------------------------------------------------------------------------------


def test_a_false_length_in_an_mcap_takes_no_memory(tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    path = tmp_path / "a.mcap"
    magic = b"\x89MCAP0\r\n"
    header = struct.pack("<BQI", 1, 12, 4) + b"ros2" + struct.pack("<I", 0)
    for length in (2**30, 2**40, 2**63 + 1):
        lying = struct.pack("<BQ", 3, length) + b"schema"
        footer = struct.pack("<BQQQI", 2, 20, 0, 0, 0)
        path.write_bytes(magic + header + lying + footer + magic)
        assert "cannot be read as a ROS bag" in refused(path, tmp_path)
        assert peak_memory(lambda: ndtree.read(path)) < 60 << 20


def test_a_bag_of_a_fifo_does_not_wait(tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    folder = tmp_path / "bag"
    folder.mkdir()
    os.mkfifo(folder / "a.mcap")
    (folder / "metadata.yaml").write_text(
        "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: mcap\n"
        "  relative_file_paths: [a.mcap]\n  duration: {nanoseconds: 1}\n"
        "  starting_time: {nanoseconds_since_epoch: 1}\n  message_count: 0\n"
        "  topics_with_message_count: []\n"
    )
    assert "is not a regular file" in refused(folder, tmp_path)


# --- LAZ ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("sample", ["laz", "laz, layered"])
@pytest.mark.parametrize("what", ["chunks", "points a chunk", "no points a chunk", "layer", "table"])
def test_a_laz_that_lies_does_not_end_the_process(sample: str, what: str, tmp_path: Path) -> None:
    for library in ("laspy", "lazrs", "pypcd4", "meshio", "trimesh", "rosbags", "scipy"):
        pytest.importorskip(library)
    from samples import SAMPLES

    folder = tmp_path / "clouds"
    folder.mkdir()
    SAMPLES[sample].make(folder)
    path = sorted(folder.glob("*.laz"))[0]
    content = bytearray(path.read_bytes())
    (first,) = struct.unpack_from("<I", content, 96)
    (table,) = struct.unpack_from("<q", content, first)
    record = content.index(b"laszip encoded") + 52
    head = 30 if sample == "laz, layered" else 34
    at, value = {
        "chunks": (table + 4, 2**31),
        "points a chunk": (record + 12, 2**31),
        "no points a chunk": (record + 12, 0),
        "layer": (first + 8 + head + 4, 2**32 - 1),
        "table": (first, 2**31),
    }[what]
    struct.pack_into("<I", content, at, value)
    path.write_bytes(content)
    # In a fresh process: a fork of one whose LAZ library has threads would wait for them for ever.
    command = [sys.executable, Path(__file__).with_name("outcomes.py"), "--one", tmp_path, *info_of(folder)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    outcome, said = json.loads(done.stdout)
    assert outcome in ("read", "refused"), (outcome, said)
    if what in ("chunks", "no points a chunk", "table") or (what == "layer" and head == 30):
        assert outcome == "refused" and f"{path}: cannot be read as LAZ: " in said


# --- Others ----------------------------------------------------------------------------------------


def test_an_archive_of_a_version_to_come_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    np.savez(path, origins=np.zeros((1, 2)), points=np.ones((3, 2)), offsets=np.array([0, 3]))
    content = path.read_bytes().replace(b"PK\x01\x02\x2d\x03\x2d\x00", b"PK\x01\x02\x2d\x03\xff\x00")
    content = content.replace(b"PK\x01\x02\x14\x03\x14\x00", b"PK\x01\x02\x14\x03\xff\x00")
    path.write_bytes(content)
    with pytest.raises(NotImplementedError), zipfile.ZipFile(path) as archive:
        archive.read("points.npy")
    assert str(path) in refused(path, tmp_path)


def test_a_camera_with_an_id_alone_is_refused(tmp_path: Path) -> None:
    folder = tmp_path / "model"
    folder.mkdir()
    (folder / "cameras.txt").write_text("1\n")
    (folder / "images.txt").write_text("1 1 0 0 0 0 0 0 1 a.jpg\n1 1 1\n")
    (folder / "points3D.txt").write_text("1 0 0 5 0 0 0 0 1 0\n")
    assert "cameras.txt: line 1: expected CAMERA_ID MODEL" in refused(folder, tmp_path)


def test_an_octomap_header_in_no_encoding_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.ot"
    path.write_bytes(b"# Octomap OcTree file\nid \xff\xfeTree\nsize 0\nres 0.1\ndata\n")
    with pytest.raises(ValueError, match=r"a\.ot: line 2: found 'id \\xff\\xfeTree'"):
        ndtree.load_octomap(path)
    refused(path, tmp_path)


def test_numbers_are_said_in_few_digits() -> None:
    with pytest.raises(ValueError, match=r"min_cell_size = 1e\+300"):
        ndtree.AdaptiveMap(dim=2, min_cell_size=1e300, max_cell_size=1e-300)
    with pytest.raises(ValueError, match="max_range = -1e") as caught:
        ndtree.AdaptiveMap(dim=2).cast_rays(np.zeros(2), np.ones((1, 2)), max_range=-1e300)
    assert len(str(caught.value)) < 100
    assert shown("7" * 300) == "77777777...(300 digits)"


def test_anything_becomes_a_line_that_names_the_file(tmp_path: Path) -> None:
    path = str(tmp_path / "a.bag")
    for error in (
        KeyError("x"),
        RecursionError("deep"),
        AttributeError("no"),
        OverflowError("far"),
        struct.error("short"),
        UnicodeDecodeError("utf-8", b"\xff", 0, 1, "bad"),
        OSError("no number"),
        ValueError("says no file"),
        AssertionError(),
    ):
        with pytest.raises(ValueError) as caught, readable(path, "cannot be read as a ROS bag"):
            raise error
        assert str(caught.value).startswith(f"{path}: ") and "\n" not in str(caught.value)
        assert caught.value.__cause__ is error
    with pytest.raises(MemoryError, match=r"a\.bag: not enough memory"), readable(path):
        raise MemoryError
    for error in (
        FileNotFoundError(2, "gone", "b.txt"),
        ImportError("rosbags"),
        ValueError(f"{path}: line 1"),
    ):
        with pytest.raises(type(error)) as caught, readable(path):
            raise error
        assert caught.value is error
    with pytest.raises(KeyboardInterrupt), readable(path):
        raise KeyboardInterrupt


def test_a_stopped_reading_says_nothing_of_its_own(tmp_path: Path) -> None:
    """What a caller raises between two scans is the caller's."""
    path = tmp_path / "a.txt"
    path.write_text("0 0 1 1\n1 0 1 1\n2 0 1 1\n")
    with pytest.raises(KeyError):
        for _ in ndtree.read(path):
            raise KeyError("mine")
    scans = iter(ndtree.read(path))
    next(scans)
    scans.close()
    begin = time.monotonic()
    assert len(list(ndtree.read(path))) == 3 and time.monotonic() - begin < 5
