# SPDX-License-Identifier: BSD-3-Clause
"""A sensor that is said to stand, and moves, shows in its scans; people who pass a standing sensor do not."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags")

from bags import START, Messages, write_bag
from calling import cli

from ndtree.logs.ros.messages.beams import Beams
from ndtree.logs.ros.placement.standing import MOVES, Standing

#: Of the room: walls, floor and ceiling, as (axis, place) [m].
PLANAR_SIDES = ((0, 5.0), (0, -4.0), (1, 3.0), (1, -6.0))
SIDES = (*PLANAR_SIDES, (2, -0.5), (2, 2.5))


def ranges_in_room(place: np.ndarray, ways: np.ndarray, people: np.ndarray) -> np.ndarray:
    """From a place along unit vectors to the walls, or to the upright cylinders of some people [m]."""
    sides = SIDES if ways.shape[1] == 3 else PLANAR_SIDES
    with np.errstate(divide="ignore", invalid="ignore"):
        lengths = np.stack([(side - place[axis]) / ways[:, axis] for axis, side in sides])
        found = np.where(lengths > 0, lengths, np.inf).min(axis=0)
        for person in people:
            flat = np.linalg.norm(ways[:, :2], axis=1)
            along = ways[:, :2] / flat[:, None]
            to = person - place[:2]
            ahead = along @ to
            aside = np.abs(along[:, 0] * to[1] - along[:, 1] * to[0])
            hit = (ahead > 0) & (aside < 0.25)
            found = np.where(hit, np.minimum(found, np.maximum(ahead - 0.25, 0.1) / flat), found)
    return found


def scans(where: Any, *, dim: int, people: int = 0, n: int = 60, seed: int = 5) -> list[Beams]:
    """Scans of a laser, or of a lidar whose beams go elsewhere each time, by ``where(i) = x, y, yaw``."""
    generator = np.random.default_rng(seed)
    walks = [generator.uniform([-4, -6], [5, 3], (2, 2)) for _ in range(people)]
    made = []
    for i in range(n):
        x, y, yaw = where(i)
        if dim == 2:
            angles = np.radians(np.arange(-135, 135, 1.0))
            ups = np.zeros(len(angles))
        else:
            angles, ups = generator.uniform(-1.2, 1.2, 1500), generator.uniform(-0.4, 0.4, 1500)
        level = np.cos(ups)
        own = np.stack([level * np.cos(angles), level * np.sin(angles), np.sin(ups)], axis=1)
        ways = np.stack([level * np.cos(angles + yaw), level * np.sin(angles + yaw), np.sin(ups)], axis=1)
        now = np.array([a + (b - a) * (i / n) for a, b in walks]).reshape(-1, 2)
        lengths = ranges_in_room(np.array([x, y, 0.0])[:dim], ways[:, :dim], now)
        lengths = lengths + generator.normal(0, 0.02, len(lengths))
        made.append(Beams(own * lengths[:, None]))
    return made


def share(made: list[Beams], dim: int) -> float:
    standing = Standing(is_planar=dim == 2)
    for one in made:
        standing.add(one)
    return standing.share_elsewhere()


WAYS = {
    "drives": lambda i: (0.02 * i, -0.03 * i, 0.0),
    "turns": lambda i: (0.0, 0.0, 0.02 * i),
    "winds": lambda i: (np.sin(0.1 * i), -np.sin(0.07 * i), 0.05 * i),
    "starts late": lambda i: (0.0, 0.0, 0.1 * max(0, i - 45)),
}


@pytest.mark.parametrize(
    "way, dim", [(way, dim) for way in WAYS for dim in (2, 3) if (way, dim) != ("starts late", 3)]
)
def test_a_sensor_that_moves_is_known_by_its_scans(way: str, dim: int) -> None:
    assert share(scans(WAYS[way], dim=dim), dim) > 1.2 * MOVES


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("people", [0, 3, 8])
def test_people_who_pass_a_standing_sensor_are_no_motion(people: int, dim: int) -> None:
    for seed in range(3):
        assert share(scans(lambda i: (0.5, -1.0, 0.3), dim=dim, people=people, seed=seed), dim) == 0


@pytest.mark.parametrize("dim", [2, 3])
def test_beams_without_return_say_nothing_of_where_a_sensor_stands(dim: int) -> None:
    """A driver may write any length for them: here far behind the walls, elsewhere in each scan."""
    generator = np.random.default_rng(3)
    made = []
    for one in scans(lambda i: (0.5, -1.0, 0.3), dim=dim):
        is_lost = generator.random(len(one.points)) < 0.3
        points = np.where(is_lost[:, None], one.points * generator.uniform(2, 4), one.points)
        made.append(Beams(points, returned=~is_lost))
    assert share(made, dim) == 0
    assert share([Beams(one.points) for one in made], dim) > MOVES, "if all had returned, it would move"


def test_of_long_logs_some_scans_are_kept_and_of_short_ones_nothing_is_said() -> None:
    made = scans(WAYS["turns"], dim=2)
    assert share(made * 20, 2) == pytest.approx(share(made, 2), abs=0.15)
    assert share(made[:3], 2) == 0.0
    assert share([], 2) == 0.0 and share([Beams(np.full((5, 3), np.nan))] * 9, 2) == 0.0
    assert share([Beams(one.points[:5]) for one in made], 2) == 0.0  # A few sonars are not enough to tell.


def bag(path: Path, way: Any, transforms: bool) -> Path:
    make = Messages("mcap")
    content: list[tuple[str, float, Any]] = []
    for i, one in enumerate(scans(way, dim=2, n=30)):
        t = START + 0.1 * i
        laser = make.laser(
            t, "laser", np.linalg.norm(one.points, axis=1), range_max=20.0,
            angle_min=-np.radians(135), angle_increment=np.radians(1.0),
        )  # fmt: skip
        if transforms:
            content.append(make.moved(t, "odom", "laser", [0, 0, 0]))
        content.append(("/scan", t, laser))
    return write_bag(path, make, content)


@pytest.mark.parametrize(
    "options, said",
    [(["--still"], "is taken as standing still"), ([], "never moves in odom by /tf")],
    ids=["--still", "odometry that says nothing"],
)
def test_commands_warn_of_a_sensor_that_moves(options: list[str], said: str, tmp_path: Path) -> None:
    moving = bag(tmp_path / "moving", WAYS["winds"], not options)
    for command in (
        ["info", str(moving), "--look"],
        ["map", str(moving), "-o", str(tmp_path / "a.ndt"), "--to", "2"],
    ):
        done = cli(*command, *options)
        assert done.exit_code == 0, done.stderr
        assert done.stderr.count("its scans show that it moves") == 1 and f"/scan: {said}, but" in done.stderr
    standing = bag(tmp_path / "standing", lambda i: (0, 0, 0), not options)
    done = cli("info", standing, "--look", *options)
    assert done.exit_code == 0 and "moves" not in done.stderr + done.stdout


def test_align_begins_at_rest_where_a_bag_has_no_poses(tmp_path: Path) -> None:
    way = WAYS["winds"]
    path, poses, both = bag(tmp_path / "moving", way, False), tmp_path / "poses.txt", tmp_path / "both.ndt"
    done = cli("align", path, "-o", poses, "--map", tmp_path / "a.ndt")
    assert done.exit_code == 0, done.stderr
    assert "there is no /tf, nor any other poses: its scans alone say where it was" in done.stderr
    assert "shows that it moves" not in done.stderr and "smear" not in done.stderr
    rows, truth = np.loadtxt(poses), np.array([way(i) for i in range(30)])
    away = truth[:, :2] - truth[0, :2]
    c, s = np.cos(truth[0, 2]), np.sin(truth[0, 2])
    assert np.abs(rows[:, 1:3] - away @ np.array([[c, -s], [s, c]])).max() < 0.05
    done = cli("map", path, "--align", "-o", both)
    assert done.exit_code == 0 and "smear" not in done.stderr, done.stderr
    assert both.read_bytes() == (tmp_path / "a.ndt").read_bytes()
    asked = cli("align", path, "-o", poses, "--fixed-frame", "odom")
    assert asked.exit_code == 1 and "--still" in asked.stderr, "what was asked for is missing"
