# SPDX-License-Identifier: BSD-3-Clause
"""Bags that the library rosbags writes are read with the end points that SciPy computes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags")
pytest.importorskip("scipy")

from bags import LEVEL, START, Messages, write_bag
from drives import SCAN_TIMES, Drive, laser_points, standing
from scipy.spatial import transform as spatial

import ndtree
from ndtree.logs import read
from ndtree.logs.ros.messages.own import multi_echo

Rotation = spatial.Rotation


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


def test_ranges_follow_rep_117(make: Messages, tmp_path: Path) -> None:
    ranges = np.array([1, np.inf, -np.inf, np.nan, 0.05, 9, 0.1, 8, 0], dtype=np.float32)
    scans = [make.laser(START, "sensor", ranges, range_min=0.1, range_max=m) for m in (8.0, np.inf, 0.0)]
    one, endless, none = standing(make, "/scan", scans, tmp_path)
    lengths = np.linalg.norm(one.endpoints, axis=1)
    np.testing.assert_allclose(lengths, [1, 8, *[np.nan] * 4, 0.1, 8, np.nan], rtol=1e-6)
    np.testing.assert_array_equal(one.returned, [1, 0, 0, 0, 0, 0, 1, 1, 0])
    assert np.isnan(endless.endpoints[1]).all() and not endless.returned[1] and endless.returned[5]
    np.testing.assert_array_equal(none.endpoints, endless.endpoints)  # 0 is no largest range.
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
        found = multi_echo(data, is_ros1=is_ros1)
        assert found.header.frame_id == frame and found.beams == len(ranges)
        for name in ("angle_min", "angle_increment", "time_increment", "scan_time", "range_min", "range_max"):
            assert getattr(found, name) == pytest.approx(getattr(message, name))
        for number, beam in enumerate(message.ranges):
            np.testing.assert_array_equal(found.echoes[found.numbers == number], beam.echoes)
        for cut in range(5, len(data), 3):
            try:  # What is cut off behind the echoes, among the intensities, is not missed.
                part = multi_echo(data[:-cut], is_ros1=is_ros1)
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
            ros2.fixed(START, "odom", "laser", [0, 0, 0], turn),
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
    content.insert(0, ros2.fixed(0, "map", "beacon", [1, 2, 0], beacon.as_quat(), at=START))
    stamp = SCAN_TIMES[2]
    content.append(("/scan", stamp, ros2.laser(stamp, "sensor", [1, 2, 3])))
    (scan,) = read(write_bag(tmp_path / "bag", ros2, content), fixed_frame="beacon")
    points = drive.in_map(stamp, laser_points(content[-1][2]))
    np.testing.assert_allclose(scan.endpoints, beacon.inv().apply(points - [1, 2, 0])[:, :2], atol=1e-6)


def test_transforms_that_are_none_are_passed_over(ros2: Messages, tmp_path: Path) -> None:
    drive = Drive(planar=True)
    content = drive.transforms(ros2)
    for position, turn in (([np.nan, 0, 0], LEVEL), ([0, 0, 0], [0, 0, 0, 0])):
        content.append(ros2.moved(START + 0.15, "odom", "base", position, turn, at=START))
    content.append(("/scan", START, ros2.laser(START + 0.13, "sensor", [1, 2])))
    (scan,) = read(write_bag(tmp_path / "bag", ros2, content))
    np.testing.assert_allclose(scan.origin, drive.in_map(START + 0.13, np.zeros(3))[:2], atol=1e-6)
