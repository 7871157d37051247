# SPDX-License-Identifier: BSD-3-Clause
"""Of a lidar, a wrong mount, clock, scale or reading of poses is told, and what mends it; right ones not."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rosbags")

TOOLS = Path(__file__).resolve().parents[2] / "tools"
if not (TOOLS / "trials").exists():
    pytest.skip("the tools are not beside the tests", allow_module_level=True)
sys.path.insert(0, str(TOOLS))

from lidar_drives import beams, measured

import ndtree
from ndtree import Scan
from ndtree.alignment.patches import turn_of, turned_by
from ndtree.alignment.surfaces import Cloud
from ndtree.logs.poses.pose import matrices_of, mount_of, quaternions_of
from ndtree.tuning.setup import setup_error
from ndtree.tuning.setup_error import SetupError
from trial import bag, worlds
from trial import setup_in_space as setup_trials
from trial.capabilities import Trial
from trial.scene import Floats
from trial.setup_in_space import _turned, driven

TIMES = 0.1 * np.arange(60)
CAMERA = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
Poses = Callable[[Floats], Floats]


@pytest.fixture(scope="module")
def drive() -> tuple[Poses, list[Floats]]:
    """True poses of the sensor at times, and what it measures at `TIMES` in its own frame.

    The row of trials has other drives.
    """
    rng = np.random.default_rng(14)
    world = worlds.chamber(rng)
    poses = driven(world, rng)
    return poses, measured(world.scene, poses(TIMES), rng)


def found_in(told: Floats, clouds: list[Floats], *, per_beam: bool = False) -> SetupError | None:
    """As `ndtree.first_look` looks at a log; `per_beam`: each beam has its origin, as in swept clouds."""
    scans = []
    for T, points, t in zip(told, clouds, TIMES):
        origin = np.tile(T[:3, 3], (len(points), 1)) if per_beam else T[:3, 3]
        scans.append(Scan(points @ T[:3, :3].T + T[:3, 3], origin, stamp=float(t), rotation=T[:3, :3]))
    return setup_trials.found_in(scans)


def mount(x: float, y: float, roll: float, pitch: float, yaw: float) -> Floats:
    result = _turned(*np.radians([roll, pitch, yaw]))
    result[:2, 3] = x, y
    return result


@pytest.mark.parametrize("centimetres", [0.0, 3.0])
def test_what_is_right_is_not_told_of(drive: tuple[Poses, list[Floats]], centimetres: float) -> None:
    """Each pose errs by itself, half a degree in roll and pitch with it."""
    rng = np.random.default_rng(1)
    told = drive[0](TIMES)
    for T in told if centimetres else ():
        T[:3, 3] += rng.normal(0, centimetres / 100, 3)
        T[:3, :3] = T[:3, :3] @ _turned(*np.radians(rng.normal(0, 0.5, 3)))[:3, :3]
    assert found_in(told, drive[1]) is None


@pytest.mark.parametrize("degrees", [0, 8])
def test_beams_without_echo_at_the_largest_range_say_nothing(
    drive: tuple[Poses, list[Floats]], degrees: float
) -> None:
    """Such ends lie on a sphere that moves with the sensor, and fit each other however it moved."""
    told = drive[0](TIMES) @ mount(0, 0, 0, 0, -degrees)
    silent = beams()[beams()[:, 2] > -0.2]
    rng = np.random.default_rng(2)
    farthest = 0.5 + max(np.linalg.norm(points, axis=1).max() for points in drive[1])
    ends = [silent * (farthest + rng.normal(0, 0.01, (len(silent), 1))) for _ in TIMES]
    found = found_in(told, [np.concatenate(both) for both in zip(drive[1], ends)])
    assert found is None if degrees == 0 else found is not None and found.kind == "yaw"


def test_half_a_turn_is_no_rest() -> None:
    for axis in (*np.eye(3), np.array([0.6, -0.8, 0.0])):
        for angle in (0.0, 1e-7, 3.0, math.pi - 1e-8, math.pi):
            assert np.linalg.norm(turn_of(turned_by(angle * axis))) == pytest.approx(angle, abs=1e-6)


@pytest.mark.parametrize(
    ("kind", "wrong", "values"),
    [
        ("yaw", mount(0, 0, 0, 0, -5), [math.radians(-5)]),
        ("tilt", mount(0, 0, 0, 4, 0), np.radians([0, 4])),
        ("tilt", mount(0, 0, -10, 20, 0), np.radians([-10, 20])),
        ("place", mount(0.25, -0.15, 0, 0, 0), [0.25, -0.15]),
    ],
)
def test_a_wrong_mount_is_told_and_mended(
    drive: tuple[Poses, list[Floats]], kind: str, wrong: Floats, values: Floats
) -> None:
    """Its poses say that the sensor sits in the robot's middle, and it is mounted otherwise."""
    told = drive[0](TIMES) @ np.linalg.inv(wrong)
    found = found_in(told, drive[1])
    assert found is not None and found.kind == kind, found
    off = 0.1 if kind == "tilt" else 0.25
    assert np.linalg.norm(np.subtract(found.values, values)) < off * np.linalg.norm(values)
    assert "mount" in str(found)
    x, y = found.values if kind == "place" else (0.0, 0.0)
    roll, pitch = np.degrees(found.values) if kind == "tilt" else (0.0, 0.0)
    yaw = math.degrees(found.values[0]) if kind == "yaw" else 0.0
    left = found_in(told @ mount(x, y, roll, pitch, yaw), drive[1])
    assert left is None or np.linalg.norm(left.values) < off * np.linalg.norm(values), (
        "what was told mends it"
    )


def test_faults_are_told_where_each_beam_has_its_origin(drive: tuple[Poses, list[Floats]]) -> None:
    poses, clouds = drive
    true = poses(TIMES)
    assert found_in(true, clouds, per_beam=True) is None
    for kind, told in (
        ("clock", poses(TIMES - 0.15)),
        ("place", true @ np.linalg.inv(mount(0.25, -0.15, 0, 0, 0))),
        ("inverted", np.linalg.inv(true)),
    ):
        found = found_in(told, clouds, per_beam=True)
        assert found is not None and found.kind == kind, (kind, found)
        alike = found_in(told, clouds)
        assert alike is not None and found.values == pytest.approx(alike.values, rel=0.1, abs=1e-3)


@pytest.mark.parametrize("seconds", [-0.15, 0.15])
def test_a_wrong_clock(drive: tuple[Poses, list[Floats]], seconds: float) -> None:
    found = found_in(drive[0](TIMES - seconds), drive[1])
    assert found is not None and found.kind == "clock"
    assert found.values[0] == pytest.approx(seconds, rel=0.3) and "time_offset" in str(found)


def test_points_that_were_moved_into_the_map_before(drive: tuple[Poses, list[Floats]]) -> None:
    """They are seen from the poses, which are not where their frame begins."""
    told = drive[0](TIMES)
    moved = [points @ T[:3, :3].T + T[:3, 3] for points, T in zip(drive[1], told)]
    found = found_in(told, moved)
    assert found is not None and found.kind == "moved" and "points_in" in str(found)


@pytest.mark.parametrize("share", [0.9, 1.08])
def test_a_wrong_scale(drive: tuple[Poses, list[Floats]], share: float) -> None:
    found = found_in(drive[0](TIMES), [share * points for points in drive[1]])
    assert found is not None and found.kind == "scale"
    assert found.values[0] == pytest.approx(share - 1, rel=0.3)


def test_poses_that_are_read_in_another_way(drive: tuple[Poses, list[Floats]]) -> None:
    true, clouds = drive[0](TIMES), drive[1]
    wxyz = true.copy()
    wxyz[:, :3, :3] = matrices_of(quaternions_of(true[:, :3, :3])[:, [3, 0, 1, 2]])
    for kind, told in (
        ("inverted", np.linalg.inv(true)), ("wxyz", wxyz), ("axes", CAMERA @ true @ CAMERA.T)
    ):  # fmt: skip
        found = found_in(told, clouds)
        assert found is not None and found.kind == kind and "expected" in str(found), (kind, found)
    found = found_in(true, [points * [1, -1, 1] for points in clouds])
    assert found is not None and found.kind == "mirrored"
    yaws = np.unwrap(np.arctan2(true[:, 1, 0], true[:, 0, 0]))
    found = found_in(with_yaws(true, np.degrees(yaws)), clouds)
    assert found is not None and found.kind == "degrees" and "0.017453" in str(found)


def with_yaws(poses: Floats, yaws: Floats) -> Floats:
    """Of a level robot, at the same places."""
    result = poses.copy()
    result[:, :3, :3] = [_turned(0, 0, yaw)[:3, :3] for yaw in yaws]
    return result


@pytest.mark.parametrize(
    ("places", "ranges", "words"),
    [
        (1000, 1, "positions of poses were in mm: expected metres: multiply them by 0.001 (of t x y z"),
        (100, 1, "positions of poses were in cm: expected metres: multiply them by 0.01 (of t x y z"),
        (1, 1000, "points were in mm: expected metres: multiply them by 0.001"),
        (1, 1 / 0.0254, "points were in inches: expected metres: multiply them by 0.0254"),
        (1000, 1000, None),
    ],
)
def test_positions_and_points_in_other_units(
    drive: tuple[Poses, list[Floats]], places: float, ranges: float, words: str | None
) -> None:
    """Units that both share fit; a robot that stands while its poses do not tells no unit."""
    told = drive[0](TIMES)
    told[:, :3, 3] *= places
    found = found_in(told, [ranges * points for points in drive[1]])
    assert (found is None) if words is None else words in str(found)
    still = found_in(told, 60 * [ranges * drive[1][0]])
    assert still is None or still.kind not in ("unit", "degrees")


def test_a_sensor_that_hangs_upside_down_or_looks_aside_is_right(drive: tuple[Poses, list[Floats]]) -> None:
    """Where poses say so, however the sensor's own axes lie."""
    for turn in (mount(0, 0, 0, 89, 0), mount(0, 0, 0, 30, 140)):  # Half a turn: see below.
        clouds = [points @ turn[:3, :3] for points in drive[1]]
        assert found_in(drive[0](TIMES) @ turn, clouds) is None
        tilted = found_in(drive[0](TIMES) @ mount(0, 0, 0, -5, 0) @ turn, clouds)
        assert tilted is not None and tilted.kind == "tilt"


@pytest.mark.parametrize(
    ("turn", "values"),
    [
        (mount(0, 0, 0, 0, 0), [0.25, -0.15]),
        (mount(0, 0, 180, 0, 0), [0.25, -0.15]),
        (mount(0, 0, -90, 0, -90), [0.15, 0.25]),
    ],
)
def test_a_place_is_along_the_x_axis_and_to_its_left_seen_from_above(
    drive: tuple[Poses, list[Floats]], turn: Floats, values: list[float]
) -> None:
    """Of a lidar that stands, one that hangs, and one with the axes of a camera, x to the right."""
    told = drive[0](TIMES) @ np.linalg.inv(mount(0.25, -0.15, 0, 0, 0)) @ turn
    found = found_in(told, [points @ turn[:3, :3] for points in drive[1]])
    assert found is not None and found.kind == "place"
    assert np.linalg.norm(np.subtract(found.values, values)) < 0.1
    assert "along its x axis and to the left of that, seen from above" in str(found)


def test_a_sensor_that_is_the_other_way_up_than_told(drive: tuple[Poses, list[Floats]]) -> None:
    """Between a floor and a ceiling it looks like a mirrored one, too."""
    true, over = drive[0](TIMES), mount(0, 0, 180, 0, 0)
    hanging = [points @ over[:3, :3] for points in drive[1]]
    for told, clouds in ((true, hanging), (true @ over, drive[1])):
        found = found_in(told, clouds)
        assert found is not None and found.kind == "mirrored" and "180deg" in str(found)
        assert found_in(told @ over, clouds) is None, "what was told mends it"


@pytest.mark.parametrize("degrees", [90, 180, -90])
def test_a_sensor_that_looks_aside_or_back(drive: tuple[Poses, list[Floats]], degrees: float) -> None:
    told = drive[0](TIMES) @ mount(0, 0, 0, 0, -degrees)
    found = found_in(told, drive[1])
    assert found is not None and found.kind == "yaw" and "mount" in str(found)
    assert abs((math.degrees(found.values[0]) - degrees + 180) % 360 - 180) < 5
    assert found_in(told @ mount(0, 0, 0, 0, degrees), drive[1]) is None


def test_a_mount_that_is_turned_much_is_no_place_along_a_bend() -> None:
    """A place a radius aside explains as much as the turn's sine, but not its cosine."""
    words = Trial.of("setup_in_space", 4020).run()[1].words
    assert any("the sensor looked 8 degrees further to the" in one for one in words), words


def test_no_ground_is_needed(drive: tuple[Poses, list[Floats]]) -> None:
    told = drive[0](TIMES) @ mount(0, 0, 0, 0, -10)
    above = [points[points[:, 2] > 0] for points in drive[1]]
    found = found_in(told, above)
    assert found is not None and found.values == pytest.approx([math.radians(10)], rel=0.1)


def test_without_rotations_nothing_is_told() -> None:
    cloud = Cloud.of(Scan(np.zeros((3, 3)), np.zeros(3)))
    assert cloud is not None and not cloud.is_turned and setup_error([[cloud] * 40]) is None
    assert Cloud.of(Scan(np.zeros((0, 3)), np.zeros((0, 3)), rotation=np.eye(3))) is None
    assert setup_error([]) is None
    assert Cloud.of(Scan(np.zeros((3, 3)), np.zeros(3), rotation=np.full((3, 3), np.nan))) is None


def test_of_a_bag_the_option_that_is_told_mends_it(drive: tuple[Poses, list[Floats]], tmp_path: Path) -> None:
    """Through files: clouds of a sensor that is told to sit level, and looks down by 6 degrees."""
    times = 0.02 * np.arange(-2, 300)
    told = drive[0](times) @ mount(0, 0, 0, -6, 0)
    transforms = list(zip(times.tolist(), told[:, :3, 3], quaternions_of(told[:, :3, :3])))
    path = bag.write_clouds(tmp_path / "log", list(zip(TIMES.tolist(), drive[1])), transforms)
    log = ndtree.read(path)
    scan = next(iter(log))
    assert scan.rotation is not None and np.allclose(scan.rotation, told[2, :3, :3], atol=1e-4)
    found = ndtree.first_look(log.ruled(cut_off=None)).setup
    assert found is not None and found.kind == "tilt"
    roll, pitch = found.values
    option = f"0,0,0,{roll},{pitch},0"
    assert mount_of(option) is not None
    assert ndtree.first_look(ndtree.read(path, mount=option).ruled(cut_off=None)).setup is None
