# SPDX-License-Identifier: BSD-3-Clause
"""Paths of bodies through maps, from Python and from the command line."""

from __future__ import annotations

import json
import pickle
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ndtree

RNG = np.random.default_rng(70)
KINDS = {
    "adaptive": lambda dim: ndtree.AdaptiveMap(
        dim=dim, min_cell_size=0.1, max_cell_size=1.6, range_sigma=0.02
    ),
    "thirds": lambda dim: ndtree.AdaptiveMap(
        dim=dim, branching=3, min_cell_size=0.1, max_cell_size=2.7, range_sigma=0.02
    ),
    "fixed": lambda dim: ndtree.FixedMap(dim=dim, cell_size=0.1, range_sigma=0.02),
}


def rooms(dim: int, kind: str = "adaptive") -> Any:
    """Two rooms of 4 m with a wall between them, a door at its upper end, and a pillar in each."""
    m = KINDS[kind](dim)
    low, high = np.full(dim, -2.0), np.full(dim, 2.0)
    low[0], high[0] = -4.0, 4.0
    m.mark([low, high], "free")
    for x, width in ((-0.1, 0.2), (-2.5, 0.6), (1.9, 0.6)):
        lower, upper = low.copy(), high.copy()
        lower[0], upper[0] = x, x + width
        lower[1], upper[1] = (-2.0, 0.8) if width == 0.2 else (-0.5, 0.5)
        m.mark([lower, upper], "occupied")
    return m


def point(dim: int, x: float, y: float) -> np.ndarray[Any, Any]:
    return np.array([x, y, 0.3][:dim])


def poses(points: Any) -> Any:
    """Steps of 1 cm along a path, as matrices."""
    steps = [np.linspace(a, b, 2 + int(100 * np.linalg.norm(b - a))) for a, b in zip(points, points[1:])]
    every = np.concatenate(steps)
    matrices = np.tile(np.eye(points.shape[1] + 1), (len(every), 1, 1))
    matrices[:, :-1, -1] = every
    return matrices


BODIES = {
    "sphere": lambda dim: ndtree.Sphere(0.25),
    "capsule": lambda dim: ndtree.Capsule([-0.2] + [0.0] * (dim - 1), [0.2] + [0.0] * (dim - 1), 0.2),
    "box": lambda dim: ndtree.Box([0.6, 0.4, 0.4][:dim]),
    "union": lambda dim: ndtree.Sphere(0.2) | ndtree.Box([0.3] * dim, center=[0.2] * dim),
}


@pytest.mark.parametrize(
    "dim, kind, name",
    [(2, "adaptive", "sphere"), (2, "thirds", "box"), (3, "fixed", "capsule"), (3, "adaptive", "union")],
)
def test_a_path_is_free_and_goes_through_the_door(dim: int, kind: str, name: str) -> None:
    m, body = rooms(dim, kind), BODIES[name](dim)
    start, goal = point(dim, -3.3, -1.0), point(dim, 3.3, -1.0)
    path = m.plan(start, goal, body=body)
    assert path and path.status == "found" and len(path) == len(path.points)
    np.testing.assert_array_equal(path.points[[0, -1]], [start, goal])
    assert path.length == pytest.approx(np.linalg.norm(np.diff(path.points, axis=0), axis=1).sum())
    over_the_door = 2 * np.hypot(3.2, 1.8)
    assert over_the_door < path.length < 1.22 * over_the_door
    assert m.path_collides(body, poses(path.points), unknown="occupied") == -1
    again = ndtree.Planner(m, body).plan(start, goal)
    np.testing.assert_array_equal(again.points, path.points)
    copied = pickle.loads(pickle.dumps(path))
    np.testing.assert_array_equal(copied.points, path.points)
    assert repr(path) == f"Path({len(path)} points, {path.length:.3f} m, clearance {path.clearance:.3f} m)"


def test_a_robot_turns_where_it_fits_lengthwise_alone() -> None:
    m = ndtree.AdaptiveMap(dim=2, min_cell_size=0.05, max_cell_size=1.6)
    m.mark([[-3.0, -3.0], [3.0, 3.0]], "free")
    m.mark([[-0.5, -3.0], [0.5, -0.3]], "occupied")
    m.mark([[-0.5, 0.3], [0.5, 3.0]], "occupied")
    body = ndtree.Box((1.0, 0.3))
    start, goal = [-2.0, 0.5, np.pi / 2], [2.0, 0.5, np.pi / 2]
    path = m.plan(start, goal, body=body)
    assert path and path.points.shape[1] == 3 and len(path) == len(path.points)
    np.testing.assert_array_equal(path.points[0], start)
    np.testing.assert_allclose(path.points[-1], goal, atol=1e-9)
    moves, turns = np.diff(path.points[:, :2], axis=0).any(axis=1), np.diff(path.points[:, 2]) != 0
    assert (moves ^ turns).all() and turns.sum() >= 2
    steps = [np.linspace(a, b, 200) for a, b in zip(path.points, path.points[1:])]
    assert not m.collides(body, np.concatenate(steps), unknown="occupied").any()
    assert m.path_collides(body, path.points, unknown="occupied") == -1
    planner = ndtree.Planner(m, body)
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        m.collides(body, [[0.0, 0.0, 7.0]] * 5)  # A path that begins there may turn so far.
        assert not warned
        m.collides(body, [[0.0, 0.0, 90.0]] * 5)
        assert len(warned) == 1 and "is it in degrees?" in str(warned[0].message)
    np.testing.assert_array_equal(planner.plan(start, goal).points, path.points)
    assert planner.first_blocked(path.points) == -1
    m.mark([[-0.5, -0.3], [0.5, 0.3]], "occupied")
    planner.update(m)
    assert planner.first_blocked(path.points) >= 0 and not planner.plan(start, goal)
    m.clear([[-0.5, -0.3], [0.5, 0.3]])
    assert not m.plan(start, goal, body=body) and m.plan(start, goal, body=body, unknown=3.0)
    m.mark([[-0.5, -0.3], [0.5, 0.3]], "free")
    assert not m.plan(start, goal, body=body, clearance=0.2)
    assert not m.plan(start, goal, body=ndtree.Box((1.0, 0.7)))
    with pytest.raises(ValueError, match=r"goal: shape \(2,\), expected \(3,\) as start"):
        m.plan(start, goal[:2], body=body)
    with pytest.raises(ValueError, match=r"start: shape \(4,\), expected \(2,\), or \(3,\) of x, y and yaw"):
        m.plan([0.0] * 4, goal, body=body)
    with pytest.raises(ValueError, match="headings = 2: must be 4 to 256"):
        m.plan(start, goal, body=body, headings=2)
    with pytest.raises(ValueError, match=r"start = .*there the body meets the occupied cell"):
        m.plan([0.0, 1.0, 0.0], goal, body=body)


def test_unknown_space_blocks_is_free_or_costs() -> None:
    m, body = rooms(2), ndtree.Sphere(0.2)
    m.clear([[-0.1, -2.0], [0.1, -1.0]])  # A part of the wall that was not seen.
    start, goal = point(2, -1.0, -1.5), point(2, 1.0, -1.5)
    blocked, free = m.plan(start, goal, body=body), m.plan(start, goal, body=body, unknown="free")
    cheap, dear = (m.plan(start, goal, body=body, unknown=cost) for cost in (2.0, 1000.0))
    assert free.length == pytest.approx(2.0) and cheap.length == pytest.approx(2.0, rel=0.01)
    assert blocked.length > 5.0 and dear.length == pytest.approx(blocked.length, rel=0.06)


def test_ends_that_collide_are_named_with_the_nearest_place() -> None:
    m, body = rooms(2), ndtree.Sphere(0.25)
    with pytest.raises(
        ValueError, match=r"goal = \(9\.0, 0\.0\): .*unknown.*nearest place where it fits is 5\."
    ):
        m.plan([1.0, 1.0], [9.0, 0.0], body=body)
    with pytest.raises(ValueError, match="no place was found where it fits"):
        m.plan([1.0, 1.0], [2.0, 1.0], body=ndtree.Sphere(5.0))


def test_what_is_wrong_with_a_call_is_said() -> None:
    m, body = rooms(2), ndtree.Sphere(0.25)
    for error, arguments in (
        (r"goal: shape \(2,\), expected \(3,\) as start", ([0, 0, 0], [1, 1])),
        (r"start: shape \(1,\), expected \(2,\), or \(3,\) of x, y and yaw", ([0], [1, 1])),
        (r"goal = \(1\.0, nan\): must be finite", ([1, 1], [1, np.nan])),
    ):
        with pytest.raises(ValueError, match=error):
            m.plan(*arguments, body=body)
    for error, options in (
        ("unknown = 'occupied': must be 'blocked', 'free' or a cost >= 1", {"unknown": "occupied"}),
        ("unknown = 0.5: a cost must be >= 1", {"unknown": 0.5}),
        (r"clearance = -1(\.0)?: must be >= 0 m", {"clearance": -1.0}),
        ("unknown = None: must be 'blocked'", {"unknown": None}),
        ("unknown = True: must be 'blocked'", {"unknown": True}),
        (r"unknown = (np\.)?True_?: must be 'blocked'", {"unknown": np.True_}),
        (r"max_seconds = -1(\.0)?: must be >= 0", {"max_seconds": -1.0}),
    ):
        with pytest.raises((ValueError, TypeError), match=error):
            m.plan([1, 1], [1, 1], body=body, **options)
    planner = ndtree.Planner(m, body)
    with pytest.raises(ValueError, match=r"goals\[1\] = \(1\.0, nan\): must be finite"):
        planner.ways([1.0, 1.0], [[1.0, 1.0], [1.0, np.nan]])
    with pytest.raises(ValueError, match=r"goals has shape \(3,\): must be \(n, 2\)"):
        planner.ways([1.0, 1.0], [0.0, 0.0, 0.0])
    for poses, error in (
        ([[1, 1, 0], [1, 1.1, 0.1]], r"points\[1\]: moves by 0.1 m and turns by 0.1 rad at once"),
        ([[1, 1, 0], [1, 1, np.nan]], r"points\[1\]: yaw must be finite"),
    ):
        with pytest.raises(ValueError, match=error):
            planner.first_blocked(poses)
    with pytest.raises(ValueError, match="dim = 4"):
        ndtree.AdaptiveMap(dim=4).plan([0] * 4, [1] * 4, body=body)


def test_a_planner_follows_the_map() -> None:
    m, body = rooms(2), ndtree.Sphere(0.25)
    start, goal = point(2, -3.3, -1.0), point(2, 3.3, -1.0)
    planner = ndtree.Planner(m, body)
    assert not planner.update(m)
    path = planner.plan(start, goal)
    assert planner.first_blocked(path.points) == -1
    m.mark([[-0.1, 0.8], [0.1, 2.0]], "occupied")  # The door closes.
    assert planner.first_blocked(path.points) == -1  # It has not been told.
    assert planner.update(m)
    k = planner.first_blocked(path.points)
    assert path.points[k, 0] < 0.5 and path.points[k + 1, 0] > -0.5
    none = planner.plan(start, goal)
    assert not none and none.status == "none" and none.points.shape == (0, 2) and none.length == np.inf
    m.mark([[-0.1, -2.0], [0.1, -1.0]], "free")
    planner.update(m)
    below = planner.plan(start, goal)
    np.testing.assert_array_equal(below.points, m.plan(start, goal, body=body).points)
    assert below.points[:, 1].max() < 0.0 and 0 < planner.memory_bytes < 1e7


def test_threads_share_a_planner_and_get_the_same_paths() -> None:
    m, body = rooms(2), ndtree.Sphere(0.25)
    goals = [point(2, 3.3, y) for y in np.linspace(-1.5, 1.5, 12)]
    expected = [m.plan([-3.3, -1.0], goal, body=body).points for goal in goals]
    planner = ndtree.Planner(m, body)
    with ThreadPoolExecutor(3) as pool:
        got = list(pool.map(lambda goal: planner.plan([-3.3, -1.0], goal).points, goals))
    for one, other in zip(got, expected):
        np.testing.assert_array_equal(one, other)


def test_the_search_ends_when_its_time_is_over() -> None:
    m = ndtree.FixedMap(dim=2, cell_size=0.1)
    m.mark([[-40.0, -40.0], [40.0, 40.0]], "free")
    for x in np.arange(-38.0, 39.0, 2.0):  # A long zigzag.
        up = (x // 2) % 2 == 0
        m.mark([[x, -40.0 if up else -38.0], [x + 0.1, 38.0 if up else 40.0]], "occupied")
    assert m.plan([-39, 0], [39, 0], body=ndtree.Sphere(0.2)).length > 1000.0
    late = m.plan([-39, 0], [39, 0], body=ndtree.Sphere(0.2), max_seconds=0.0)
    assert not late and late.status == "out of time" and 0 < late.expanded < 1000
    planner, goals = ndtree.Planner(m, ndtree.Sphere(0.2)), [[39.0, 0.0], [-39.0, 1.0], [-38.0, -10.0]]
    ways = planner.ways([-39, 0], goals, max_seconds=0.0)
    assert np.isnan(ways[0]) and ways[1] == 1.0 and ways[2] == np.inf


def halls(at: np.ndarray[Any, Any], seed: int) -> Any:
    """A field of 10 m by 8 m with obstacles of a cell and more, and a place that is shut in on all sides."""
    random, m = np.random.default_rng(seed), ndtree.FixedMap(dim=2, cell_size=0.1)
    m.mark(np.add(at, [[0.0, 0.0], [10.0, 8.0]]), "free")
    for lower in 0.1 * random.integers(5, [95, 75], (120, 2)):
        m.mark(np.add(at + lower, [[0.02, 0.02], 0.1 * random.integers(1, 4, 2) - 0.02]), "occupied")
    m.mark(np.add(at, [[8.0, 6.0], [9.5, 7.5]]), "occupied")
    m.mark(np.add(at, [[8.3, 6.3], [9.2, 7.2]]), "free")
    m.mark(np.add(at, [[0.0, 0.0], [0.9, 0.9]]), "free")
    return m


def test_paths_far_from_zero_are_those_near_it() -> None:
    """As in UTM: where gaps are narrow, where a body only just fits, and where no way leads."""
    random, shift = np.random.default_rng(0), np.array([499_200.0, 5_400_320.0])
    near, far = halls(np.zeros(2), 0), halls(shift, 0)
    c, s = np.cos(0.3), np.sin(0.3)
    shut_in, start = np.array([8.75, 6.75]), np.array([0.45, 0.45])
    compared = 0
    for body in (ndtree.Sphere(0.24), ndtree.Box((0.6, 0.3), rotation=[[c, -s], [s, c]]), ndtree.Sphere(0.0)):
        goals = random.uniform(0.5, [9.5, 7.5], (25, 2))
        goals = goals[~near.collides(body, np.c_[goals, np.zeros(len(goals))], unknown="occupied")]
        for unknown in ("blocked", "free"):
            planners = [ndtree.Planner(m, body, unknown=unknown) for m in (near, far)]
            expected, ways = (
                one.ways(at + start, [*(at + goals), at + shut_in], max_seconds=10.0)
                for one, at in zip(planners, (0.0, shift))
            )
            np.testing.assert_allclose(ways, expected, rtol=0.1)  # Of ways alike, another may be taken.
            assert ways[-1] == np.inf
            for goal in goals:
                one, other = planners[0].plan(start, goal), planners[1].plan(start + shift, goal + shift)
                assert one.status == other.status
                np.testing.assert_allclose(other.length, one.length, rtol=0.1)
                compared += bool(one)
    assert compared > 50


def test_a_path_that_stays_where_it_is_has_a_clearance() -> None:
    m, body = rooms(2), ndtree.Box((0.4, 0.2))
    place, pose = m.plan([1.0, 0.0], [1.0, 0.0], body=body), m.plan([1.0, 0, 0], [1.0, 0, 0], body=body)
    assert pose.clearance == pytest.approx(place.clearance) and 0.5 < place.clearance < 0.8


def test_frontiers_come_in_the_order_of_the_way() -> None:
    m, body = rooms(2, "fixed"), ndtree.Sphere(0.2)
    for corner in ((-0.8, -0.8), (0.6, -0.8), (3.0, 0.9)):  # Holes: two of them near each other by air.
        m.clear([corner, np.add(corner, 0.4)])
    here = point(2, -1.2, -0.8)
    planner = ndtree.Planner(m, body, unknown="free")
    found = m.frontiers(min_cells=4)
    ordered = planner.by_way(here, found)
    assert len(ordered) >= 3 and [way for _, way in ordered] == sorted(way for _, way in ordered)
    assert {id(frontier) for frontier, _ in ordered} <= {id(frontier) for frontier in found}
    for frontier, way in ordered:
        assert way == planner.ways(here, frontier.cell_centers).min()
    assert planner.by_way(here, []) == []
    assert ndtree.Planner(m, body).by_way(here, found) == []  # Beside unknown space it fits nowhere.


@pytest.mark.parametrize("dim, name", [(2, "box"), (3, "sphere")])
def test_corridors_hold_the_path(dim: int, name: str) -> None:
    planner = ndtree.Planner(rooms(dim), BODIES[name](dim), clearance=0.05)
    path = planner.plan(point(dim, -3.3, -1.0), point(dim, 3.3, -1.0))
    corridors = planner.corridors(path.points, reach=0.8)
    assert len(corridors) == len(path.points) - 1
    for ends, planes in zip(zip(path.points, path.points[1:]), corridors):
        np.testing.assert_allclose(np.linalg.norm(planes[:, :dim], axis=1), 1.0)
        room = planes[:, dim:] - planes[:, :dim] @ np.transpose(ends)
        assert room.min() > -1e-9 and room.min(axis=1).max() < 0.8 + 1e-9
    for points, reach, said in (
        (path.points, 0.0, "reach = 0"),
        ([[-3.3, -1.0, 0.0][:dim], [3.3, -1.0, 0.0][:dim]], 1.0, "meets an obstacle in segment 0"),
    ):
        with pytest.raises(ValueError, match=said):
            planner.corridors(points, reach=reach)


@pytest.mark.parametrize("dim", [2, 3])
def test_the_command_draws_the_path_on_the_map(tmp_path: Path, dim: int) -> None:
    pytest.importorskip("typer")
    pytest.importorskip("matplotlib")
    from calling import cli
    from matplotlib.image import imread

    rooms(dim).save(tmp_path / "rooms.ndt")
    ends = [",".join(["-3.3", "-1", "0.25"][:dim]), ",".join(["3.3", "-1", "0.25"][:dim])]
    call = ["plan", tmp_path / "rooms.ndt", "--from", ends[0], "--to", ends[1], "--body", "0.2"]
    done = cli(*call, "--picture", tmp_path / "path.png")
    assert done.exit_code == 0, done.stderr
    red, green, blue = np.moveaxis(imread(tmp_path / "path.png")[..., :3], 2, 0)
    assert np.count_nonzero((red > 0.7) & (green < 0.3)) > 100, "the path"
    assert np.count_nonzero((red < 0.1) & (blue < 0.1)) > 300, "walls"


def test_the_command_writes_a_path(tmp_path: Path) -> None:
    pytest.importorskip("typer")
    from calling import cli

    m = rooms(2)
    m.save(tmp_path / "rooms.ndt")
    call = ["plan", str(tmp_path / "rooms.ndt"), "--from", "-3.3,-1", "--to", "3.3,-1", "--body", "0.25"]
    expected = m.plan([-3.3, -1.0], [3.3, -1.0], body=ndtree.Sphere(0.25))
    for ending in (".csv", ".yaml", ".json"):
        file = tmp_path / f"way{ending}"
        done = cli(*call, "-o", file)
        assert (
            done.exit_code == 0 and f"{expected.length:.2f} m in {len(expected) - 1} segments" in done.stdout
        )
        text = file.read_text()
        if ending == ".csv":
            points = np.loadtxt(file, delimiter=",", skiprows=1)
        elif ending == ".json":
            points = np.array(json.loads(text)["points"])
        else:
            points = np.array([json.loads(line.strip()[2:]) for line in text.splitlines() if "- [" in line])
        np.testing.assert_allclose(points, expected.points, rtol=0.0, atol=1e-9)  # So they stay free.
    for more, status, said in (
        (["--clearance", "0.4"], 1, "no path found: the goal is in another part of free space"),
        (["--unknown", "0.5"], 2, "--unknown 0.5: expected blocked, free or a cost >= 1"),
        (["-o", str(tmp_path / "way.txt")], 2, "must end in .csv, .yaml, .json"),
    ):
        done = cli(*call, *more)
        assert done.exit_code == status and said in done.stderr.replace("\n", " "), done.stderr
    done = cli(*call[:3], "1,2,3", *call[4:])
    assert done.exit_code == 2 and "--from 1,2,3: expected X,Y in metres" in done.stderr
