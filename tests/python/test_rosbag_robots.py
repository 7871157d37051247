# SPDX-License-Identifier: BSD-3-Clause
"""Bags as robots leave them: poses from elsewhere, mounts by hand, several sensors, sweeps, odd files."""

from __future__ import annotations

import math
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags")
pytest.importorskip("scipy")

from bags import LEVEL, START, Messages, write_bag
from scipy.spatial import transform as spatial

from ndtree.logs import read
from ndtree.logs.poses.pose import mount_of
from ndtree.logs.ros.messages.own import livox as decoded

Rotation = spatial.Rotation
POINTS = np.array([[1.0, 2.0, 0.5], [3.0, -1.0, 0.25], [-2.0, 0.5, 1.0]], dtype=np.float32)


def at(t: float) -> tuple[np.ndarray, Any]:
    """Where a body is that drives a curve, t seconds after the start."""
    return np.array([0.5 * t, 0.1 * t * t, 0.2]), Rotation.from_euler("zyx", [0.6 * t, 0.05, -0.03])


STAMPS = np.arange(0, 3, 0.05)


def pose_message(make: Messages, kind: str, t: float) -> Any:
    place, turn = at(t)
    if kind == "TransformStamped":
        return make.transform(START + t, "world", "", place, turn.as_quat())
    pose = make.pose(place, turn.as_quat())
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
        content.append(ros2.moved(START + t, "odom", "base_link", [t, 0, 0]))
    content.append(ros2.fixed(START, "base_link", "horn", [0.5, 0, 0.3]))
    content.append(("/scan", START + 1, ros2.laser(START + 1, "laser", [1.0, 2.0])))
    path = write_bag(tmp_path / "bag", ros2, content)
    with pytest.raises(
        ValueError, match=r"(?s)base_frame .* mount X,Y,Z.*the frames of /tf are base_link, horn, odom"
    ):
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
    content.append(ros2.moved(START + 2.9, "map", "odom", [0, 0, 0], at=START))
    content.append(ros2.fixed(START, "odom", "odom_combined", [0, 0, 0]))
    assert read(write_bag(tmp_path / "late", ros2, content)).fixed_frame == "odom"


def test_a_mount_that_was_said_only_once_holds(ros2: Messages, tmp_path: Path) -> None:
    """In /tf, not /tf_static; one that changes is no mount."""
    for turns in (False, True):
        content: list[tuple[str, float, Any]] = []
        for t in STAMPS:
            content.append(ros2.moved(START + t, "odom", "base", [t, 0, 0]))
        for t in (0.0, 0.3):
            content.append(ros2.moved(START + t, "base", "laser", [0.2, t if turns else 0, 0]))
        for t in (0.1, 1.0, 2.0, 2.5):
            content.append(("/scan", START + t, ros2.laser(START + t, "laser", [1.0, 2.0])))
        log = read(write_bag(tmp_path / str(turns), ros2, sorted(content, key=lambda one: one[1])))
        scans = list(log)
        assert len(scans) == (1 if turns else 4)
        assert any("base to laser" in note for note in log.notes) == (not turns)
        if not turns:
            np.testing.assert_allclose([scan.origin[0] for scan in scans], [0.3, 1.2, 2.2, 2.7], atol=1e-5)


def test_a_sensor_that_stands_still(ros2: Messages, tmp_path: Path) -> None:
    content = [("/scan", START + t, ros2.laser(START + t, "laser", [1.0] * (t + 2))) for t in range(4)]
    path = write_bag(tmp_path / "bag", ros2, content)
    with pytest.raises(ValueError, match=r"(?s)there is no /tf, nor any other poses, expected .* still"):
        read(path)
    scans = list(read(path, still=True))
    assert [len(scan) for scan in scans] == [2, 3, 4, 5] and not np.any([scan.origin for scan in scans])


# --- Several sensors --------------------------------------------------------------------------------


def test_several_sensors_come_in_the_order_of_time(ros2: Messages, tmp_path: Path) -> None:
    content: list[tuple[str, float, Any]] = []
    for name, x in (("front", 0.3), ("rear", -0.3)):
        content.append(ros2.fixed(START, "odom", name, [x, 0, 0]))
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
    for end, said in (
        (20, "expected a frame of"),
        (40, "expected a whole CustomMsg"),
        (-1, "a whole Custom"),
    ):
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


@pytest.mark.parametrize("above", ["kept", "clipped", "infinite", "none"])
def test_noise_around_range_max_is_no_surface(above: str, ros2: Messages, tmp_path: Path) -> None:
    """Of a simulator that adds it where nothing was hit, and what becomes of it above range_max."""
    generator = np.random.default_rng(1)
    rows = []
    for i in range(10):
        noise = generator.normal(0, 0.01, 1200)
        ranges = np.where(np.arange(1200) % 2, 5.0, 3.0) + (-np.abs(noise) if above == "none" else noise)
        if above in ("clipped", "infinite"):
            ranges[ranges > 5.0] = 5.0 if above == "clipped" else np.inf
        rows.append(("/scan", START + i, ros2.laser(START + i, "a", ranges, range_max=5.0)))
    log = read(write_bag(tmp_path / "bag", ros2, rows), still=True)
    for scan in log:
        lengths = np.linalg.norm(scan.endpoints, axis=1)
        assert np.count_nonzero(scan.returned) == 600 and lengths[scan.returned].max() < 3.1
        np.testing.assert_allclose(lengths[~scan.returned], 5.0)
    assert any("within 0.04" in note and "of range_max mean that nothing" in note for note in log.notes)


@pytest.mark.parametrize(
    "count, angles, is_said",
    [
        (180, (-math.pi, math.pi, math.pi / 180), True),  # Ranges were filtered, the header was not.
        (360, (-math.pi, math.pi, -math.pi / 180), True),  # Turning the other way.
        (360, (-math.pi, math.pi, math.pi / 180), False),  # One less than both ends have.
        (361, (-math.pi, math.pi, math.pi / 180), False),
        (360, (math.pi, -math.pi, -math.pi / 180), False),
        (897, (0.0, 2 * math.pi, 2 * math.pi / 897.6), False),
    ],
)
def test_angles_of_another_number_of_ranges_are_said(
    count: int, angles: tuple[float, float, float], is_said: bool, ros2: Messages, tmp_path: Path
) -> None:
    begin, end, turn = angles
    given = {"angle_min": begin, "angle_max": end, "angle_increment": turn}
    message = ros2.laser(START, "a", np.full(count, 3.0), **given)
    log = read(write_bag(tmp_path / "bag", ros2, [("/scan", START, message)]), still=True)
    (scan,) = log
    at = begin + turn * np.arange(count)
    np.testing.assert_allclose(scan.endpoints, 3 * np.stack([np.cos(at), np.sin(at)], axis=1), atol=1e-3)
    assert any("in 1 of 1 messages angles are for another number" in note for note in log.notes) == is_said


def test_angles_in_degrees_are_refused(ros2: Messages, tmp_path: Path) -> None:
    given = {"angle_min": -180.0, "angle_max": 179.0, "angle_increment": 1.0}
    message = ros2.laser(START, "a", np.full(360, 3.0), **given)
    log = read(write_bag(tmp_path / "bag", ros2, [("/scan", START, message)]), still=True)
    with pytest.raises(ValueError, match=r"1 rad of 360 ranges: 57\.3 turns, expected radians"):
        list(log)


def test_an_infinite_range_max_needs_a_limit(ros2: Messages, tmp_path: Path) -> None:
    message = ros2.laser(START, "a", [1, np.inf, 3], range_max=np.inf)
    path = write_bag(tmp_path / "bag", ros2, [("/scan", START, message)])
    log = read(path, still=True)
    (scan,) = log
    assert np.isnan(scan.endpoints[1]).all()
    assert any("1 beam met nothing, but range_max is infinite" in note for note in log.notes)
    log = log.ruled(no_return_range=6.0)
    (scan,) = log
    assert np.linalg.norm(scan.endpoints[1]) == pytest.approx(6) and not scan.returned[1]
    assert not any("range_max is infinite" in note for note in log.notes)
