# SPDX-License-Identifier: BSD-3-Clause
"""What walks through free space is no obstacle of the published grid; what stays is; walls always."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("typer")
pytest.importorskip("rosbags")
pytest.importorskip("scipy")

from test_live_localizing import room, seen

import ndtree
from ndtree.live.following import matrix_of
from ndtree.live.grid import GridFollower
from ndtree.live.passing import STAYS, Passing, hide


def person(x: float, y: float, radius: float = 0.25) -> np.ndarray:
    """Wall segments (16, 2, 2) around somebody."""
    angles = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    corners = np.stack([x + radius * np.cos(angles), y + radius * np.sin(angles)], axis=1)
    return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)


class Robot:
    """A laser at 10 Hz in a room of 8 m by 5 m; after 4 s somebody walks in at 0.8 m/s."""

    def __init__(self, *, moves: bool, stops_at: float = -np.inf, stays: float = STAYS) -> None:
        self.walls = room(8.0, 5.0, [(6.0, 0.0, 0.5, 0.4)])
        self.map = ndtree.AdaptiveMap(dim=2, range_sigma=0.01)
        self.passing, self.grid = Passing(lambda: stays), GridFollower()
        self.published: tuple[np.ndarray, tuple[float, float]] | None = None
        self.rng, self.moves, self.stops_at = np.random.default_rng(0), moves, stops_at
        self.raw: list[int] = []
        self.shown: list[int] = []
        self.person: tuple[float, float] | None = None

    def drive(self, scans: int) -> None:
        for i in range(scans):
            pose = np.array([1.0 + 0.02 * i * self.moves, 2.5, 0.1])
            walls = self.walls
            if i >= 40:
                self.person = max(7.0 - 0.08 * (i - 40), self.stops_at), 1.8
                walls = np.concatenate([walls, person(*self.person)])
            ends = seen(walls, pose, 360)
            ends *= 1 + self.rng.normal(0, 0.01, (len(ends), 1)) / np.hypot(*ends.T)[:, None]
            c, s = np.cos(pose[2]), np.sin(pose[2])
            scan = ndtree.Scan(ends @ np.array([[c, s], [-s, c]]) + pose[:2], pose[:2], stamp=0.1 * i)
            self.passing.note(self.map, scan)
            scan.insert_into(self.map)
            self.grid.follow(self.map.snapshot())
            values = self.grid.values.copy()
            hide(values, self.grid.origin, self.grid.cell_size, self.passing.places(), self.published)
            self.published = values, self.grid.origin
            self.raw.append(self.count(self.grid.values))
            self.shown.append(self.count(values))

    def count(self, values: np.ndarray) -> int:
        """Occupied pixels of the free floor."""
        rows, columns = np.nonzero(values == 100)
        x, y = (np.stack([columns, rows]) + 0.5) * 0.05 + np.array(self.grid.origin)[:, None]
        return int(np.count_nonzero((x > 0.3) & (x < 5.8) & (y > 0.6) & (y < 4.6)))


@pytest.mark.parametrize("moves", [False, True])
def test_who_walks_is_no_obstacle(moves: bool) -> None:
    robot = Robot(moves=moves)
    robot.drive(120)
    assert max(robot.raw) > 40 and np.mean(robot.raw[60:]) > 15
    assert max(robot.shown) < 0.5 * max(robot.raw) and np.mean(robot.shown[60:]) < 0.3 * np.mean(
        robot.raw[60:]
    )
    assert (robot.published[0] == 100).sum() > 300, "walls are there"


@pytest.mark.parametrize("moves", [False, True])
def test_who_stops_is_one_soon(moves: bool) -> None:
    robot = Robot(moves=moves, stops_at=4.5)
    robot.drive(100)
    stands = 40 + round((7.0 - 4.5) / 0.08)
    assert max(robot.shown[:stands]) < 12
    assert robot.shown[-1] > 10, "where beams end on somebody"
    late = next(i for i in range(stands, 100) if robot.shown[i] > 10)
    assert late <= stands + 10 * STAYS + 5


def test_without_it_the_grid_is_that_of_the_map() -> None:
    robot = Robot(moves=True, stays=0.0)
    robot.drive(90)
    assert robot.shown == robot.raw and not len(robot.passing.places())


def test_walls_stay_where_somebody_walks_along_them() -> None:
    robot = Robot(moves=False)
    robot.drive(40)
    before = robot.published[0] == 100
    for i in range(40):
        walls = np.concatenate([robot.walls, person(6.5 - 0.1 * i, 0.3)])
        place, turn = np.array([1.0, 2.5]), matrix_of([0.0, 0.0, 0.1])[:2, :2].T
        ends = seen(walls, np.array([*place, 0.1]), 360) @ turn + place
        scan = ndtree.Scan(ends, place, stamp=4.0 + 0.1 * i)
        robot.passing.note(robot.map, scan)
        scan.insert_into(robot.map)
        robot.grid.follow(robot.map.snapshot())
        values = robot.grid.values.copy()
        hide(values, robot.grid.origin, 0.05, robot.passing.places(), robot.published)
        assert not (before & (values != 100) & (robot.grid.values == 100)).any()
        robot.published = values, robot.grid.origin
