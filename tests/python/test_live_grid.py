# SPDX-License-Identifier: BSD-3-Clause
"""A grid that follows a map is the image of the map, and its parts make it whole at a listener."""

from __future__ import annotations

import math
import sys
from types import SimpleNamespace
from typing import Any
from unittest import mock

import numpy as np
import pytest

import ndtree
from ndtree.live import GridFollower
from ndtree.live.grid import GroundFollower
from ndtree.live.outputs import Frontiers, by_size, cell_points, changed_points
from ndtree.maps.writers.map_server import noise_depth


def image_of(m: Any, grid: GridFollower, **options: Any) -> np.ndarray:
    """The image of a map, in the place of a grid; its walls are as thick as their noise."""
    assert grid.values is not None
    options.setdefault("wall_depth", noise_depth(m))
    expected = np.full_like(grid.values, -1)
    try:
        pixels, (x, y), cell_size = m.map_server_image(**options)
    except ValueError:  # Nothing is known.
        return expected
    image = np.select([pixels[::-1] == 254, pixels[::-1] == 0], [0, 100], -1)
    column, row = round((x - grid.origin[0]) / cell_size), round((y - grid.origin[1]) / cell_size)
    expected[row : row + image.shape[0], column : column + image.shape[1]] = image
    return expected


def array_of(m: Any, grid: GridFollower, wall_depth: float | None) -> np.ndarray:
    """The map's dense array in the place of a grid in the plane, with single thin things."""
    assert grid.values is not None
    size = np.array(grid.values.shape[::-1])
    box = np.array([grid.origin, grid.origin + size * grid.cell_size])
    states = m.to_grid(box, grid.cell_size, wall_depth=wall_depth)
    leaves, drawn, wall = m.leaves(), np.where(states == 1, 100, states), np.pad(states == 1, 1)
    for lower, edge in zip(leaves.lower[leaves.thin], leaves.size[leaves.thin]):
        first, last = ((lower + by - grid.origin) / grid.cell_size for by in (1e-6, edge - 1e-6))
        inside, around = (
            [slice(int(a) + 1 - k, int(b) + 2 + k) for a, b in zip(first, last)] for k in (0, 1)
        )
        if not (wall[around[0], inside[1]].any() or wall[inside[0], around[1]].any()):
            drawn[tuple(slice(one.start - 1, one.stop - 1) for one in inside)] = 100
    return drawn.T


class Listener:
    """Has only what was sent."""

    def __init__(self) -> None:
        self.values: np.ndarray | None = None
        self.wholes = self.parts = self.pixels = 0

    def take(self, part: Any) -> None:
        if part is None:
            return
        if part.is_whole:
            self.values, self.wholes = part.values.copy(), self.wholes + 1
            return
        assert self.values is not None
        height, width = part.values.shape
        self.values[part.row : part.row + height, part.column : part.column + width] = part.values
        self.parts, self.pixels = self.parts + 1, self.pixels + part.values.size


@pytest.mark.parametrize(
    "world, scans, cell_size, height",
    [
        ("office", 60, None, None),
        ("office", 25, 0.07, None),
        ("office", 25, 0.2, None),
        ("apartment", 8, None, (0.1, 1.5)),
        ("apartment", 4, 0.12, (0.13, 0.77)),
        ("apartment", 3, None, None),
    ],
)
def test_it_is_the_image_of_the_map(world: Any, scans: int, cell_size: Any, height: Any) -> None:
    log = ndtree.simulate(world, scans=scans)
    m, grid, listener = ndtree.AdaptiveMap(dim=log.dim), GridFollower(cell_size, height), Listener()
    given = {"cell_size": cell_size, "height": height}
    options = {name: value for name, value in given.items() if value is not None}
    assert grid.follow(m.snapshot()) is None
    for scan in log:
        for half in (scan.only(slice(None, None, 2)), scan.only(slice(1, None, 2))):
            half.insert_into(m)
            listener.take(grid.follow(m.snapshot()))
            assert np.array_equal(listener.values, grid.values)
            assert np.array_equal(grid.values, image_of(m, grid, **options))
    assert grid.follow(m.snapshot()) is None
    assert listener.parts >= scans / 2 and listener.wholes <= scans
    assert np.count_nonzero(grid.values == 100) > 50


@pytest.mark.parametrize(
    "options", [{}, {"wall_depth": 0.3}, {"wall_depth": math.inf}, {"cell_size": 0.08}], ids=str
)
def test_far_walls_are_as_thick_as_their_noise(options: Any) -> None:
    generator = np.random.default_rng(1)
    m = ndtree.AdaptiveMap(dim=2, min_cell_size=0.05, range_sigma=0.01, range_sigma_quadratic=0.004)
    grid, listener = GridFollower(**options), Listener()
    angles = np.linspace(-0.5, 0.5, 400)
    for i in range(25):
        origin = np.array([0.013, 0.05 * i - 0.6])
        length = 8.0 / np.cos(angles)
        noisy = length + generator.normal(0, 1, 400) * (0.01 + 0.004 * length**2)
        m.insert(origin + np.c_[np.cos(angles), np.sin(angles)] * noisy[:, None], origin)
        listener.take(grid.follow(m.snapshot()))
        assert np.array_equal(listener.values, grid.values)
        assert np.array_equal(grid.values, image_of(m, grid, **options))
        assert np.array_equal(grid.values, array_of(m, grid, options.get("wall_depth", noise_depth(m))))
    assert grid.values is not None and listener.parts >= 15
    whole = GridFollower(options.get("cell_size"), wall_depth=math.inf)
    whole.follow(m.snapshot())
    thickness, slab = (np.mean(one.values[one.values.any(axis=1)] == 100) for one in (grid, whole))
    assert thickness == slab if options.get("wall_depth") == math.inf else thickness < 0.8 * slab
    assert grid.follow(m.snapshot()) is None


@pytest.mark.parametrize("follower", [GridFollower, GroundFollower])
def test_in_space_far_walls_are_as_thick_as_their_noise(follower: Any) -> None:
    generator = np.random.default_rng(2)
    m = ndtree.AdaptiveMap(dim=3, min_cell_size=0.1, range_sigma=0.02, range_sigma_quadratic=0.004)
    grid, listener = follower(None, (0.2, 1.5)), Listener()
    whole = follower(None, (0.2, 1.5), wall_depth=math.inf)
    across, up = np.meshgrid(np.linspace(-0.5, 0.5, 90), np.linspace(-0.12, 0.12, 25))
    ways = np.stack([np.ones_like(up), across, up], axis=-1).reshape(-1, 3)
    for i in range(12):
        origin = np.array([0.013, 0.1 * i - 0.6, 1.02])
        noise = generator.normal(0, 1, (len(ways), 1)) * 0.03 * np.linalg.norm(ways, axis=1, keepdims=True)
        m.insert(origin + ways * (9.0 + 9.0 * noise), origin)
        listener.take(grid.follow(m.snapshot()))
        whole.follow(m.snapshot())
        assert np.array_equal(listener.values, grid.values)
        if follower is GridFollower:
            assert np.array_equal(grid.values, image_of(m, grid, height=(0.2, 1.5)))
            assert np.array_equal(whole.values, image_of(m, whole, height=(0.2, 1.5), wall_depth=math.inf))
        anew = follower(None, (0.2, 1.5))
        anew.follow(m.snapshot())
        assert np.array_equal(*(one.values[one.values != -1] for one in (anew, grid)))
    assert grid.values is not None and whole.values is not None and listener.parts >= 5
    assert np.array_equal(grid.values == 0, whole.values == 0)
    assert (whole.values[grid.values == 100] == 100).all()
    thickness, slab = (np.count_nonzero(one.values == 100) for one in (grid, whole))
    assert 50 < thickness < 0.7 * slab
    assert grid.follow(m.snapshot()) is None


def test_what_is_cleared_becomes_unknown_and_another_map_is_sent_as_a_whole() -> None:
    scans = list(ndtree.simulate("office", scans=30))
    m, grid, listener = ndtree.AdaptiveMap(dim=2), GridFollower(), Listener()
    for scan in scans:
        scan.insert_into(m)
    listener.take(grid.follow(m.snapshot()))
    center = np.asarray(scans[-1].origin)
    m.clear([center - 1, center + 1])
    listener.take(grid.follow(m.snapshot()))
    assert listener.parts == 1 and listener.pixels < 5000
    assert np.array_equal(listener.values, image_of(m, grid))
    m.keep_near(center, 2.0)
    listener.take(grid.follow(m.snapshot()))
    assert np.array_equal(listener.values, image_of(m, grid))
    other = ndtree.AdaptiveMap(dim=2, min_cell_size=0.1)
    scans[0].insert_into(other)
    listener.take(grid.follow(other.snapshot()))
    assert np.array_equal(listener.values, image_of(other, grid)) and grid.cell_size == 0.1


@pytest.mark.parametrize("height", [None, (0.13, 1.5)])
def test_in_space_a_grid_follows_what_is_cleared_merged_and_forgotten(height: Any) -> None:
    generator = np.random.default_rng(4)
    scans = list(ndtree.simulate("apartment", scans=12))
    m, grid, listener = ndtree.AdaptiveMap(dim=3, min_cell_size=0.1), GridFollower(None, height), Listener()
    given = {} if height is None else {"height": height}
    for step, scan in enumerate(scans):
        scan.insert_into(m)
        center = np.asarray(scan.origin)
        if step % 3 == 1:
            m.clear([center - generator.uniform(0.2, 1, 3), center + generator.uniform(0.2, 1, 3)])
        if step % 4 == 3:
            m.keep_near(center, 2.0)
        listener.take(grid.follow(m.snapshot()))
        assert np.array_equal(listener.values, grid.values)
        assert np.array_equal(grid.values, image_of(m, grid, **given))
    assert listener.parts > 5 and np.count_nonzero(grid.values == 100) > 50
    other = ndtree.AdaptiveMap(dim=3, min_cell_size=0.05)
    listener.take(grid.follow(other.snapshot()))  # Another kind of map, in which nothing is known.
    assert (grid.values == -1).all() and np.array_equal(listener.values, grid.values)
    for scan in scans[:2]:
        scan.insert_into(other)
        listener.take(grid.follow(other.snapshot()))
        assert np.array_equal(listener.values, image_of(other, grid, **given))


def scan_of_a_table(origin: np.ndarray) -> np.ndarray:
    """End points on a table top of 4 cm that is seen from just above it, and on the wall behind."""
    across, up = np.meshgrid(np.linspace(-0.35, 0.35, 120), np.linspace(-0.2, 0.05, 80))
    ways = np.stack([np.ones_like(up), across, up], axis=-1).reshape(-1, 3)
    with np.errstate(divide="ignore"):
        enter = np.maximum((1.0 - origin[0]) / ways[:, 0], (0.74 - origin[2]) / ways[:, 2])
    met = origin + ways * enter[:, None]
    ends = origin + ways * (3.0 - origin[0])
    is_met = (ways[:, 2] < 0) & (met[:, 0] < 2.0) & (met[:, 2] > 0.70) & (np.abs(met[:, 1]) < 0.5)
    return np.where(is_met[:, None], met, ends)


def test_a_table_top_seen_at_a_grazing_angle_is_an_obstacle() -> None:
    m, grid = ndtree.AdaptiveMap(dim=3, min_cell_size=0.1, range_sigma=0.01), GridFollower(None, (0.2, 1.5))
    for step in range(12):
        origin = np.array([0.02 * step, 0.01, 0.9])
        m.insert(scan_of_a_table(origin), origin)
        grid.follow(m.snapshot())
        assert np.array_equal(grid.values, image_of(m, grid, height=(0.2, 1.5)))
    thin = m.leaves(states=["free"])
    thin = thin[thin.thin]
    assert len(thin) > 20 and (thin.hits >= 2).all() and (np.asarray(m.state(thin.center)) == 0).all()
    column, row = np.floor((thin.center[:, :2] - grid.origin) / 0.1).astype(int).T
    assert (grid.values[row, column] == 100).all()
    x, y = np.meshgrid(np.arange(1.05, 1.9, 0.1), np.arange(-0.35, 0.4, 0.1))
    pixel = np.floor((np.stack([y, x]) - np.array(grid.origin)[::-1, None, None]) / 0.1).astype(int)
    assert (grid.values[tuple(pixel)] == 100).mean() > 0.4  # 0.08 of occupied cells alone.


def test_behind_a_window_that_moves_the_grid_does_not_grow() -> None:
    m, grid, largest = ndtree.AdaptiveMap(dim=2), GridFollower(), 0
    ways = np.linspace(0, 2 * math.pi, 300)
    for step in range(100):
        origin = np.array([2.0 * step, 0.3 * step])
        m.insert(origin + 5 * np.stack([np.cos(ways), np.sin(ways)], axis=1), origin)
        m.keep_near(origin, 5.0)
        grid.follow(m.snapshot())
        assert grid.values is not None
        assert np.array_equal(grid.values, image_of(m, grid))
        largest = max(largest, grid.values.size)
    assert largest < 5 * (200 + 128) ** 2  # 200 pixels are known in each direction.


def test_a_grid_that_is_too_large_is_no_empty_one() -> None:
    m, grid = ndtree.AdaptiveMap(dim=2, min_cell_size=0.1), GridFollower(1e-4)
    m.mark([[0.0, 0.0], [10.0, 10.0]], "free")
    with pytest.raises(ValueError, match="pixels: at most"):
        grid.follow(m.snapshot())


@pytest.mark.parametrize(
    "wrong, said",
    [
        ((0.0,), "cell_size = "),
        ((-1.0,), "cell_size = "),
        ((math.nan,), "cell_size = "),
        ((None, (1.0, 1.0)), "height = 1 to 1 m"),
        ((None, None, 0.0), "wall_depth = 0 m"),
        ((None, None, math.nan), "wall_depth = nan m"),
    ],
)
def test_wrong_numbers_are_refused(wrong: Any, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        GridFollower(*wrong)


def test_points_are_the_occupied_cells() -> None:
    m = ndtree.AdaptiveMap(dim=3, min_cell_size=0.1)
    for scan in ndtree.simulate("apartment", scans=2):
        scan.insert_into(m)
    points, leaves = cell_points(m), m.leaves(states=["occupied"])
    assert len(points) == len(leaves) > 100
    for axis, name in enumerate("xyz"):
        assert np.allclose(points[name], leaves.center[:, axis], atol=1e-5)
    groups = by_size(points)
    assert [one.size for one in groups] == sorted({float(np.float32(size)) for size in leaves.size})
    assert sum(len(one.centers) for one in groups) == len(points)


@pytest.mark.parametrize("dim", [2, 3])
def test_occupied_cells_without_a_neighbour_are_speckles(dim: int) -> None:
    m = ndtree.AdaptiveMap(dim=dim, min_cell_size=0.1)
    rng = np.random.default_rng(2)
    cells = np.unique(rng.integers(0, 6 if dim == 3 else 9, (30, dim)), axis=0)
    for cell in cells:
        m.mark([0.1 * cell + 0.01, 0.1 * cell + 0.09], "occupied")
    m.mark([[4.01] * dim, [4.79] * dim], "occupied")  # Large cells are no speckles.
    apart = np.abs(cells[:, None] - cells[None]).max(2)
    lonely = (apart == 1).sum(1) == 0
    kept = cell_points(m, without_speckles=True)
    small = np.stack([kept[name] for name in "xyz"[:dim]], axis=1)[kept["size"] < 0.15]
    found = {tuple(one) for one in np.floor(small / 0.1).astype(int).tolist() if max(one) < 30}
    assert found == {tuple(one) for one in cells[~lonely].tolist()} and 0 < lonely.sum() < len(cells)
    assert len(cell_points(m)) - len(kept) == lonely.sum()
    assert len(cell_points(m, "free")) == 0


def test_changes_are_what_became_another_state() -> None:
    m = ndtree.AdaptiveMap(dim=2, min_cell_size=0.1)
    m.mark([[0.01, 0.01], [0.19, 0.09]], "free")
    before = m.snapshot()
    m.mark([[0.11, 0.01], [0.29, 0.09]], "occupied")
    points = changed_points(m.changes(since=before))
    found = {(round(float(p["x"]), 2), int(p["before"]), int(p["after"])) for p in points}
    assert found == {(0.15, 0, 1), (0.25, -1, 1)} and np.allclose(points["size"], 0.1)


@pytest.mark.parametrize("world, scans", [("office", 20), ("apartment", 3)])
def test_frontiers_look_into_the_unknown(world: Any, scans: int) -> None:
    log = ndtree.simulate(world, scans=scans)
    m, frontiers = ndtree.AdaptiveMap(dim=log.dim, min_cell_size=0.1), Frontiers(8.0)
    for scan in log:
        scan.insert_into(m)
        poses = frontiers.follow(m)
    expected = m.frontiers()
    assert len(poses) == len(expected) > 0
    goals = np.array([one.goal for one in expected])
    compared = 0
    for (x, y, z), (qx, qy, qz, qw) in poses:
        distances = np.linalg.norm(goals - [x, y, z][: log.dim], axis=1)
        assert distances.min() < 1e-5
        one = expected[distances.argmin()]
        if not one.direction.any():
            continue
        looks = [
            1 - 2 * (qy * qy + qz * qz),
            2 * (qx * qy + qz * qw),
            2 * (qx * qz - qy * qw),
        ]  # The first column of the rotation.
        assert np.allclose(looks[: log.dim], one.direction, atol=1e-6)
        compared += 1
    assert compared > 0.3 * len(poses)  # Others are a few cells that sparse beams did not see.


def test_a_grid_of_far_places_that_were_forgotten_shrinks() -> None:
    m, grid = ndtree.AdaptiveMap(dim=3), GridFollower(None, (0.1, 0.9))
    for corner in (0.0, 60.0):
        m.mark([[corner, corner, 0.0], [corner + 2.0, corner + 2.0, 1.0]], "free")
    grid.follow(m.snapshot())
    assert grid.values is not None
    whole = grid.values.size
    for low, high in ((59.0, 63.0), (1.5, 2.0)):  # It is seen to be too large when the next is forgotten.
        m.clear([[low, low, 0.0], [high, high, 1.0]])
        part = grid.follow(m.snapshot())
    assert part is not None and part.is_whole and grid.values.size < whole / 4
    np.testing.assert_array_equal(grid.values, image_of(m, grid, height=(0.1, 0.9)))


def test_a_listener_knows_nothing_where_heights_change_to_those_that_were_not_seen() -> None:
    """By the sink of the nodes, with nodes and messages that stand in for those of ROS."""
    from ndtree.live.passing import Passing

    names = ("geometry_msgs", "nav_msgs", "sensor_msgs", "std_msgs", "visualization_msgs")
    stubs = {name: mock.MagicMock() for one in names for name in (one, f"{one}.msg")}
    value = {"grid_cell_size": 0.0, "grid_low": 0.0, "grid_high": 0.5, "grid_above": "map"}
    value |= {"ground_slope": 0.3, "grid_wall_depth": 0.0, "grid_clear": 0.0}
    sent: list[Any] = []
    publisher = SimpleNamespace(publish=sent.append, listeners=lambda: 1)
    node = SimpleNamespace(value=value.__getitem__, publisher=lambda *_, **__: publisher)
    m, grids = ndtree.FixedMap(dim=3, cell_size=0.1), []
    m.mark([[3.0, 7.0, 0.0], [5.0, 8.0, 0.5]], "occupied")
    with mock.patch.dict(sys.modules, stubs):
        from ndtree.live.ros import sinks

        whole = mock.patch.object(
            sinks.messages, "grid_message", lambda values, _, place, *__: (values, place)
        )
        with whole:
            sink = sinks.GridSink(node, lambda: "map", SimpleNamespace(position=None), Passing(lambda: 0.0))
            for low in (0.0, 4.0, 0.0):
                value |= {"grid_low": low, "grid_high": low + 0.5}
                sink.update(m.snapshot(), 0.0)
                values, place = sent[-1]
                grids.append((values.copy(), place[:2]))
                np.testing.assert_array_equal(sink.whole()[0], values)
                assert sink.whole()[1] == place
    assert np.count_nonzero(grids[0][0] == 100) == 200 and (grids[1][0] == -1).all()
    np.testing.assert_array_equal(grids[2][0], grids[0][0])
    assert grids[0][1] == grids[1][1] == grids[2][1]
