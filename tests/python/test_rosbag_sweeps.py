# SPDX-License-Identifier: BSD-3-Clause
"""Sensors that move while they measure, and mounts and clocks that are found by motions."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags")
pytest.importorskip("scipy")

from bags import START, Messages, write_bag
from scipy.spatial import transform as spatial

from ndtree.logs import read
from ndtree.logs.ros.options import BagOptions
from ndtree.logs.ros.reading import turn_during

Rotation = spatial.Rotation
POINTS = np.array([[1.0, 2.0, 0.5], [3.0, -1.0, 0.25], [-2.0, 0.5, 1.0]], dtype=np.float32)


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
    ghosts: bool = False,
) -> Path:
    """A turning laser in a room whose beams are measured one after the other.

    With `ghosts` an unknown second sensor has the same topic.
    """
    generator = np.random.default_rng(3)

    def where(t: float) -> tuple[float, float, float]:
        return 0.4 * t, 0.1 * t, 0.9 * t

    content: list[tuple[str, float, Any]] = []
    for t in np.arange(0, 6.5, 0.02):
        x, y, yaw = where(t)
        turn = Rotation.from_euler("z", yaw).as_quat()
        content.append(make.moved(START + t, "odom", "laser", [x, y, 0], turn))
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
        if ghosts:
            ghost = make.laser(begin, "ghost", generator.uniform(1, 8, 50), time_increment=0.02)
            content += [("/scan", stamp + 0.001 * i, ghost) for i in (1, 2)][: 1 + int(begin > 5)]
    return write_bag(path, make, sorted(content, key=lambda one: one[1]))


def off_walls(scans: Any) -> float:
    """How far end points are from the walls, 95 % of them less [m]."""
    points = np.concatenate([scan.endpoints for scan in scans])
    return float(np.percentile(np.min([abs(points[:, axis] - side) for side, axis in SIDES], axis=0), 95))


def test_a_scan_time_counts_if_the_log_bears_it_out(ros2: Messages, tmp_path: Path) -> None:
    log = read(sweeps(ros2, tmp_path / "swept", said=False))
    assert off_walls(log) < 0.012 and any("scans agree better this way" in note for note in log.notes)
    at_once = read(sweeps(ros2, tmp_path / "at once", said=False, sweep=0.0))
    assert off_walls(at_once) < 0.012 and not at_once.notes


@pytest.mark.parametrize("reversed_, at_end", [(False, False), (True, True), (True, False), (False, True)])
def test_each_beam_has_the_pose_of_its_time_however_the_driver_means_it(
    ros2: Messages, reversed_: bool, at_end: bool, tmp_path: Path
) -> None:
    path = sweeps(ros2, tmp_path / "bag", reversed_=reversed_, at_end=at_end)
    log = read(path)
    assert off_walls(log) < 0.012
    assert any("scans agree better this way than as their messages say" in note for note in log.notes) == (
        reversed_ or at_end
    )
    assert off_walls(read(path, deskew=False)) > 0.05


def test_another_sensor_in_the_topic_does_not_confuse_the_times(ros2: Messages, tmp_path: Path) -> None:
    options: dict[str, Any] = {"reversed_": True, "at_end": True}
    alone = read(sweeps(ros2, tmp_path / "alone", **options))
    shared = read(sweeps(ros2, tmp_path / "shared", ghosts=True, **options))
    assert off_walls(alone) < 0.012 and off_walls(shared) < 0.012
    assert len(alone.notes) == 1 and "the first one at the stamp" in shared.notes[0]


def test_a_fast_sensor_has_an_origin_for_each_beam(ros2: Messages, tmp_path: Path) -> None:
    content: list[tuple[str, float, Any]] = []
    for t in np.arange(0, 2, 0.1):
        content.append(ros2.moved(START + t, "odom", "laser", [10 * t, 0, 0]))
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
        content.append(ros2.moved(START + t, "odom", "lidar", [10 * t, 0, 0]))
    since = np.array([0.0, 0.025, 0.1])
    plain = ros2.cloud(START + 1, "lidar", POINTS)
    cloud = ros2.with_times(plain, POINTS, times(since).astype(kind))
    (scan,) = read(write_bag(tmp_path / "bag", ros2, [*content, ("/points", START + 1, cloud)]))
    expected = POINTS + np.stack([10 + 10 * since, np.zeros(3), np.zeros(3)], axis=1)
    np.testing.assert_allclose(scan.endpoints, expected, atol=2e-4)


# --- Finding the mount ------------------------------------------------------------------------------


def winding(t: float) -> tuple[float, float, float]:
    return 1.5 * np.sin(0.7 * t), -1 + np.cos(0.5 * t), 1.2 * np.sin(0.9 * t) + 0.3 * t


def straight(t: float) -> tuple[float, float, float]:
    return 0.2 * t - 1.4, 0.1, 0.0


def mounted(
    ros2: Messages, path: Path, body: Callable[[float], tuple[float, float, float]], sweep: float, side: int
) -> Path:
    """A bag of a body in a room whose laser sits askew on it or hangs, and whose clock is off."""
    generator = np.random.default_rng(7)
    x, y, yaw, offset = MOUNT
    angles = np.linspace(-np.pi, np.pi, 120, endpoint=False)
    content: list[tuple[str, float, Any]] = []
    for t in np.arange(0, 14, 0.02):
        bx, by, turn = body(t)
        quaternion = Rotation.from_euler("z", turn).as_quat()
        pose = ros2.pose([bx, by, 0], quaternion)
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
            stamp, "laser", ranges, angle_min=-np.pi, angle_increment=np.pi / 60,
            time_increment=sweep / (len(angles) - 1), scan_time=0.0, range_max=20.0,
        )  # fmt: skip
        content.append(("/scan", stamp, laser))
    return write_bag(path, ros2, sorted(content, key=lambda one: one[1]))


#: x, y [m], yaw [rad] and time [s].
MOUNT = 0.12, -0.07, 2.0, 0.06


@pytest.mark.parametrize("sweep, side", [(0.0, 1), (0.09, -1)])
def test_the_mount_is_found_by_motions(ros2: Messages, sweep: float, side: int, tmp_path: Path) -> None:
    pytest.importorskip("typer")
    from calling import cli

    from ndtree.logs.ros.rosbag import RosbagLog
    from ndtree.tuning.calibration.mount import find_mount

    *_, yaw, offset = MOUNT
    path = mounted(ros2, tmp_path / "bag", winding, sweep, side)
    found = find_mount(RosbagLog(str(path), BagOptions(poses="/pose", mount="0,0,0")))
    assert [found.x, found.y, found.yaw, found.time_offset] == pytest.approx(MOUNT, abs=0.01)
    assert abs(found.others[1]) == pytest.approx(0 if side > 0 else np.pi, abs=1e-6)
    assert not found.untold and max(found.sigma) < 0.02 and found.flags.startswith("--mount 0.1")
    assert off_walls(read(path, poses="/pose", mount=found.mount, time_offset=found.time_offset)) < 0.03
    if sweep:  # By the command the same.
        report = tmp_path / "found.json"
        call = ["calibrate", str(path), "--find-mount", "--poses", "/pose", "--json", str(report)]
        done = cli(*call)
        assert done.exit_code == 0 and "fit each other best with --mount" in done.stdout
        assert json.loads(report.read_text())["time_offset"] == pytest.approx(offset, abs=0.01)
        return
    given = f"0.1,-0.1,0.5,0,0,{yaw - 0.3}"
    again = find_mount(RosbagLog(str(path), BagOptions(poses="/pose", mount=given, time_offset=0.05)))
    assert again.yaw == pytest.approx(yaw, abs=0.01) and again.others[0] == 0.5
    assert again.time_offset == pytest.approx(offset, abs=0.01)


@pytest.mark.parametrize("side", [1, -1])
def test_what_a_straight_drive_does_not_tell_of_a_mount_stays_as_given(
    ros2: Messages, side: int, tmp_path: Path
) -> None:
    """Nor which way is up, and so where a sensor looks that does not look along the way."""
    from ndtree.logs.ros.rosbag import RosbagLog
    from ndtree.tuning.calibration.mount import find_mount

    path = mounted(ros2, tmp_path / "bag", straight, 0.0, side)
    found = find_mount(RosbagLog(str(path), BagOptions(poses="/pose", mount="0.3,0.2,1.9", time_offset=0.01)))
    assert found.untold == ["x", "y", "yaw", "time"]
    assert "not sure of x, y, yaw and time, left as given" in str(found)
    assert [found.x, found.y, found.yaw, found.time_offset] == pytest.approx([0.3, 0.2, 1.9, 0.01])


def test_of_a_sensor_that_stands_it_does_not_matter_when_a_beam_was_measured(
    ros2: Messages, tmp_path: Path
) -> None:
    """Even if its messages say what cannot be: that a scan lasts longer than the next one takes to come."""
    content = [
        ("/scan", START + t, ros2.laser(START + t, "laser", [2.0] * 90, time_increment=0.01))
        for t in np.arange(0, 2, 0.1)
    ]
    log = read(write_bag(tmp_path / "bag", ros2, content), still=True)
    assert len(list(log)) == 20 and log.notes == []


@pytest.mark.parametrize("turn", [0.0, 0.4, -3.0])
@pytest.mark.parametrize("upright", [1, -1])
def test_how_far_poses_turn_a_sensor_during_a_scan(turn: float, upright: int) -> None:
    """However it is mounted; all of that many degrees instead of radians is told."""
    at = np.linspace(-2, 2, 361)
    local = np.c_[np.cos(at), np.sin(at), 0 * at] * np.linspace(0.2, 9, 361)[:, None]
    by = upright * at + np.linspace(0, turn, 361)
    ways = np.c_[np.cos(by), np.sin(by), 0 * at] * np.linspace(0.2, 9, 361)[:, None]
    origins = np.c_[at, at, at]
    assert turn_during(local.astype(np.float32), origins + ways, origins) == pytest.approx(
        abs(turn), abs=1e-3
    )
