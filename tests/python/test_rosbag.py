# SPDX-License-Identifier: BSD-3-Clause
"""Bags that the library rosbags writes are read with the end points that SciPy computes."""

from __future__ import annotations

import subprocess
import sys
import tracemalloc
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags")
pytest.importorskip("scipy")

from bags import KINDS, Messages, write_bag
from scipy.spatial import transform as spatial

import ndtree
from ndtree.readers import read
from ndtree.readers.ros import multi_echo
from ndtree.readers.trajectory_files import read_trajectory

Rotation = spatial.Rotation
START = 1.7e9
LEVEL = [0, 0, 0, 1]


@pytest.fixture(params=KINDS)
def make(request: pytest.FixtureRequest) -> Messages:
    return Messages(request.param)


@pytest.fixture
def ros2() -> Messages:
    return Messages("mcap")


class Drive:
    """A robot on a winding way, with its transforms at 10 Hz and a sensor mounted on it."""

    def __init__(self, *, planar: bool, seed: int = 2, n: int = 25) -> None:
        generator = np.random.default_rng(seed)
        self.stamps = START + 0.1 * np.arange(n)
        self.positions = np.cumsum(generator.normal(0, 0.2, (n, 3)), axis=0)
        turns = generator.normal(0, 0.15, (n, 3))
        if planar:
            self.positions[:, 2] = 0.0
            turns[:, :2] = 0.0
        self.rotations = Rotation.from_rotvec(np.cumsum(turns, axis=0))
        self.mount_position = np.array([0.3, -0.1, 0.5])
        self.mount = Rotation.from_euler("z", 0.4) if planar else Rotation.random(random_state=seed)
        self.localised = np.array([3.0, -2.0, 0.0])

    def transforms(self, make: Messages, *, static: bool = True) -> list[tuple[str, float, Any]]:
        fixed = make.transform(START - 50, "base", "/sensor", self.mount_position, self.mount.as_quat())
        content = [("/tf_static", START - 50, make.tf(fixed))] if static else []
        for stamp, position, turn in zip(self.stamps, self.positions, self.rotations):
            moved = make.transform(stamp, "odom", "base", position, turn.as_quat())
            corrected = make.transform(stamp, "map", "odom", self.localised, LEVEL)
            content.append(("/tf", stamp, make.tf(moved, corrected)))
        return content

    def body(self, stamp: float) -> tuple[np.ndarray, Any]:
        """Where the robot is in the odometry's frame."""
        turn = spatial.Slerp(self.stamps - START, self.rotations)(stamp - START)
        position = [np.interp(stamp, self.stamps, self.positions[:, axis]) for axis in range(3)]
        return np.array(position), turn

    def sensor(self, stamp: float) -> tuple[np.ndarray, Any]:
        position, turn = self.body(stamp)
        return position + turn.apply(self.mount_position), turn * self.mount

    def in_map(self, stamp: float, points: np.ndarray) -> np.ndarray:
        position, turn = self.sensor(stamp)
        return turn.apply(points) + position + self.localised


SCAN_TIMES = START + np.array([0.0, 0.13, 0.77, 1.05, 2.4])


def laser_points(message: Any) -> np.ndarray:
    angles = [message.angle_min + i * message.angle_increment for i in range(len(message.ranges))]
    return np.array([[r * np.cos(a), r * np.sin(a), 0] for r, a in zip(message.ranges.astype(float), angles)])


# --- What is read -----------------------------------------------------------------------------------


def test_laser_scans_lie_where_the_transforms_say(make: Messages, tmp_path: Path) -> None:
    drive, generator = Drive(planar=True), np.random.default_rng(1)
    scans = [make.laser(t, "sensor", generator.uniform(0.5, 7, 30)) for t in SCAN_TIMES]
    content = drive.transforms(make) + [("/scan", t, scan) for t, scan in zip(SCAN_TIMES, scans)]
    content.append(("/chatter", START, make.text("hello")))
    path = write_bag(tmp_path / "bag", make, sorted(content, key=lambda one: one[1]))
    log = read(path)
    assert (log.format, log.dim, len(log)) == ("rosbag", 2, 5)
    assert log.uses == "/scan (LaserScan in sensor), poses in map from /tf"
    for _ in range(2):
        found = list(log)
        assert len(found) == 5
        for scan, message, stamp in zip(found, scans, SCAN_TIMES):
            expected = drive.in_map(stamp, laser_points(message))
            np.testing.assert_allclose(scan.endpoints, expected[:, :2], atol=2e-6)
            np.testing.assert_allclose(scan.origin, drive.in_map(stamp, np.zeros(3))[:2], atol=2e-6)
            assert scan.stamp == pytest.approx(stamp, abs=1e-6) and scan.returned.all()
    in_odom = next(iter(read(path, fixed_frame="/odom", dim=3)))
    expected = drive.in_map(SCAN_TIMES[0], laser_points(scans[0])) - drive.localised
    np.testing.assert_allclose(in_odom.endpoints, expected, atol=2e-6)


@pytest.mark.parametrize("poses", ["tf", "odometry", "trajectory"])
def test_clouds_with_poses_from_anywhere_are_the_same(make: Messages, poses: str, tmp_path: Path) -> None:
    drive, generator = Drive(planar=False), np.random.default_rng(3)
    clouds = generator.normal(0, 5, (5, 40, 3)).astype(np.float32)
    content = [("/points", t, make.cloud(t, "sensor", points)) for t, points in zip(SCAN_TIMES, clouds)]
    options: dict[str, Any] = {}
    shift = np.zeros(3)
    if poses == "tf":
        content += drive.transforms(make)
    elif poses == "odometry":
        content += drive.transforms(make)[:1]
        content += [
            ("/odom", t, make.odometry(t, "odom", "base", p, r.as_quat()))
            for t, p, r in zip(drive.stamps, drive.positions, drive.rotations)
        ]
        options, shift = {"odometry": "/odom"}, drive.localised
    else:
        rows = [[t, *drive.sensor(t)[0], *drive.sensor(t)[1].as_quat()] for t in SCAN_TIMES]
        np.savetxt(tmp_path / "poses.txt", rows, fmt="%.9f")
        options, shift = {"trajectory": str(tmp_path / "poses.txt")}, drive.localised
    path = write_bag(tmp_path / "bag", make, sorted(content, key=lambda one: one[1]))
    log = read(path, **options)
    assert log.dim == 3
    found = list(log)
    assert len(found) == 5
    for scan, points, stamp in zip(found, clouds, SCAN_TIMES):
        np.testing.assert_allclose(scan.endpoints + shift, drive.in_map(stamp, points), atol=1e-5)
        np.testing.assert_allclose(scan.origin + shift, drive.in_map(stamp, np.zeros(3)), atol=1e-6)


def standing(make: Messages, topic: str, messages: list[Any], path: Path, **options: Any) -> list[Any]:
    """Scans of a sensor that stands in the map's origin."""
    content = [("/tf_static", START, make.tf(make.transform(START, "map", "sensor", [0, 0, 0], LEVEL)))]
    content += [(topic, START + 1 + i, message) for i, message in enumerate(messages)]
    return list(read(write_bag(path / "standing", make, content), **options))


def test_ranges_follow_rep_117(make: Messages, tmp_path: Path) -> None:
    ranges = np.array([1, np.inf, -np.inf, np.nan, 0.05, 9, 0.1, 8, 0], dtype=np.float32)
    scans = [make.laser(START, "sensor", ranges, range_min=0.1, range_max=m) for m in (8.0, np.inf, 0.0)]
    one, endless, none = standing(make, "/scan", scans, tmp_path)
    lengths = np.linalg.norm(one.endpoints, axis=1)
    np.testing.assert_allclose(lengths, [1, 8, *[np.nan] * 4, 0.1, 8, np.nan], rtol=1e-6)
    np.testing.assert_array_equal(one.returned, [1, 0, 0, 0, 0, 0, 1, 1, 0])
    assert np.isnan(endless.endpoints[1]).all() and not endless.returned[1] and endless.returned[5]
    assert np.isnan(none.endpoints).all()
    report = one.insert_into(ndtree.AdaptiveMap(dim=2))
    assert (report.returned, report.not_returned, report.invalid) == (3, 1, 5)


def test_of_several_echoes_the_nearest_valid_one_counts(make: Messages, tmp_path: Path) -> None:
    ranges = [[3, 2, 5], [], [0.1, 4], [np.inf], [np.nan, -np.inf], [np.inf, 6], [9]]
    (scan,) = standing(make, "/echoes", [make.multi_echo(START, "sensor", ranges)], tmp_path)
    lengths = np.linalg.norm(scan.endpoints, axis=1)
    np.testing.assert_allclose(lengths, [2, np.nan, 4, 8, np.nan, 6, np.nan], rtol=1e-6)
    np.testing.assert_array_equal(scan.returned, [1, 0, 1, 0, 0, 1, 0])
    np.testing.assert_allclose(scan.endpoints[2], 4 * np.array([np.cos(0.5), np.sin(0.5)]), rtol=1e-6)


def test_echoes_are_what_others_decode(make: Messages) -> None:
    rng = np.random.default_rng(1)
    for frame in ("a", "ab", "abc", "abcd"):
        ranges = [rng.uniform(0, 9, size=rng.integers(0, 4)) for _ in range(rng.integers(0, 12))]
        message = make.multi_echo(START, frame, ranges)
        is_ros1 = make.kind == "ros1"
        pack = make.store.serialize_ros1 if is_ros1 else make.store.serialize_cdr
        data = bytes(pack(message, message.__msgtype__))
        found = multi_echo.decoded(data, is_ros1=is_ros1)
        assert found.header.frame_id == frame and found.beams == len(ranges)
        for name in ("angle_min", "angle_increment", "time_increment", "scan_time", "range_min", "range_max"):
            assert getattr(found, name) == pytest.approx(getattr(message, name))
        for number, beam in enumerate(message.ranges):
            np.testing.assert_array_equal(found.echoes[found.numbers == number], beam.echoes)
        for cut in range(5, len(data), 3):
            try:  # What is cut off behind the echoes, among the intensities, is not missed.
                part = multi_echo.decoded(data[:-cut], is_ros1=is_ros1)
            except ValueError as error:
                assert "expected" in str(error)
            else:
                np.testing.assert_array_equal(part.echoes, found.echoes)


CLOUDS: dict[str, dict[str, Any]] = {
    "packed": {"offsets": (0, 4, 8), "step": 12},
    "doubles": {"types": (8, 8, 8), "offsets": (4, 12, 20), "step": 29},
    "big-endian": {"big": True},
    "mixed, turned round": {"types": (8, 7, 3), "offsets": (7, 20, 1), "step": 31},
    "organised with padded rows": {"height": 3, "row_padding": 5, "step": 18},
    "integers": {"types": (5, 3, 1), "offsets": (0, 4, 6), "step": 7},
}


@pytest.mark.parametrize("layout", CLOUDS)
def test_clouds_of_any_layout(ros2: Messages, layout: str, tmp_path: Path) -> None:
    points = np.arange(36.0).reshape(12, 3) - 11
    (scan,) = standing(ros2, "/points", [ros2.cloud(START, "sensor", points, **CLOUDS[layout])], tmp_path)
    np.testing.assert_array_equal(scan.endpoints, points)
    assert scan.returned is None


def test_clouds_keep_nan_and_may_be_empty(ros2: Messages, tmp_path: Path) -> None:
    points = np.array([[1, 2, 3], [np.nan, np.nan, np.nan], [4, 5, 6]])
    clouds = [ros2.cloud(START, "sensor", points), ros2.cloud(START, "sensor", points[:0])]
    one, empty = standing(ros2, "/points", clouds, tmp_path)
    np.testing.assert_array_equal(one.endpoints, points)
    assert (len(empty), empty.dim) == (0, 3)


@pytest.mark.parametrize("encoding, big", [("16UC1", False), ("32FC1", True), ("mono16", True)])
def test_depth_images_with_their_camera(make: Messages, encoding: str, big: bool, tmp_path: Path) -> None:
    depths = np.random.default_rng(4).uniform(0.5, 4, (6, 8))
    depths[2, 3] = depths[0, 0] = 0
    values = depths if encoding == "32FC1" else np.round(1000 * depths)
    if encoding == "32FC1":
        values = values.astype(np.float32)
        values[5, 5], depths[5, 5] = np.nan, 0
    camera = (7.0, 8.0, 3.5, 2.5)
    drive = Drive(planar=False)
    content = drive.transforms(make)
    stamp = SCAN_TIMES[1]
    image = make.image(stamp, "sensor", values, encoding, big=big, padding=3)
    colour = make.image(stamp, "sensor", np.zeros((6, 8)), "mono8")
    content += [
        ("/cam/color/image", stamp, colour),
        ("/cam/color/camera_info", stamp, make.camera_info(stamp, "other", (6, 8), (1, 1, 1, 1))),
        ("/cam/depth/camera_info", stamp - 1, make.camera_info(stamp - 1, "sensor", (6, 8), (1, 1, 0, 0))),
        ("/cam/depth/camera_info", stamp, make.camera_info(stamp, "sensor", (6, 8), camera)),
        ("/cam/depth/image", stamp, image),
    ]
    path = write_bag(tmp_path / "bag", make, content)
    log = read(path)
    assert log.uses == (
        "/cam/depth/image (Image in sensor), cameras from /cam/depth/camera_info, poses in map from /tf"
    )
    (scan,) = log
    expected = []
    for v in range(6):
        for u in range(8):
            if depths[v, u]:
                z = float(values[v, u]) / (1 if encoding == "32FC1" else 1000)
                expected.append([(u - camera[2]) / camera[0] * z, (v - camera[3]) / camera[1] * z, z])
    np.testing.assert_allclose(scan.endpoints, drive.in_map(stamp, np.array(expected)), atol=2e-6)
    (given,) = read(path, camera="7,8,3.5,2.5")
    np.testing.assert_array_equal(given.endpoints, scan.endpoints)
    (few,) = read(path, pixel_stride=2)
    assert 0 < len(few) <= 12


def test_a_laser_that_tilts_is_3d_unless_told(ros2: Messages, tmp_path: Path) -> None:
    tilts = {"level": 0.01, "upside down": np.pi, "on a slope": 0.1}
    for name, tilt in tilts.items():
        turn = Rotation.from_euler("x", tilt).as_quat()
        content = [
            ("/tf_static", START, ros2.tf(ros2.transform(START, "odom", "laser", [0, 0, 0], turn))),
            ("/scan", START, ros2.laser(START, "laser", [1, 2, 3])),
        ]
        path = write_bag(tmp_path / name, ros2, content)
        assert read(path).dim == (3 if name == "on a slope" else 2), name
        assert next(iter(read(path, dim=2))).endpoints.shape == (3, 2)
        assert next(iter(read(path, dim=3))).endpoints.shape == (3, 3)
    with pytest.raises(ValueError, match="PointCloud2 is 3-D, expected dim=3"):
        standing(ros2, "/points", [ros2.cloud(START, "sensor", np.ones((2, 3)))], tmp_path, dim=2)


def test_the_way_between_frames_may_lead_down(ros2: Messages, tmp_path: Path) -> None:
    """A fixed frame that is a leaf of the tree, as where the odometry's pose in a beacon is published."""
    drive = Drive(planar=True)
    content = drive.transforms(ros2)
    beacon = Rotation.from_euler("z", 1.0)
    content.insert(
        0, ("/tf_static", START, ros2.tf(ros2.transform(0, "map", "beacon", [1, 2, 0], beacon.as_quat())))
    )
    stamp = SCAN_TIMES[2]
    content.append(("/scan", stamp, ros2.laser(stamp, "sensor", [1, 2, 3])))
    (scan,) = read(write_bag(tmp_path / "bag", ros2, content), fixed_frame="beacon")
    points = drive.in_map(stamp, laser_points(content[-1][2]))
    np.testing.assert_allclose(scan.endpoints, beacon.inv().apply(points - [1, 2, 0])[:, :2], atol=1e-6)


def test_transforms_that_are_none_are_passed_over(ros2: Messages, tmp_path: Path) -> None:
    drive = Drive(planar=True)
    content = drive.transforms(ros2)
    for position, turn in (([np.nan, 0, 0], LEVEL), ([0, 0, 0], [0, 0, 0, 0])):
        wrong = ros2.transform(START + 0.15, "odom", "base", position, turn)
        content.append(("/tf", START, ros2.tf(wrong)))
    content.append(("/scan", START, ros2.laser(START + 0.13, "sensor", [1, 2])))
    (scan,) = read(write_bag(tmp_path / "bag", ros2, content))
    np.testing.assert_allclose(scan.origin, drive.in_map(START + 0.13, np.zeros(3))[:2], atol=1e-6)


def test_a_single_file_of_ros2_and_a_bag_without_its_ending(tmp_path: Path) -> None:
    for kind in KINDS:
        make = Messages(kind)
        content = [
            ("/tf_static", START, make.tf(make.transform(START, "odom", "laser", [0, 0, 0], LEVEL))),
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
    cloud = ros2.cloud(START, "sensor", points[:1])
    for name, value in {
        "width": 3000, "row_step": 48_000, "data": points.view(np.uint8).ravel()
    }.items():  # fmt: skip
        object.__setattr__(cloud, name, value)
    content = [("/tf_static", START, ros2.tf(ros2.transform(START, "map", "sensor", [0, 0, 0], LEVEL)))]
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


# --- What is refused --------------------------------------------------------------------------------


@pytest.mark.parametrize("when", [-1.0, 9.0])
def test_a_scan_outside_of_the_transforms_is_left_out_or_named(
    make: Messages, when: float, tmp_path: Path
) -> None:
    drive = Drive(planar=True)
    stamps = sorted([START + when, *SCAN_TIMES])
    content = drive.transforms(make) + [("/scan", t, make.laser(t, "sensor", [1, 2, 3])) for t in stamps]
    path = write_bag(tmp_path / "bag", make, sorted(content, key=lambda one: one[1]))
    log = read(path)
    assert len(list(log)) == 5
    (left_out,) = log.skipped.values()
    assert list(log.skipped) == ["scans without a pose"] and left_out.count == 1
    how = "begin 1.00 s later" if when < 0 else "end 6.60 s earlier"
    assert left_out.summary == f"1 of 6 scans had no pose: the poses {how}"
    message = (
        rf"{path}: /scan: message {0 if when < 0 else 5}: transform from \w+ to \w+: no pose at "
        rf"{START + when:.6f} s, expected a time from {START:.6f} to [\d.]+ s"
    )
    with pytest.raises(ValueError, match=message):
        list(read(path, strict=True))


def test_a_log_without_any_pose_is_an_error(ros2: Messages, tmp_path: Path) -> None:
    content = Drive(planar=True).transforms(ros2)
    content += [("/scan", START, ros2.laser(START + 90 + t, "sensor", [1, 2, 3])) for t in range(3)]
    log = read(write_bag(tmp_path / "bag", ros2, content))
    with pytest.raises(ValueError, match=r"3 of 3 scans had no pose: the poses end 8\d.60 s earlier"):
        list(log)


def test_scans_in_a_gap_of_the_transforms_are_left_out(ros2: Messages, tmp_path: Path) -> None:
    """Where the robot moved meanwhile: a robot that stood is where it was."""
    for moved in (True, False):
        content: list[tuple[str, float, Any]] = []
        for i in [*range(10), *range(40, 50)]:
            place = [0.05 * i if moved else 0.0, 0, 0]
            content.append(
                (
                    "/tf",
                    START + 0.1 * i,
                    ros2.tf(ros2.transform(START + 0.1 * i, "odom", "laser", place, LEVEL)),
                )
            )
        for i in range(50):
            content.append(("/scan", START + 0.1 * i, ros2.laser(START + 0.1 * i, "laser", [1, 2, 3])))
        path = write_bag(tmp_path / str(moved), ros2, sorted(content, key=lambda one: one[1]))
        log = read(path)
        assert len(list(log)) == (20 if moved else 50)
        summaries = [one.summary for one in log.skipped.values()]
        assert summaries == (
            ["30 of 50 scans had no pose: the poses have gaps of up to 3.10 s"] if moved else []
        )


def test_damaged_messages_are_named_or_passed_over(make: Messages, tmp_path: Path) -> None:
    good = make.laser(START, "sensor", [1, 2, 3])
    content = [("/tf_static", START, make.tf(make.transform(START, "map", "sensor", [0, 0, 0], LEVEL)))]
    content += [("/scan", START + i, good) for i in range(4)]
    content.insert(3, ("/scan", START + 1.5, ("sensor_msgs/msg/LaserScan", b"\0\1\0\0rubbish")))
    content.insert(3, ("/scan", START + 1.2, make.text("not a scan")))
    path = write_bag(tmp_path / "bag", make, content)
    with pytest.raises(
        ValueError, match=f"{path}: /scan: message 2: is of type std_msgs/msg/String, expected"
    ):
        list(read(path, topic="/scan"))
    log = read(path, keep_going=True, topic="/scan")
    assert len(list(log)) == 4
    assert log.skipped["damaged messages"].count == 2


def test_damaged_bags_are_named(make: Messages, tmp_path: Path) -> None:
    drive = Drive(planar=True)
    content = drive.transforms(make) + [("/scan", t, make.laser(t, "sensor", [1, 2])) for t in SCAN_TIMES]
    path = write_bag(tmp_path / "bag", make, content)
    file = path if path.is_file() else next(one for one in path.iterdir() if one.suffix != ".yaml")
    whole = file.read_bytes()
    scans = list(read(path))
    for kept in (0.01, 0.3, 0.9):
        file.write_bytes(whole[: int(kept * len(whole))])
        try:
            log = read(path)
            found = list(log)
        except ValueError as error:  # What is left holds nothing to map.
            assert str(error).startswith((f"{path}: ", f"{file}: ")) and "\n" not in str(error)
            continue
        assert 0 < len(found) <= len(scans) == 5
        for one, other in zip(found, scans):
            np.testing.assert_array_equal(one.endpoints, other.endpoints)
        assert any("messages were found in it" in note for note in log.notes)
        with pytest.raises(ValueError, match="messages were found in it"):
            list(read(path, strict=True))
    if path.is_dir():
        file.write_bytes(whole)
        for text in ("rosbag2_bagfile_information: {version: 5}", None):
            if text is None:
                (path / "metadata.yaml").unlink()
            else:
                (path / "metadata.yaml").write_text(text)
            assert len(list(read(path))) == 5
        file.unlink()
        with pytest.raises((ValueError, OSError)):
            read(path, format="rosbag")


def test_damage_in_the_middle_keeps_what_was_read(tmp_path: Path) -> None:
    make = Messages("ros1")
    content = [("/tf_static", START, make.tf(make.transform(START, "map", "sensor", [0, 0, 0], LEVEL)))]
    ranges = np.random.default_rng(1).uniform(1, 7, (100, 9000))
    content += [("/scan", START + i, make.laser(START + i, "sensor", row)) for i, row in enumerate(ranges)]
    path = write_bag(tmp_path / "bag", make, content, packed=True)
    damaged = bytearray(path.read_bytes())
    place = len(damaged) * 2 // 3
    damaged[place : place + 100] = bytes(100)
    path.write_bytes(bytes(damaged))
    with pytest.raises(ValueError, match="cannot be read as a ROS bag"):
        list(read(path))
    log = read(path, keep_going=True)
    assert 20 < len(list(log)) < 100
    assert list(log.skipped) == ["damaged bags"]


def test_what_cannot_be_chosen_is_listed(ros2: Messages, tmp_path: Path) -> None:
    fixed = ros2.tf(ros2.transform(START, "map", "sensor", [0, 0, 0], LEVEL))
    away = ros2.tf(ros2.transform(START, "earth", "laser", [0, 0, 0], LEVEL))
    scan, cloud = ros2.laser(START, "sensor", [1, 2]), ros2.cloud(START, "sensor", np.ones((2, 3)))
    image = ros2.image(START, "sensor", np.ones((2, 2)), "16UC1")
    odometry = ros2.odometry(START, "odom", "wheel", [0, 0, 0], LEVEL)
    kitti = tmp_path / "kitti.txt"
    kitti.write_text("1 0 0 0 0 1 0 0 0 0 1 0\n")
    two = {"/tf_static": fixed, "/scan": scan, "/points": cloud, "/words": ros2.text("a")}
    cases: list[tuple[dict[str, Any], dict[str, Any], type[Exception], str]] = [
        ({"/words": ros2.text("a")}, {}, ValueError, r"no LaserScan, .* in it, found /words \(String\)"),
        (two, {"topic": "/nothing"}, ValueError, "no topic /nothing, expected one of /points"),
        (two, {"topic": "/words"}, ValueError, "topic /words is of type std_msgs/msg/String, expected"),
        (two, {"topic": "scan", "fixed_frame": "moon"}, ValueError, "no transform between sensor and moon"),
        (two, {"topic": "scan", "camera": "1,1,1,1"}, TypeError, "camera: /scan has no depth images"),
        (two, {"topic": "scan", "odometry": "/o"}, ValueError, "no Odometry in /o, expected one of none"),
        (two, {"topic": "scan", "odometry": "/o", "fixed_frame": "map"}, TypeError, "expected one of them"),
        (two, {"topic": "scan", "trajectory": str(kitti)}, ValueError, "kitti.txt: has no times"),
        ({"/scan": scan}, {}, ValueError, "no transform to sensor, the frame of /scan: there is no /tf"),
        ({"/scan": ros2.laser(START, "laser", [1]), "/tf_static": away}, {}, ValueError,
         "laser is connected with none of map, odom, world .* expected fixed_frame as one of earth, laser"),
        ({"/depth": image, "/tf_static": fixed}, {}, ValueError, "no CameraInfo of 2 x 2 pixels beside"),
        ({"/depth": image, "/tf_static": fixed}, {"camera": "1"}, ValueError, "expected fx,fy,cx,cy"),
        ({"/scan": scan, "/odom": odometry}, {"odometry": "/odom"}, ValueError,
         "no transform between sensor, the frame of /scan, and wheel, of which /odom has the poses"),
    ]  # fmt: skip
    for number, (content, options, kind, message) in enumerate(cases):
        path = write_bag(tmp_path / str(number), ros2, [(t, START, m) for t, m in content.items()])
        with pytest.raises(kind, match=message) as caught:
            read(path, **options)
        assert "\n" not in str(caught.value)
    assert len(list(read(tmp_path / "1", topic="scan"))) == 1
    alone = read(tmp_path / "1")  # A laser comes before a cloud.
    assert alone.uses.startswith("/scan (LaserScan")
    assert alone.notes == ["--topic would take another sensor than /scan: /points (PointCloud2)"]


@pytest.mark.parametrize(
    "change, message",
    [
        ({"width": 90}, r"the cloud has 32 bytes, expected 1440 for 1 rows"),
        ({"point_step": 9}, "the cloud has 32 bytes"),
        ({"fields": []}, "the cloud has no field x and no y and no z, expected x, y and z, found none"),
    ],
)
def test_clouds_that_contradict_themselves(
    ros2: Messages, change: dict[str, Any], message: str, tmp_path: Path
) -> None:
    cloud = ros2.cloud(START, "sensor", np.ones((2, 3)))
    if "width" in change:
        change = {**change, "row_step": 1440}
    for name, value in change.items():
        object.__setattr__(cloud, name, value)
    with pytest.raises(ValueError, match=f"/points: message 0: {message}"):
        standing(ros2, "/points", [cloud], tmp_path)


def test_images_that_contradict_themselves(ros2: Messages, tmp_path: Path) -> None:
    image = ros2.image(START, "sensor", np.ones((4, 5)), "16UC1")
    object.__setattr__(image, "height", 40)
    with pytest.raises(ValueError, match="the image has 40 bytes, expected 400 for 40 rows of 10 bytes"):
        standing(ros2, "/depth", [image], tmp_path, camera="1,1,1,1")


def test_without_the_extra_it_is_named(ros2: Messages, tmp_path: Path) -> None:
    path = write_bag(tmp_path / "bag", ros2, [("/words", START, ros2.text("a"))])
    code = (
        "import sys; sys.modules['rosbags'] = None\nimport ndtree\n"
        f"try: ndtree.read({str(path)!r})\nexcept ImportError as error: print(error)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "pip install 'ndtree-mapping[ros]'" in done.stdout, done.stderr
    assert done.stdout.count("\n") == 1


# --- Real recordings --------------------------------------------------------------------------------


def test_recorded_depth_images_lie_where_the_folder_has_them(recordings: Path, tmp_path: Path) -> None:
    """The same images from a folder and from a bag whose poses are in /tf."""
    image = pytest.importorskip("PIL.Image")
    folder = recordings / "kinect_tum_fr1_rpy" / "tum_format"
    in_folder = list(islice(read(folder), 3))
    make = Messages("ros1")
    trajectory = read_trajectory(folder / "groundtruth.txt")
    content = [
        ("/tf", stamp, make.tf(make.transform(stamp, "world", "camera", position, quaternion)))
        for stamp, position, quaternion in zip(
            trajectory.stamps, trajectory.positions, trajectory.quaternions
        )
        if abs(stamp - in_folder[1].stamp) < 2
    ]
    info = make.camera_info(0, "camera", (480, 640), (525, 525, 319.5, 239.5))
    content.append(("/depth/camera_info", START, info))
    rows = [line.split() for line in (folder / "depth.txt").read_text().splitlines() if line[0] != "#"]
    for stamp, name in rows[:3]:
        values = np.asarray(image.open(folder / name)).astype(np.float32) / 5000
        message = make.image(float(stamp), "camera", values, "32FC1")
        content.append(("/depth/image", float(stamp), message))
    log = read(write_bag(tmp_path / "bag", make, content))
    scans = list(log)
    assert len(scans) == len(in_folder) == 3
    for one, other in zip(scans, in_folder):
        assert one.stamp == pytest.approx(other.stamp, abs=1e-6)
        np.testing.assert_allclose(one.endpoints, other.endpoints, atol=1e-4)
        np.testing.assert_allclose(one.origin, other.origin, atol=1e-5)


def test_recorded_laser_scans_make_the_map_of_their_log(recordings: Path, tmp_path: Path) -> None:
    """The same scans from a CARMEN log and from a bag."""
    log = list(read(recordings / "laser2d_intel" / "intel-corrected.log.gz").select(every=10))
    make, content = Messages("mcap"), []
    for i, scan in enumerate(log):
        way = scan.endpoints - scan.origin
        ahead = np.arctan2(*way[len(way) // 2][::-1])
        ranges = np.where(scan.returned, np.linalg.norm(way, axis=1), np.inf)
        angles = np.unwrap(np.arctan2(way[:, 1], way[:, 0])) - ahead
        step = (angles[-1] - angles[0]) / (len(angles) - 1)
        turn = [0, 0, np.sin(ahead / 2), np.cos(ahead / 2)]
        content.append(("/tf", i, make.tf(make.transform(i, "map", "laser", [*scan.origin, 0], turn))))
        laser = make.laser(i, "laser", ranges, angle_min=angles[0], angle_increment=step, range_max=81.83)
        content.append(("/scan", i, laser))
    maps = []
    for scans in (log, read(write_bag(tmp_path / "bag", make, content))):
        maps.append(ndtree.AdaptiveMap(dim=2))
        for scan in scans:
            scan.insert_into(maps[-1], max_range=20)
    points = np.concatenate([scan.endpoints[scan.returned] for scan in log])
    same = maps[0].state(points) == maps[1].state(points)
    assert len(points) > 10_000 and same.mean() > 0.995
