# SPDX-License-Identifier: BSD-3-Clause
"""Bags of several files, packed, with odd indexes, or of old versions."""

from __future__ import annotations

import struct
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags")
pytest.importorskip("scipy")


from bags import KINDS, START, Messages, changed, same, write_bag

from ndtree.logs import read

STAMPS = np.arange(0, 3, 0.05)


def drive_content(make: Messages) -> list[tuple[str, float, Any]]:
    content: list[tuple[str, float, Any]] = []
    for i, t in enumerate(STAMPS):
        content.append(make.moved(START + t, "odom", "laser", [t, 0, 0]))
        content.append(("/scan", START + t, make.laser(START + t, "laser", [1.0 + 0.1 * i, 2.0])))
    return content


@pytest.mark.parametrize("kind", KINDS)
def test_a_recording_in_several_files_is_one(kind: str, tmp_path: Path) -> None:
    make = Messages(kind)
    content = drive_content(make)
    whole = list(read(write_bag(tmp_path / "whole", make, content)))
    folder = tmp_path / "parts"
    folder.mkdir()
    third = len(content) // 3 // 2 * 2
    for i, part in enumerate([content[: 9 * 2], content[9 * 2 : third + 20], content[third + 20 :]]):
        made = write_bag(tmp_path / f"part{i}", make, part)
        file = made if made.is_file() else next(one for one in made.iterdir() if one.suffix != ".yaml")
        file.rename(folder / f"run_{8 + i}{file.suffix}")
    assert same(list(read(folder)), whole)
    (folder / f"walk_0{file.suffix}").write_bytes(b"")
    with pytest.raises(ValueError, match="2 recordings, expected the path of one of them"):
        read(folder)


@pytest.mark.parametrize("storage", ["SQLITE3", "MCAP"])
@pytest.mark.parametrize("mode", ["FILE", "MESSAGE"])
def test_packed_bags_of_ros2(mode: str, storage: str, tmp_path: Path) -> None:
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

    make = Messages("sqlite3")
    whole = list(read(write_bag(tmp_path / "whole", make, drive_content(make))))
    writer = Writer(tmp_path / "packed", version=9, storage_plugin=StoragePlugin[storage])
    writer.set_compression(CompressionMode[mode], CompressionFormat.ZSTD)
    with writer:
        connections = {}
        for topic, stamp, message in drive_content(make):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, message.__msgtype__, typestore=make.store)
            data = make.store.serialize_cdr(message, message.__msgtype__)
            writer.write(connections[topic], round(stamp * 1e9), bytes(data))
    assert same(list(read(tmp_path / "packed")), whole)
    (tmp_path / "packed" / "metadata.yaml").unlink()
    assert same(list(read(tmp_path / "packed")), whole)


def test_messages_of_ros1_in_mcap(tmp_path: Path) -> None:
    mcap = pytest.importorskip("mcap.writer")
    make = Messages("ros1")
    path = tmp_path / "a.mcap"
    with open(path, "wb") as file:
        writer = mcap.Writer(file)
        writer.start("ros1")
        channels = {}
        for topic, stamp, message in drive_content(make):
            if topic not in channels:
                type_ = message.__msgtype__
                text, _ = make.store.generate_msgdef(type_)
                schema = writer.register_schema(type_.replace("/msg/", "/"), "ros1msg", text.encode())
                channels[topic] = writer.register_channel(topic, "ros1", schema)
            data = bytes(make.store.serialize_ros1(message, message.__msgtype__))
            writer.add_message(channels[topic], round(stamp * 1e9), data, round(stamp * 1e9))
        writer.finish()
    assert same(list(read(path)), list(read(write_bag(tmp_path / "whole", make, drive_content(make)))))


def test_indexes_of_ros1_that_lie_do_not_matter(tmp_path: Path) -> None:
    make = Messages("ros1")
    path = write_bag(tmp_path / "a", make, drive_content(make))
    whole = list(read(path))
    data = path.read_bytes()
    # The records of indexes: 47 bytes of header with op=4, and then that many bytes of entries.
    at = data.find(b"\x04\0\0\0op=\x04")
    assert at > 0
    place = data.find(struct.pack("<I", 47), at - 60) + 4 + 47
    lying = data[:place] + struct.pack("<I", 10**6) + data[place + 4 :]
    assert lying != data
    path.write_bytes(lying)
    assert same(list(read(path)), whole)


def test_old_bags_are_named(tmp_path: Path) -> None:
    path = tmp_path / "old.bag"
    for magic in (b"#ROSBAG V1.2\n", b"#ROSRECORD V1.2\n"):
        path.write_bytes(magic + bytes(100))
        with pytest.raises(ValueError, match=r"a ROS bag of version 1.2, expected version 2.0; .*rosbag"):
            read(path)


def test_an_index_of_ros1_that_lacks_its_end_is_not_believed(tmp_path: Path) -> None:
    """Cut off between records of the index, where nothing else shows that some are missing."""
    make = Messages("ros1")
    long = np.linspace(1, 7, 150_000)
    content = drive_content(make)
    content += [
        ("/scan", START + 1 + 0.1 * i, make.laser(START + 1 + 0.1 * i, "laser", long)) for i in range(6)
    ]
    path = write_bag(tmp_path / "a", make, content)
    whole = list(read(path))
    data = path.read_bytes()
    at = data.index(b"index_pos=") + len(b"index_pos=")
    (place,) = struct.unpack_from("<Q", data, at)
    records = []
    while place < len(data):
        records.append(place)
        for _ in range(2):  # Header and data.
            place += 4 + struct.unpack_from("<I", data, place)[0]
    assert len(records) >= 4  # Two connections, and chunks.
    for cut in records[1:]:
        path.write_bytes(data[:cut])
        log = read(path)
        assert same(list(log), whole) and any("found in it" in note for note in log.notes)


def test_a_single_file_of_ros2_and_a_bag_without_its_ending(tmp_path: Path) -> None:
    for kind in KINDS:
        make = Messages(kind)
        content = [
            make.fixed(START, "odom", "laser", [0, 0, 0]),
            ("/scan", START, make.laser(START, "laser", [1, 2, 3])),
        ]
        path = write_bag(tmp_path / kind, make, content)
        if kind == "ros1":
            single = path.rename(tmp_path / "no_ending")
        else:
            (single,) = (one for one in path.iterdir() if one.suffix in (".mcap", ".db3"))
        assert len(list(read(single))) == 1
        if kind != "ros1":
            assert len(list(read(single.rename(tmp_path / f"{kind}_renamed")))) == 1


HEADER = "std_msgs/Header header\n"
ABOUT_HEADER = """================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""


def test_a_bag_of_another_writer(tmp_path: Path) -> None:
    """An MCAP file of Foxglove's library, with definitions of its own in it."""
    writer = pytest.importorskip("mcap_ros2.writer", reason="no mcap-ros2-support: no second writer of bags")
    scan_text = HEADER + "".join(
        f"float32 {name}\n"
        for name in (
            "angle_min angle_max angle_increment time_increment scan_time range_min range_max"
        ).split()
    )
    scan_text += "float32[] ranges\nfloat32[] intensities\n" + ABOUT_HEADER
    tf_text = (
        "geometry_msgs/TransformStamped[] transforms\n"
        f"{'=' * 80}\nMSG: geometry_msgs/TransformStamped\n{HEADER}"
        "string child_frame_id\ngeometry_msgs/Transform transform\n"
        f"{'=' * 80}\nMSG: geometry_msgs/Transform\n"
        "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n"
        f"{'=' * 80}\nMSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n"
        f"{'=' * 80}\nMSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w\n"
    ) + ABOUT_HEADER

    def header(stamp: float, frame: str) -> dict[str, Any]:
        return {"stamp": {"sec": int(stamp), "nanosec": round(stamp % 1 * 1e9)}, "frame_id": frame}

    path = tmp_path / "foreign.mcap"
    with open(path, "wb") as file:
        one = writer.Writer(file)
        tf = one.register_msgdef("tf2_msgs/msg/TFMessage", tf_text)
        laser = one.register_msgdef("sensor_msgs/msg/LaserScan", scan_text)
        for i in range(20):
            stamp = 100 + 0.1 * i
            moved = {
                "header": header(stamp, "odom"),
                "child_frame_id": "laser",
                "transform": {
                    "translation": {"x": i, "y": -i, "z": 0.5},
                    "rotation": {"x": 0, "y": 0, "z": 1, "w": 0},
                },
            }
            one.write_message("/tf", tf, {"transforms": [moved]}, round(stamp * 1e9), round(stamp * 1e9))
        for i in range(3):
            scan = {
                "header": header(100.05 + i / 2, "laser"), "angle_min": 0.0, "angle_increment": np.pi / 2,
                "angle_max": np.pi, "range_min": 0.1, "range_max": 9.0, "ranges": [1.0, 2.0, float("inf")],
                "time_increment": 0.0, "scan_time": 0.0, "intensities": [],
            }  # fmt: skip
            one.write_message("/scan", laser, scan, round((100.05 + i / 2) * 1e9), 0)
        one.finish()
    scans = list(read(path))
    assert len(scans) == 3
    for i, scan in enumerate(scans):
        at = np.array([0.5 + 5 * i, -0.5 - 5 * i])
        np.testing.assert_allclose(scan.origin, at, atol=1e-5)
        np.testing.assert_allclose(scan.endpoints, at + np.array([[-1, 0], [0, -2], [9, 0]]), atol=1e-5)
        np.testing.assert_array_equal(scan.returned, [True, True, False])


def test_a_bag_is_read_message_by_message(ros2: Messages, tmp_path: Path) -> None:
    """The most memory in use while a bag is read is that of a few of its clouds."""
    points = np.zeros((3000, 4), dtype=np.float32)
    one = ros2.cloud(START, "sensor", points[:1])
    cloud = changed(one, width=3000, row_step=48_000, data=points.view(np.uint8).ravel())
    content = [ros2.fixed(START, "map", "sensor", [0, 0, 0])]
    content += [("/points", START + 1 + i, cloud) for i in range(400)]
    log = read(write_bag(tmp_path / "bag", Messages("sqlite3"), content))
    list(zip(range(3), log))
    tracemalloc.start()
    try:
        assert sum(1 for _ in log) == 400
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 400 * 48_000 / 10
