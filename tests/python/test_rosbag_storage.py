# SPDX-License-Identifier: BSD-3-Clause
"""Files of ROS 2 as its versions leave them: metadata, databases, chunks and what is broken in them."""

from __future__ import annotations

import shutil
import sqlite3
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rosbags")
pytest.importorskip("scipy")

from bags import LEVEL, START, Messages, same, write_bag

from ndtree.logs import read

MAKE = Messages("sqlite3")
SCANS = 20


def content() -> list[tuple[str, float, Any]]:
    """A laser on its way, a transform and a scan at a time."""
    found: list[tuple[str, float, Any]] = []
    for i in range(SCANS):
        t = START + 0.05 * i
        moved = MAKE.transform(t, "odom", "laser", [0.05 * i, 0, 0], LEVEL)
        found.append(("/tf", t, MAKE.tf(moved)))
        found.append(("/scan", t, MAKE.laser(t, "laser", [1 + 0.1 * i, 2.0])))
    return found


@pytest.fixture(scope="module")
def database(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = write_bag(tmp_path_factory.mktemp("bag") / "whole", MAKE, content())
    return folder / "whole.db3"


def metadata(version: int, files: list[str], packed: bool = False) -> str:
    """As the versions of rosbag2 write it: what one of them added, the later ones have."""
    qos = (
        '"- history: 3\\n  depth: 10"'
        if version < 9
        else "\n        - history: keep_last\n          depth: 10"
    )
    topics = "".join(
        f"    - topic_metadata:\n        name: {name}\n        type: {type}\n"
        "        serialization_format: cdr\n"
        + (f"        offered_qos_profiles: {qos}\n" if version >= 4 else "")
        + ("        type_description_hash: RIHS01_0\n" if version >= 7 else "")
        + f"      message_count: {SCANS}\n"
        for name, type in (("/tf", "tf2_msgs/msg/TFMessage"), ("/scan", "sensor_msgs/msg/LaserScan"))
    )
    folder = "walk/" if version == 1 else ""  # Of the first version the paths begin with the folder.
    paths = "".join(f"    - {folder}{one}\n" for one in files)
    text = (
        f"rosbag2_bagfile_information:\n  version: {version}\n  storage_identifier: sqlite3\n"
        f"  relative_file_paths:\n{paths}  duration:\n    nanoseconds: 950000000\n"
        "  starting_time:\n    nanoseconds_since_epoch: 1700000000000000000\n"
        f"  message_count: {2 * SCANS}\n  topics_with_message_count:\n{topics}"
    )
    if version >= 3:
        text += f"  compression_format: {'zstd' if packed else repr('')}\n"
        text += f"  compression_mode: {'FILE' if packed else repr('')}\n"
    if version >= 5:
        text += "  files:\n" + "".join(f"    - path: {one}\n      message_count: 7\n" for one in files)
    if version >= 6:
        text += "  custom_data: ~\n"
    return text + ("  ros_distro: jazzy\n" if version >= 8 else "")


@pytest.mark.parametrize("version", range(1, 10))
def test_metadata_of_every_version(version: int, database: Path, tmp_path: Path) -> None:
    shutil.copy(database, tmp_path / "walk_0.db3")
    shutil.copy(database, tmp_path / "an_old_copy.db3")  # Which the metadata does not name.
    (tmp_path / "metadata.yaml").write_text(metadata(version, ["walk_0.db3"]))
    whole = list(read(database))
    assert len(whole) == SCANS
    assert same(list(read(tmp_path)), whole)
    assert same(list(read(tmp_path / "metadata.yaml")), whole)


def test_split_databases_that_are_packed(database: Path, tmp_path: Path) -> None:
    zstandard = pytest.importorskip("zstandard")
    names = [f"walk_{i}.db3.zstd" for i in range(9, 12)]
    third = 2 * SCANS // 3
    for i, name in enumerate(names):
        part = content()[i * third : (i + 1) * third if i < 2 else None]
        folder = write_bag(tmp_path / f"part{i}", MAKE, part)
        (tmp_path / name).write_bytes(zstandard.compress((folder / f"part{i}.db3").read_bytes()))
        shutil.rmtree(folder)
    (tmp_path / "metadata.yaml").write_text(metadata(5, names, packed=True))
    assert same(list(read(tmp_path)), list(read(database)))
    packed = (tmp_path / names[1]).read_bytes()
    for left, said in ((packed[:9], "cannot be unpacked"), (b"", "is empty, expected a ROS bag")):
        (tmp_path / names[1]).write_bytes(left)
        with pytest.raises(ValueError, match=f"^{tmp_path / names[1]}: {said}"):
            read(tmp_path, format="rosbag")
    (tmp_path / names[1]).unlink()
    with pytest.raises(ValueError, match="walk_10\\.db3\\.zstd is not there, expected it, as metadata"):
        read(tmp_path)


def test_a_database_that_was_never_closed_is_completed(database: Path, tmp_path: Path) -> None:
    """What SQLite wrote last is in a file beside it; neither is touched."""
    path = tmp_path / "run_0.db3"
    open_ = sqlite3.connect(path)
    open_.execute("PRAGMA journal_mode = WAL")
    open_.execute("PRAGMA wal_autocheckpoint = 0")
    with sqlite3.connect(database) as closed:
        for statement in closed.iterdump():
            if statement not in ("BEGIN TRANSACTION;", "COMMIT;"):
                open_.execute(statement)
    open_.commit()
    crashed = tmp_path / "crashed"
    crashed.mkdir()
    for name in ("run_0.db3", "run_0.db3-wal"):
        shutil.copy(tmp_path / name, crashed / name)
    open_.close()
    before = {one.name: one.read_bytes() for one in crashed.iterdir()}
    for given in (crashed, crashed / "run_0.db3"):
        log = read(given)
        assert same(list(log), list(read(database))) and log.notes == []
    assert {one.name: one.read_bytes() for one in crashed.iterdir()} == before
    (crashed / "run_0.db3-wal").unlink()
    with pytest.raises(ValueError, match=f"^{crashed / 'run_0.db3'}: cannot be read as a ROS bag"):
        read(crashed)


@pytest.mark.parametrize("chunked", [True, False])
@pytest.mark.parametrize("packing", ["NONE", "LZ4", "ZSTD"])
def test_mcap_with_chunks_of_every_kind(packing: str, chunked: bool, database: Path, tmp_path: Path) -> None:
    mcap = pytest.importorskip("mcap.writer")
    path = tmp_path / "a.mcap"
    with open(path, "wb") as file:
        kind = mcap.CompressionType[packing]
        writer = mcap.Writer(file, compression=kind, use_chunking=chunked, chunk_size=1000)
        writer.start("ros2")
        channels: dict[str, int] = {}
        for topic, stamp, message in content():
            type = message.__msgtype__
            if topic not in channels:
                text, _ = MAKE.store.generate_msgdef(type, ros_version=2)
                schema = writer.register_schema(type, "ros2msg", text.encode())
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            data = bytes(MAKE.store.serialize_cdr(message, type))
            writer.add_message(channels[topic], round(stamp * 1e9), data, round(stamp * 1e9))
        writer.finish()
    whole = list(read(database))
    assert same(list(read(path)), whole)
    data = bytearray(path.read_bytes())
    at = len(data) // 3
    data[at : at + 30] = b"\xaa" * 30
    path.write_bytes(bytes(data))
    try:  # By chance the bytes may be unused ones.
        found = list(read(path))
    except ValueError as error:
        assert str(error).startswith(f"{path}: ") and "\n" not in str(error)
        found = list(read(path, keep_going=True))
    assert 2 < len(found) <= SCANS


def test_a_transform_that_is_damaged_is_named_or_passed_over(tmp_path: Path) -> None:
    found = content()
    found.insert(20, ("/tf", START + 0.5, ("tf2_msgs/msg/TFMessage", b"\0\1\0\0rubbish")))
    path = write_bag(tmp_path / "bag", MAKE, found)
    with pytest.raises(ValueError, match=f"^{path}: /tf: no whole tf2_msgs/msg/TFMessage"):
        list(read(path))
    log = read(path, keep_going=True)
    assert len(list(log)) == SCANS and log.skipped["damaged messages"].count == 1
    only = write_bag(
        tmp_path / "only", MAKE, [one for one in found if one[0] == "/scan" or isinstance(one[2], tuple)]
    )
    with pytest.raises(
        ValueError, match=r"(?s)there is no /tf.*not all of the bag could be read: .*no whole"
    ):
        read(only)


@pytest.mark.parametrize("kind", ["ros1", "mcap", "sqlite3"])
@pytest.mark.parametrize(
    "rubbish", [b"float32 \xff\xfe\x00le_min", b"float33 angle_min", b"\n[}=(float32 a[n]"]
)
def test_a_broken_definition_is_replaced_by_ros_s_own(kind: str, rubbish: bytes, tmp_path: Path) -> None:
    make = Messages(kind)
    written = write_bag(
        tmp_path / "bag",
        make,
        [("/scan", START + i, make.laser(START + i, "laser", [1.0, 2.0])) for i in range(3)],
    )
    path = written if written.is_file() else next(one for one in written.iterdir() if one.suffix != ".yaml")
    whole = list(read(path, still=True))
    data, known = path.read_bytes(), b"float32 angle_min"
    assert len(whole) == 3 and known in data and len(rubbish) == len(known)
    path.write_bytes(data.replace(known, rubbish))
    assert same(list(read(path, still=True)), whole)


def test_a_database_that_must_be_copied_to_a_full_disk_is_an_error_in_one_line(
    database: Path, tmp_path: Path
) -> None:
    """One that was never closed, or is packed: SQLite wants it as a file of its own."""
    pytest.importorskip("resource")
    zstandard = pytest.importorskip("zstandard")
    open_one, packed = tmp_path / "open.db3", tmp_path / "packed.db3.zstd"
    shutil.copyfile(database, open_one)
    (tmp_path / "open.db3-wal").write_bytes(b"\0" * 100)
    packed.write_bytes(zstandard.ZstdCompressor().compress(database.read_bytes()))
    assert same(list(read(packed)), list(read(database)))
    for path in (open_one, packed):
        script = (
            "import resource, signal, ndtree\n"
            "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
            "resource.setrlimit(resource.RLIMIT_FSIZE, (4096, resource.RLIM_INFINITY))\n"
            f"try: list(ndtree.read({str(path)!r}))\n"
            "except OSError as error: print(type(error).__name__, error)\n"
        )
        done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
        assert done.stdout.startswith("OSError") and done.stdout.count("\n") == 1, done.stdout
        assert path.name.split(".")[0] in done.stdout
