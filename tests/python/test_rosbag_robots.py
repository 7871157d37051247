# SPDX-License-Identifier: BSD-3-Clause
"""Bags as robots leave them: poses from elsewhere, mounts by hand, several sensors, sweeps, odd files."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags")
pytest.importorskip("scipy")

from bags import KINDS, Messages, write_bag
from scipy.spatial import transform as spatial

from ndtree.readers import read
from ndtree.readers.ros.livox import decoded
from ndtree.readers.ros.mount import mount_of

Rotation = spatial.Rotation
START = 1.7e9
LEVEL = [0, 0, 0, 1]
POINTS = np.array([[1.0, 2.0, 0.5], [3.0, -1.0, 0.25], [-2.0, 0.5, 1.0]], dtype=np.float32)


@pytest.fixture
def ros2() -> Messages:
    return Messages("mcap")


def at(t: float) -> tuple[np.ndarray, Any]:
    """Where a body is that drives a curve, t seconds after the start."""
    return np.array([0.5 * t, 0.1 * t * t, 0.2]), Rotation.from_euler("zyx", [0.6 * t, 0.05, -0.03])


STAMPS = np.arange(0, 3, 0.05)


def pose_message(make: Messages, kind: str, t: float) -> Any:
    place, turn = at(t)
    if kind == "TransformStamped":
        return make.transform(START + t, "world", "", place, turn.as_quat())
    pose = make.of(
        "geometry_msgs/msg/Pose",
        position=make.vector(place, "Point"),
        orientation=make.quaternion(turn.as_quat()),
    )
    header = make.header(START + t, "world")
    if kind == "Odometry":
        return make.odometry(START + t, "world", "", place, turn.as_quat())
    if kind == "PoseWithCovarianceStamped":
        pose = make.of("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=np.zeros(36))
    name = "PoseStamped" if kind == "Path" else kind
    return make.of(f"geometry_msgs/msg/{name}", header=header, pose=pose)


def pose_content(make: Messages, kind: str) -> list[tuple[str, float, Any]]:
    messages = [pose_message(make, kind, t) for t in STAMPS]
    if kind != "Path":
        return [("/pose", START + t, message) for t, message in zip(STAMPS, messages)]
    header = make.header(START, "world")
    halves = [messages[:35], messages[25:]]
    return [
        ("/pose", START + i, make.of("nav_msgs/msg/Path", header=header, poses=half))
        for i, half in enumerate(halves)
    ]


# --- Poses ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "kind", ["PoseStamped", "PoseWithCovarianceStamped", "TransformStamped", "Path", "Odometry"]
)
@pytest.mark.parametrize("mount", [None, "0.3,-0.1,0.4,10deg,-0.2,1.1"])
def test_poses_of_a_topic_and_a_mount(ros2: Messages, kind: str, mount: str | None, tmp_path: Path) -> None:
    content = pose_content(ros2, kind)
    times = [0.3, 1.0, 2.5]
    content += [("/points", START + t, ros2.cloud(START + t, "lidar", POINTS)) for t in times]
    path = write_bag(tmp_path / "bag", ros2, content)
    log = read(path, poses="/pose", mount=mount)
    assert any("poses of the sensor itself" in note for note in log.notes) == (mount is None)
    scans = list(log)
    assert len(scans) == 3
    position, turn = np.zeros(3), Rotation.identity()
    if mount is not None:
        position, turn = np.array([0.3, -0.1, 0.4]), Rotation.from_euler("xyz", [np.radians(10), -0.2, 1.1])
    for t, scan in zip(times, scans):
        place, body = at(t)
        expected = body.apply(turn.apply(POINTS) + position) + place
        np.testing.assert_allclose(scan.endpoints, expected, atol=1e-5)
        np.testing.assert_allclose(scan.origin, body.apply(position) + place, atol=1e-5)
    late = read(path, poses="/pose", mount=mount, time_offset=0.25)
    np.testing.assert_allclose(next(iter(late)).origin, at(0.55)[1].apply(position) + at(0.55)[0], atol=1e-3)


def test_mounts_are_read_as_urdf_says() -> None:
    for text, expected in (
        ("1,2,90deg", ([1, 2, 0], [0, 0, np.pi / 2])),
        ("1, 2, 3, 0.1, -20deg, 3", ([1, 2, 3], [0.1, np.radians(-20), 3])),
    ):
        pose = mount_of(text)
        np.testing.assert_allclose(pose.position, expected[0])
        np.testing.assert_allclose(
            pose.rotation, Rotation.from_euler("xyz", expected[1]).as_matrix(), atol=1e-12
        )
    for wrong in ("", "1,2", "1,2,3,4", "a,b,c", "0,0,180", "nan,0,0", "0,0,0,0,0,inf"):
        with pytest.raises(ValueError, match="expected x,y,z,roll,pitch,yaw or x,y,yaw"):
            mount_of(wrong)


def test_a_sensor_that_hangs_nowhere_is_named_and_mounted(ros2: Messages, tmp_path: Path) -> None:
    content: list[tuple[str, float, Any]] = []
    for t in STAMPS:
        moved = ros2.transform(START + t, "odom", "base_link", [t, 0, 0], LEVEL)
        content.append(("/tf", START + t, ros2.tf(moved)))
    fixed = ros2.transform(START, "base_link", "horn", [0.5, 0, 0.3], LEVEL)
    content.append(("/tf_static", START, ros2.tf(fixed)))
    content.append(("/scan", START + 1, ros2.laser(START + 1, "laser", [1.0, 2.0])))
    path = write_bag(tmp_path / "bag", ros2, content)
    with pytest.raises(ValueError, match=r"whose frames are base_link, horn, odom; say .*--mount X,Y,Z"):
        read(path)
    (scan,) = read(path, mount="0.1,0.2,0")
    np.testing.assert_allclose(scan.origin, [1.1, 0.2], atol=1e-6)
    (scan,) = read(path, mount="0,0,0", base_frame="horn")
    np.testing.assert_allclose(scan.origin, [1.5, 0], atol=1e-6)
    (scan,) = read(path, sensor_frame="horn")
    np.testing.assert_allclose(scan.origin, [1.5, 0], atol=1e-6)
    with pytest.raises(ValueError, match="base_frame = bell: not in /tf, expected one of base_link, horn"):
        read(path, mount="0,0,0", base_frame="bell")


def test_without_a_usual_frame_the_root_of_the_tree_is_fixed(ros2: Messages, tmp_path: Path) -> None:
    content: list[tuple[str, float, Any]] = []
    for t in STAMPS:
        moved = ros2.transform(START + t, "odom_combined", "base", [t, 0, 0], LEVEL)
        other = ros2.transform(START + t, "shelf", "box", [t, 0, 0], LEVEL)
        content.append(("/tf", START + t, ros2.tf(moved, other)))
    content.append(("/scan", START + 1, ros2.laser(START + 1, "/base", [1.0, 2.0])))
    assert read(write_bag(tmp_path / "bag", ros2, content)).fixed_frame == "odom_combined"
    # A map that is known only at the end is of no use where odometry knows every scan.
    content.append(("/tf", START, ros2.tf(ros2.transform(START + 2.9, "map", "odom", [0, 0, 0], LEVEL))))
    content.append(
        ("/tf_static", START, ros2.tf(ros2.transform(START, "odom", "odom_combined", [0, 0, 0], LEVEL)))
    )
    assert read(write_bag(tmp_path / "late", ros2, content)).fixed_frame == "odom"


def test_a_mount_that_was_said_only_once_holds(ros2: Messages, tmp_path: Path) -> None:
    """In /tf, not /tf_static; one that changes is no mount."""
    for turns in (False, True):
        content: list[tuple[str, float, Any]] = []
        for t in STAMPS:
            moved = ros2.transform(START + t, "odom", "base", [t, 0, 0], LEVEL)
            content.append(("/tf", START + t, ros2.tf(moved)))
        for t in (0.0, 0.3):
            at_t = ros2.transform(START + t, "base", "laser", [0.2, t if turns else 0, 0], LEVEL)
            content.append(("/tf", START + t, ros2.tf(at_t)))
        for t in (0.1, 1.0, 2.0, 2.5):
            content.append(("/scan", START + t, ros2.laser(START + t, "laser", [1.0, 2.0])))
        log = read(write_bag(tmp_path / str(turns), ros2, sorted(content, key=lambda one: one[1])))
        scans = list(log)
        assert len(scans) == (1 if turns else 4)
        assert any("base to laser" in note for note in log.notes) == (not turns)
        if not turns:
            np.testing.assert_allclose([scan.origin[0] for scan in scans], [0.3, 1.2, 2.2, 2.7], atol=1e-5)


def test_a_sensor_that_stands_still(ros2: Messages, tmp_path: Path) -> None:
    content = [("/scan", START + t, ros2.laser(START + t, f"laser{t}", [1.0] * (t + 2))) for t in range(4)]
    path = write_bag(tmp_path / "bag", ros2, content)
    with pytest.raises(ValueError, match=r"there is no /tf, nor any other poses, expected .* --still"):
        read(path)
    scans = list(read(path, still=True))
    assert [len(scan) for scan in scans] == [2, 3, 4, 5] and not np.any([scan.origin for scan in scans])


# --- Several sensors --------------------------------------------------------------------------------


def test_several_sensors_come_in_the_order_of_time(ros2: Messages, tmp_path: Path) -> None:
    content: list[tuple[str, float, Any]] = []
    for name, x in (("front", 0.3), ("rear", -0.3)):
        fixed = ros2.transform(START, "odom", name, [x, 0, 0], LEVEL)
        content.append(("/tf_static", START, ros2.tf(fixed)))
    for i in range(10):
        content.append(("/front", START + i, ros2.laser(START + 0.1 * i, "front", [1.0, 2.0])))
        content.append(("/rear", START + i, ros2.laser(START + 0.1 * i - 0.05, "rear", [1.0, 2.0, 3.0])))
    path = write_bag(tmp_path / "bag", ros2, content)
    log = read(path, topic=["front@0.02", "/rear"])
    scans = list(log)
    assert len(log) == len(scans) == 20
    stamps = [scan.stamp for scan in scans]
    assert stamps == sorted(stamps)
    for scan in scans:
        is_front = len(scan) == 2
        assert scan.origin[0] == pytest.approx(0.3 if is_front else -0.3)
        if is_front:
            assert scan.range_sigma is not None and set(scan.range_sigma) == {0.02}
        else:
            assert scan.range_sigma is None
    for wrong in ("front@", "front@-1", "front@x"):
        with pytest.raises(TypeError, match="expected a standard deviation in metres > 0 behind the @"):
            read(path, topic=wrong)
    with pytest.raises(TypeError, match="mount: is of one sensor, and there are 2"):
        read(path, topic=["front", "rear"], mount="0,0,0")


# --- Sweeps -----------------------------------------------------------------------------------------

SIDES = ((5.0, 0), (-4.0, 0), (3.0, 1), (-6.0, 1))


def to_wall(x: float, y: float, angle: float) -> float:
    """From a place in a room along an angle [m]."""
    way = (np.cos(angle), np.sin(angle))
    lengths = [(side - (x, y)[axis]) / way[axis] for side, axis in SIDES if abs(way[axis]) > 1e-9]
    return min(length for length in lengths if length > 0)


def sweeps(
    make: Messages,
    path: Path,
    *,
    reversed_: bool = False,
    at_end: bool = False,
    beams: int = 180,
    said: bool = True,
    sweep: float = 0.1,
) -> Path:
    """A turning laser in a room whose beams are measured one after the other."""
    generator = np.random.default_rng(3)

    def where(t: float) -> tuple[float, float, float]:
        return 0.4 * t, 0.1 * t, 0.9 * t

    content: list[tuple[str, float, Any]] = []
    for t in np.arange(0, 6.5, 0.02):
        x, y, yaw = where(t)
        turn = Rotation.from_euler("z", yaw).as_quat()
        content.append(
            ("/tf", START + t, make.tf(make.transform(START + t, "odom", "laser", [x, y, 0], turn)))
        )
    angles = -np.pi + 2 * np.pi / beams * np.arange(beams)
    for begin in np.arange(0.2, 6, 0.1):
        times = begin + sweep / beams * np.arange(beams)
        if reversed_:
            times = times[::-1]
        ranges = []
        for t, angle in zip(times, angles):
            x, y, yaw = where(t)
            ranges.append(to_wall(x, y, yaw + angle) + generator.normal(0, 0.003))
        stamp = START + (times.max() if at_end else begin)
        message = make.laser(
            stamp, "laser", ranges, angle_min=angles[0], angle_increment=2 * np.pi / beams,
            time_increment=sweep / beams if said else 0.0, range_max=20.0,
        )  # fmt: skip
        content.append(("/scan", stamp, message))
    return write_bag(path, make, sorted(content, key=lambda one: one[1]))


def off_walls(scans: Any) -> float:
    """How far end points are from the walls, 95 % of them less [m]."""
    points = np.concatenate([scan.endpoints for scan in scans])
    return float(np.percentile(np.min([abs(points[:, axis] - side) for side, axis in SIDES], axis=0), 95))


def test_a_scan_time_counts_if_the_log_bears_it_out(ros2: Messages, tmp_path: Path) -> None:
    log = read(sweeps(ros2, tmp_path / "swept", said=False))
    assert off_walls(log) < 0.012 and any("so scans agree better" in note for note in log.notes)
    at_once = read(sweeps(ros2, tmp_path / "at once", said=False, sweep=0.0))
    assert off_walls(at_once) < 0.012 and not at_once.notes


@pytest.mark.parametrize("reversed_, at_end", [(False, False), (True, True), (True, False), (False, True)])
def test_each_beam_has_the_pose_of_its_time_however_the_driver_means_it(
    ros2: Messages, reversed_: bool, at_end: bool, tmp_path: Path
) -> None:
    path = sweeps(ros2, tmp_path / "bag", reversed_=reversed_, at_end=at_end)
    log = read(path)
    assert off_walls(log) < 0.012
    assert any("so scans agree better than as their messages say" in note for note in log.notes) == (
        reversed_ or at_end
    )
    assert off_walls(read(path, deskew=False)) > 0.05


def test_a_fast_sensor_has_an_origin_for_each_beam(ros2: Messages, tmp_path: Path) -> None:
    content: list[tuple[str, float, Any]] = []
    for t in np.arange(0, 2, 0.1):
        moved = ros2.transform(START + t, "odom", "laser", [10 * t, 0, 0], LEVEL)
        content.append(("/tf", START + t, ros2.tf(moved)))
    laser = ros2.laser(START + 1, "laser", [1.0] * 11, time_increment=0.01)
    path = write_bag(tmp_path / "bag", ros2, [*content, ("/scan", START + 1, laser)])
    (scan,) = read(path)
    np.testing.assert_allclose(scan.origin[:, 0], 10 + 0.1 * np.arange(11), atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(scan.endpoints - scan.origin, axis=1), 1, atol=1e-5)
    (scan,) = read(path, deskew=False)
    np.testing.assert_allclose(scan.origin, [10, 0], atol=1e-5)


@pytest.mark.parametrize(
    "kind, times",
    [
        ("u4", lambda t: 1e9 * t),
        ("f4", lambda t: t),
        ("f8", lambda t: START + 1 + t),
        ("f8", lambda t: 1e9 * (START + 1 + t)),
        ("f4", lambda t: 1e6 * t),
    ],
)
def test_clouds_with_times_of_any_unit(ros2: Messages, kind: str, times: Any, tmp_path: Path) -> None:
    content: list[tuple[str, float, Any]] = []
    for t in np.arange(0, 2, 0.1):
        moved = ros2.transform(START + t, "odom", "lidar", [10 * t, 0, 0], LEVEL)
        content.append(("/tf", START + t, ros2.tf(moved)))
    since = np.array([0.0, 0.025, 0.1])
    layout = np.dtype([("xyz", "f4", 3), ("time", kind)])
    table = np.zeros(3, layout)
    table["xyz"], table["time"] = POINTS, times(since)
    cloud = ros2.cloud(START + 1, "lidar", POINTS)
    code = {"u4": 6, "f4": 7, "f8": 8}[kind]
    extra = ros2.of("sensor_msgs/msg/PointField", name="time", offset=12, datatype=code, count=1)
    for name, value in {
        "fields": [*cloud.fields, extra], "point_step": layout.itemsize, "row_step": 3 * layout.itemsize,
        "data": np.frombuffer(table.tobytes(), np.uint8),
    }.items():  # fmt: skip
        object.__setattr__(cloud, name, value)
    (scan,) = read(write_bag(tmp_path / "bag", ros2, [*content, ("/points", START + 1, cloud)]))
    expected = POINTS + np.stack([10 + 10 * since, np.zeros(3), np.zeros(3)], axis=1)
    np.testing.assert_allclose(scan.endpoints, expected, atol=2e-4)


# --- Messages ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("is_ros1", [True, False])
def test_livox_points_lie_where_the_bytes_have_them(is_ros1: bool) -> None:
    frame = b"livox_frame" + (b"" if is_ros1 else b"\0")
    data = (
        (struct.pack("<I", 7) if is_ros1 else b"\0\1\0\0") + struct.pack("<3I", 1700, 500, len(frame)) + frame
    )
    if not is_ros1:
        data += bytes(-(len(data) - 4) % 8)
    data += struct.pack("<QI4B", 123, 3, 0, 0, 0, 0) + struct.pack("<I", 3)
    for i, point in enumerate(POINTS):
        data += struct.pack("<I3f3B", 1000 * i, *point, 9, 9, 9)
        if not is_ros1 and i < 2:
            data += b"\0"
    message = decoded(data, is_ros1=is_ros1)
    np.testing.assert_array_equal(message.points, POINTS)
    np.testing.assert_array_equal(message.offset_times, [0, 1000, 2000])
    assert message.header.frame_id == "livox_frame" and message.header.stamp.sec == 1700
    with pytest.raises(ValueError, match=r"expected .* for 3 points"):
        decoded(data[:-1], is_ros1=is_ros1)
    for end, said in ((20, "expected a frame of"), (40, "expected a whole CustomMsg")):
        with pytest.raises(ValueError, match=said):
            decoded(data[:end], is_ros1=is_ros1)


def still_scans(make: Messages, message: Any, path: Path, **options: Any) -> list[Any]:
    return list(read(write_bag(path / "bag", make, [("/sensor", START, message)]), still=True, **options))


def test_single_ranges(ros2: Messages, tmp_path: Path) -> None:
    message = ros2.of(
        "sensor_msgs/msg/Range",
        header=ros2.header(START, "sonar"), radiation_type=0, field_of_view=0.3, min_range=0.1,
        max_range=4.0, range=1.5, **({"variance": 0.0} if "variance" in ros2.store.types[
            "sensor_msgs/msg/Range"].__dataclass_fields__ else {}),
    )  # fmt: skip
    (scan,) = still_scans(ros2, message, tmp_path)
    np.testing.assert_allclose(scan.endpoints, [[1.5, 0]])


def test_beams_that_are_cut_off_at_range_max_did_not_return(ros2: Messages, tmp_path: Path) -> None:
    (scan,) = still_scans(ros2, ros2.laser(START, "a", [1, 8, 8, 3], range_max=8.0), tmp_path)
    np.testing.assert_array_equal(scan.returned, [True, False, False, True])
    np.testing.assert_allclose(np.linalg.norm(scan.endpoints, axis=1), [1, 8, 8, 3])


def test_an_infinite_range_max_needs_a_limit(ros2: Messages, tmp_path: Path) -> None:
    message = ros2.laser(START, "a", [1, np.inf, 3], range_max=np.inf)
    path = write_bag(tmp_path / "bag", ros2, [("/scan", START, message)])
    log = read(path, still=True)
    (scan,) = log
    assert np.isnan(scan.endpoints[1]).all()
    assert any("1 beams met nothing, but range_max is infinite" in note for note in log.notes)
    log.no_return_range = 6.0
    (scan,) = log
    assert np.linalg.norm(scan.endpoints[1]) == pytest.approx(6) and not scan.returned[1]
    assert not any("range_max is infinite" in note for note in log.notes)


# --- Files ------------------------------------------------------------------------------------------


def drive_content(make: Messages) -> list[tuple[str, float, Any]]:
    content: list[tuple[str, float, Any]] = []
    for i, t in enumerate(STAMPS):
        moved = make.transform(START + t, "odom", "laser", [t, 0, 0], LEVEL)
        content.append(("/tf", START + t, make.tf(moved)))
        content.append(("/scan", START + t, make.laser(START + t, "laser", [1.0 + 0.1 * i, 2.0])))
    return content


def same(one: Any, other: Any) -> bool:
    return len(one) == len(other) and all(
        np.array_equal(a.endpoints, b.endpoints) and a.stamp == b.stamp for a, b in zip(one, other)
    )


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


@pytest.mark.parametrize("mode", ["FILE", "MESSAGE"])
def test_packed_bags_of_ros2(mode: str, tmp_path: Path) -> None:
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

    make = Messages("sqlite3")
    whole = list(read(write_bag(tmp_path / "whole", make, drive_content(make))))
    writer = Writer(tmp_path / "packed", version=9, storage_plugin=StoragePlugin.SQLITE3)
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
    # The records of indexes: 47 bytes of header with op=4, and then so many bytes of entries.
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
        with pytest.raises(
            ValueError, match=r"an old ROS bag, of version 1.2, expected version 2.0; .*rosbag"
        ):
            read(path)


# --- Finding the mount ------------------------------------------------------------------------------


@pytest.mark.parametrize("sweep, side", [(0.0, 1), (0.09, -1)])
def test_the_mount_is_found_where_the_map_is_sharpest(
    ros2: Messages, sweep: float, side: int, tmp_path: Path
) -> None:
    """A body that winds through a room, its laser sits askew on it or hangs, and the clock is off."""
    pytest.importorskip("typer")
    from typer.testing import CliRunner

    from ndtree.commands import app
    from ndtree.readers.ros.mounting import find_mount
    from ndtree.readers.rosbag import RosbagLog

    generator = np.random.default_rng(7)
    x, y, yaw, offset = 0.12, -0.07, 2.0, 0.06
    angles = np.linspace(-np.pi, np.pi, 120, endpoint=False)
    content: list[tuple[str, float, Any]] = []

    def body(t: float) -> tuple[float, float, float]:
        return 1.5 * np.sin(0.7 * t), -1 + np.cos(0.5 * t), 1.2 * np.sin(0.9 * t) + 0.3 * t

    for t in np.arange(0, 14, 0.02):
        bx, by, turn = body(t)
        quaternion = Rotation.from_euler("z", turn).as_quat()
        pose = ros2.of(
            "geometry_msgs/msg/Pose",
            position=ros2.vector([bx, by, 0], "Point"), orientation=ros2.quaternion(quaternion),
        )  # fmt: skip
        message = ros2.of("geometry_msgs/msg/PoseStamped", header=ros2.header(START + t, "world"), pose=pose)
        content.append(("/pose", START + t, message))
    for t in np.arange(0.5, 13.5, 0.1):
        ranges = []
        for angle, after in zip(angles, np.linspace(0, sweep, len(angles))):
            bx, by, turn = body(t + after)
            c, s = np.cos(turn), np.sin(turn)
            place = (bx + c * x - s * y, by + s * x + c * y)
            ranges.append(to_wall(*place, turn + yaw + side * angle) + generator.normal(0, 0.005))
        stamp = START + t - offset
        laser = ros2.laser(
            stamp,
            "laser",
            ranges,
            angle_min=-np.pi,
            angle_increment=np.pi / 60,
            time_increment=sweep / (len(angles) - 1),
            scan_time=0.0,
            range_max=20.0,
        )
        content.append(("/scan", stamp, laser))
    path = write_bag(tmp_path / "bag", ros2, sorted(content, key=lambda one: one[1]))
    found = find_mount(RosbagLog(str(path), poses="/pose", mount="0,0,0"))
    assert found.x == pytest.approx(x, abs=0.01) and found.y == pytest.approx(y, abs=0.01)
    assert found.yaw == pytest.approx(yaw, abs=0.01)
    assert found.time_offset == pytest.approx(offset, abs=0.01)
    assert abs(found.others[1]) == pytest.approx(0 if side > 0 else np.pi, abs=1e-6)
    assert found.gain > 0.5 and found.flags.startswith("--mount 0.1")
    mount = found.flags.split()[1]
    assert off_walls(read(path, poses="/pose", mount=mount, time_offset=found.time_offset)) < 0.03
    if sweep:  # By the command the same.
        report = tmp_path / "found.json"
        call = ["calibrate", str(path), "--find-mount", "--poses", "/pose", "--json", str(report)]
        done = CliRunner().invoke(app, call)
        assert done.exit_code == 0 and "the map is sharpest with --mount" in done.stdout
        assert json.loads(report.read_text())["time_offset"] == pytest.approx(offset, abs=0.01)
        return
    again = find_mount(
        RosbagLog(str(path), poses="/pose", mount=f"0.1,-0.1,0.5,0,0,{yaw - 0.3}", time_offset=0.05)
    )
    assert again.yaw == pytest.approx(yaw, abs=0.01) and again.others[0] == 0.5
    assert again.time_offset == pytest.approx(offset, abs=0.01)


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
        assert same(list(log), whole) and any("messages were found in it" in note for note in log.notes)
