# SPDX-License-Identifier: BSD-3-Clause
"""What walks through free space is no obstacle of the published grid; what stays is; walls always."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("typer")
pytest.importorskip("rosbags")
pytest.importorskip("scipy")

from types import SimpleNamespace
from typing import Any

from planes import seen
from test_live_localizing import room

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


Column = tuple[int, int]


def noted(
    passing: Passing, stamp: float, hit: set[Column], came: set[Column], *, height: float | None = None
) -> set[Column]:
    """The marked columns of 1 m after a scan that hit some, of which some came into free space."""
    columns = sorted(hit | came)
    ends = np.array(columns, float).reshape(-1, 2) + 0.5
    origin = [0.0, 0.0]
    if height is not None:
        ends, origin = np.column_stack([ends, np.full(len(ends), height)]), [0.0, 0.0, 0.0]

    def moved(points: np.ndarray) -> np.ndarray:
        return np.array([tuple(np.floor(point[:2]).astype(int)) in came for point in points], float)

    def state(points: np.ndarray) -> np.ndarray:
        return np.full(len(points), -1)

    m: Any = SimpleNamespace(options={"min_cell_size": 1.0}, dim=ends.shape[1], moved=moved, state=state)
    passing.note(m, ndtree.Scan(ends, origin, stamp=stamp))
    places = passing.places()
    assert (places % 1.0 == 0.5).all(), "centres"
    return {tuple(place) for place in np.floor(places).astype(int).tolist()}


def beside(*columns: Column) -> set[Column]:
    return {(x + i, y + j) for x, y in columns for i in (-1, 0, 1) for j in (-1, 0, 1)}


TWO: set[Column] = {(5, -5), (6, -5)}
MARKED = beside(*TWO)


def begun(stays: float = STAYS) -> Passing:
    passing = Passing(lambda: stays)
    assert noted(passing, 0.0, set(), TWO) == MARKED
    return passing


def test_one_column_alone_is_an_edge() -> None:
    assert noted(Passing(lambda: STAYS), 0.0, set(), {(5, -5)}) == set()
    assert noted(Passing(lambda: STAYS), 0.0, {(6, -5)}, {(5, -5)}) == set()


def test_a_mark_that_nobody_hits_is_forgotten_in_the_end() -> None:
    passing = begun()
    assert noted(passing, 5.0 * STAYS, set(), set()) == MARKED
    assert noted(passing, 5.0 * STAYS + 0.1, set(), set()) == set()


def test_what_stays_loses_its_mark_where_it_is_hit() -> None:
    passing = begun()
    assert noted(passing, STAYS, TWO, set()) == MARKED
    assert noted(passing, STAYS + 0.1, TWO, set()) == MARKED - TWO


def test_what_comes_again_has_to_stand_anew() -> None:
    passing = begun()
    assert noted(passing, 1.5 * STAYS, set(), TWO) == MARKED
    assert noted(passing, 2.4 * STAYS, TWO, set()) == MARKED
    assert noted(passing, 2.6 * STAYS, TWO, set()) == MARKED - TWO


def test_what_is_hit_beside_a_mark_is_as_old_as_that() -> None:
    passing, third = begun(), (8, -5)
    assert noted(passing, 0.5 * STAYS, {third}, set()) == MARKED | {third}
    assert noted(passing, STAYS + 0.1, {third}, set()) == MARKED


def test_beside_an_old_mark_nothing_is_marked() -> None:
    assert noted(begun(), 1.5 * STAYS, {(8, -5)}, set()) == MARKED


def test_marks_of_a_time_to_come_are_forgotten() -> None:
    assert noted(begun(), -1.0, set(), set()) == set()


def test_heights_between_two_count_and_the_lower_one_itself() -> None:
    for height, expected in ((0.0, set()), (0.1, MARKED), (1.7, MARKED), (1.8, set())):
        passing = Passing(lambda: STAYS, lambda: (0.1, 1.8))
        assert noted(passing, 0.0, set(), TWO, height=height) == expected, height


def test_only_obstacles_that_are_new_are_hidden() -> None:
    before = np.zeros((3, 3), np.int8)
    before[0, 2] = 100  # Its lower corner is a pixel to the right: of column 3 then.
    values = np.full((4, 4), 100, np.int8)
    values[3, 3] = -1
    places = np.array([[3.5, 0.5], [2.5, 0.5], [0.5, 2.5], [3.5, 3.5], [9.5, 0.5]])
    hide(values, (0.0, 0.0), 1.0, places, (before, (1.0, 0.0)))
    assert {tuple(at) for at in np.argwhere(values == 0).tolist()} == {(0, 2), (2, 0)}
    assert values[3, 3] == -1
    hide(values, (0.0, 0.0), 1.0, places, None)
    assert np.argwhere(values == 0).tolist() == [[0, 2], [0, 3], [2, 0]] and values[3, 3] == -1


def test_what_comes_again_too_soon_does_not_begin_anew() -> None:
    passing, begin = Passing(lambda: STAYS), 10 * STAYS
    assert noted(passing, begin, set(), TWO) == MARKED
    assert noted(passing, begin + 0.5 * STAYS, set(), TWO) == MARKED
    assert noted(passing, begin + 1.2 * STAYS, TWO, set()) == MARKED - TWO


def test_points_without_a_sensor_and_heights_of_the_plane_say_nothing() -> None:
    ones = {"moved": lambda ends: np.ones(len(ends)), "state": lambda ends: np.zeros(len(ends))}
    m: Any = SimpleNamespace(options={"min_cell_size": 1.0}, dim=2, **ones)
    ends = np.array([[5.5, -4.5], [6.5, -4.5]])
    passing = Passing(lambda: STAYS, lambda: (0.0, 1.0))
    passing.note(m, ndtree.Scan(ends, np.zeros(2), points_only=True))
    assert not len(passing.places())
    passing.note(m, ndtree.Scan(ends, np.zeros(2)))
    assert len(passing.places()) == len(MARKED)


@pytest.mark.parametrize("beams", [2400, 1 << 20])
def test_of_an_image_some_beams_tell_as_much_as_all(beams: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Somebody half a metre wide walks between a depth camera and a wall."""
    monkeypatch.setattr("ndtree.live.passing.BEAMS", beams)
    y, z = np.meshgrid(np.linspace(-0.7, 0.7, 160), np.linspace(-0.5, 0.5, 120))
    ways = np.stack([np.ones(y.size), y.ravel(), z.ravel()], axis=1)
    m, passing = ndtree.AdaptiveMap(dim=3, min_cell_size=0.1), Passing(lambda: 2.0)
    for i in range(20):
        is_person = (np.abs(4.05 * ways[:, 1] + 1.5 - 0.1 * i) < 0.25) & (i >= 8)
        scan = ndtree.Scan(ways * np.where(is_person, 4.05, 6.05)[:, None], np.zeros(3), stamp=0.1 * i)
        passing.note(m, scan)
        scan.insert_into(m)
        if i >= 8:
            seen_at = {*map(tuple, np.floor(scan.endpoints[is_person, :2] / 0.1).astype(int))}
            marked = {*map(tuple, np.floor(passing.places() / 0.1).astype(int))}
            assert len(seen_at) > 3 and seen_at <= marked
