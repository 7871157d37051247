# SPDX-License-Identifier: BSD-3-Clause
"""A lidar in a saved 3-D map, where gravity is known: tracked, lost, and found, on the right storey."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags")

from bags import START, Messages, write_bag
from calling import cli

import ndtree
from ndtree.live import Localizer
from ndtree.live.surroundings import InSpace, upright

Floats = np.ndarray
HEIGHT = 2.6


def storey(z: float, *things: tuple[float, float, float, float, float]) -> Floats:
    """Boxes (n, 2, 3) of a room of 8 x 5 m, and of things in it: x, y, width, depth and height."""
    boxes = [
        [[0, 0, -0.2], [8, 5, 0]], [[0, 0, HEIGHT], [8, 5, HEIGHT + 0.2]], [[-0.2, 0, 0], [0, 5, HEIGHT]],
        [[8, 0, 0], [8.2, 5, HEIGHT]], [[0, -0.2, 0], [8, 0, HEIGHT]], [[0, 5, 0], [8, 5.2, HEIGHT]],
        *([[x, y, 0], [x + w, y + d, h]] for x, y, w, d, h in things),
    ]  # fmt: skip
    result: Floats = np.array(boxes, dtype=float)
    result[..., 2] += z
    return result


THINGS = (1.0, 4.0, 0.6, 0.8, 1.5), (5.0, 0.1, 1.2, 0.5, 0.9), (3.0, 2.2, 0.3, 0.3, 2.0)
HOUSE = storey(0.0, *THINGS)


def pose_of(x: float, y: float, z: float, yaw: float, roll: float = 0.0, pitch: float = 0.0) -> Floats:
    def about(axis: int, by: float) -> Floats:
        c, s, turn = math.cos(by), math.sin(by), np.eye(3)
        i, j = (axis + 1) % 3, (axis + 2) % 3
        turn[i, i], turn[i, j], turn[j, i], turn[j, j] = c, -s, s, c
        return turn

    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = about(2, yaw) @ about(1, pitch) @ about(0, roll), (x, y, z)
    return pose


def seen(boxes: Floats, pose: Floats, seed: int = 0) -> Floats:
    """End points in the frame of a lidar of 16 rings."""
    around, up = np.meshgrid(np.radians(np.arange(0, 360, 2.0)), np.radians(np.linspace(-25, 20, 16)))
    ways = np.stack([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)], axis=-1).reshape(
        -1, 3
    )
    with np.errstate(divide="ignore"):
        planes = (boxes - pose[:3, 3])[:, None] / (ways @ pose[:3, :3].T)[None, :, None]
    enter, leave = planes.min(axis=2).max(axis=2), planes.max(axis=2).min(axis=2)
    ranges = np.where((enter > 0) & (enter < leave), enter, np.inf).min(axis=0)
    ranges = ranges + np.random.default_rng(seed).normal(0, 0.01, len(ranges))
    return (ways * ranges[:, None])[np.isfinite(ranges)]


def mapped(boxes: Floats, *heights: float) -> Any:
    m = ndtree.AdaptiveMap(dim=3, min_cell_size=0.1)
    for z in heights:
        for x in np.arange(0.8, 7.2, 0.4):
            pose = pose_of(x, 1.5 + 0.1 * x, z, 0.1)
            m.insert(seen(boxes, pose) @ pose[:3, :3].T + pose[:3, 3], pose[:3, 3])
    return m


def drive(z: float = 1.0) -> list[Floats]:
    """Poses that sway, as of a robot on soft tyres."""
    return [
        pose_of(x, 1.6 + 0.3 * math.sin(x), z, 0.3 * math.sin(2 * x), 0.05 * math.sin(5 * x), 0.04)
        for x in np.arange(1.0, 7.0, 0.15)
    ]


def followed(localizer: Localizer, boxes: Floats, poses: list[Floats], start: Floats) -> list[float]:
    """How far off it is by odometry that is 4 % too long, from another origin; inf while it is lost."""
    off, odometry = [], start.copy()
    for i, pose in enumerate(poses):
        step = np.linalg.inv(poses[max(i - 1, 0)]) @ pose
        step[:3, 3] *= 1.04
        odometry = odometry @ step
        found = localizer.track(seen(boxes, pose, i), odometry)
        assert found.covariance.shape == (4, 4) and np.linalg.eigvalsh(found.covariance).min() > 0
        np.testing.assert_allclose(found.map_odometry @ odometry, found.pose, atol=1e-12)
        np.testing.assert_allclose(found.map_odometry[2], [0, 0, 1, found.map_odometry[2, 3]])
        off.append(np.inf if found.is_lost else float(np.linalg.norm((found.pose - pose)[:3, 3])))
    return off


@pytest.fixture(scope="module")
def house() -> Any:
    return mapped(HOUSE, 1.0)


@pytest.mark.parametrize("guess", [(1.2, 1.5, 0.9, 0.1), (1.2, 1.5, 0.1), None])
def test_it_is_found_and_tracked_at_its_height(house: Any, guess: tuple[float, ...] | None) -> None:
    poses = drive()
    start = pose_of(-3.0, 7.0, 5.0, 1.0) @ poses[0]  # Odometry knows gravity, and nothing else.
    off = followed(Localizer(house, guess), HOUSE, poses, start)
    known = np.isfinite(off)
    assert known.all() if guess else not known[0] and known[len(off) // 2 :].all()
    assert np.max(np.array(off)[known]) < 0.12


def test_a_carried_one_is_lost_and_found(house: Any) -> None:
    poses = drive()
    off = followed(Localizer(house, (1.0, 1.8, 0.3)), HOUSE, poses[:8] + poses[22:], poses[0])
    # Odometry tells of the way that it is carried: here it does not.
    localizer, told = Localizer(house, (1.0, 1.8, 1.0, 0.3)), []
    for i, pose in enumerate(poses[:8] + poses[22:]):
        odometry = pose if i < 8 else poses[7] @ np.linalg.inv(poses[22]) @ pose
        found = localizer.track(seen(HOUSE, pose, i), odometry)
        told.append(np.inf if found.is_lost else float(np.linalg.norm((found.pose - pose)[:3, 3])))
    assert max(told[:8]) < 0.12 and localizer.times_lost == 1 and told[-1] < 0.12
    assert sum(0.15 < one < np.inf for one in told) <= 5, "before it can know"
    assert off[-1] < 0.12


def test_of_two_equal_storeys_none_is_told() -> None:
    boxes, above = np.concatenate([HOUSE, storey(HEIGHT + 0.2, *THINGS)]), 1.0 + HEIGHT + 0.2
    m, poses = mapped(boxes, 1.0, above), drive(above)
    for guess in (None, (1.0, 1.8, 0.3)):
        assert np.isinf(followed(Localizer(m, guess), boxes, poses[:20], poses[0])).all()
    assert max(followed(Localizer(m, (1.0, 1.8, above, 0.3)), boxes, poses[:20], poses[0])) < 0.12
    # Where one is higher, a guess without a height is as good as one with it.
    higher = np.concatenate([HOUSE, storey(HEIGHT + 0.2, *THINGS) * [1.0, 1.0, 1.3]])
    localizer = Localizer(mapped(higher, 1.0, 4.9), (1.2, 1.5, 0.1))
    assert max(followed(localizer, higher, drive(4.9)[:8], drive(4.9)[0])[4:]) < 0.15
    # One more box tells them apart.
    boxes = np.concatenate([boxes, storey(HEIGHT + 0.2, (6.8, 3.0, 0.8, 1.2, 1.2))])
    off = followed(Localizer(mapped(boxes, 1.0, above)), boxes, poses, poses[0])
    assert off[-1] < 0.12 and max(one for one in off if np.isfinite(one)) < 0.12


def test_in_another_house_it_is_never_found(house: Any) -> None:
    other = storey(0.0, (3.0, 0.2, 0.8, 0.8, 1.8), (6.0, 3.5, 0.5, 1.0, 1.0)) * [0.8, 1.3, 1.0]
    poses = [pose_of(0.8 * one[0, 3], one[1, 3], 1.0, 0.2) for one in drive()]
    assert np.isinf(followed(Localizer(house), other, poses, poses[0])).all()


def test_what_stands_upright_is_told_from_floors() -> None:
    rng = np.random.default_rng(2)
    wall = np.c_[np.full(300, 3.02), rng.uniform(-2, 2, 300), rng.uniform(0, 2, 300)]
    floor = np.c_[rng.uniform(-2.5, 2.5, (600, 2)), rng.normal(0, 0.02, 600)]
    floor[:, 2] += 0.1 * floor[:, 0]  # A ramp.
    stands = upright(np.concatenate([wall, floor, np.add(floor, [0.0, 0.0, 2.5])]))
    assert stands[:300].mean() > 0.9 and not stands[300:].any()
    assert upright(np.zeros((0, 3))).shape == (0,)


def test_a_tilted_lidar_says_what_a_level_one_says(house: Any) -> None:
    around, pose = InSpace(house), pose_of(3.0, 1.8, 1.0, 0.4, 0.3, -0.2)
    level, ends = around.seen(seen(HOUSE, pose), pose)
    np.testing.assert_allclose(level, pose_of(3.0, 1.8, 1.0, 0.4), atol=1e-12)
    right = around.evidence(level, ends)
    assert right.mean > -0.3 and right.known > 0.9
    for off in ((0.5, 0, 0, 0), (0, -0.5, 0, 0), (0, 0, 0.8, 0), (0, 0, 0, 0.3)):
        assert around.evidence(level @ pose_of(*off), ends).total < right.total - 10
    assert around.evidence(pose_of(1e3, 0, 0, 0), ends).known == 0.0


def test_a_lidar_whose_x_axis_is_steep_has_a_heading(house: Any) -> None:
    mounted = pose_of(0, 0, 0, 0.5, 0.0, -math.pi / 2)  # x is up.
    around, poses = InSpace(house), [pose @ mounted for pose in drive()]
    levels = [around.seen(np.zeros((0, 3)), pose)[0] for pose in poses]
    turned = [pose[:2, :2].T @ level[:2, :2] for pose, level in zip(drive(), levels)]
    assert np.ptp(np.unwrap([math.atan2(*one[::-1, 0]) for one in turned])) < 0.05, "as steady as the robot"
    guess = *levels[0][:3, 3], 0.1 + math.atan2(*levels[0][1::-1, 0])
    off = followed(Localizer(house, guess), HOUSE, poses, pose_of(-3.0, 7.0, 5.0, 1.0) @ poses[0])
    assert np.max(off) < 0.3  # It sees less of the walls than an upright one.


def test_a_large_map_is_searched_on_a_coarser_grid() -> None:
    m, poses = mapped(HOUSE, 1.0), drive()
    m.insert(np.array([[600.0, 500.0, 150.0]]), [599.0, 500.0, 150.0])  # 2^24 bricks are 17 million.
    with pytest.raises(ValueError, match="2\\^24 bricks"):
        m.matcher()
    off = followed(Localizer(m, (1.0, 1.8, 1.0, 0.3)), HOUSE, poses[:8], poses[0])
    assert max(off) < 0.15


def test_the_command_writes_poses_in_space(house: Any, tmp_path: Path) -> None:
    make, poses = Messages("ros2"), drive()[:12]
    rows: list[Any] = [
        (
            "/tf_static",
            START - 1,
            make.tf(make.transform(START - 1, "base", "lidar", [0, 0, 0.4], [0, 0, 0, 1])),
        )
    ]
    for i, pose in enumerate(poses):
        stamp, base = START + 0.1 * i, pose_of(*pose[:3, 3], 0.0) @ pose_of(0, 0, -0.4, 0)
        level = pose_of(*pose[:3, 3], 0.0)
        rows.append(("/tf", stamp, make.tf(make.transform(stamp, "odom", "base", base[:3, 3], [0, 0, 0, 1]))))
        rows.append(("/points", stamp + 0.001, make.cloud(stamp, "lidar", seen(HOUSE, level, i))))
    bag = write_bag(tmp_path / "drive", make, rows)
    house.save(tmp_path / "house.ndt")
    words = ["live", bag, "--localize", tmp_path / "house.ndt", "--guess", "1,1.8,0", "--rate", 0]
    done = cli(*words, "-o", tmp_path / "poses.txt")
    assert done.exit_code == 0, done.stderr
    assert "12 of 12 scans localized, never lost" in done.stdout
    told = np.loadtxt(tmp_path / "poses.txt")[:, 1:4]
    assert np.linalg.norm(told - [pose[:3, 3] - [0, 0, 0.4] for pose in poses], axis=1).max() < 0.12
