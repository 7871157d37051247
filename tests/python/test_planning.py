# SPDX-License-Identifier: BSD-3-Clause
"""What planners and explorers ask of a map, from Python: against dense grids and SciPy."""

import copy
import threading

import numpy as np
import pytest

import ndtree

RNG = np.random.default_rng(41)
MAPS = {
    "adaptive": lambda dim: ndtree.AdaptiveMap(
        dim=dim, min_cell_size=0.1, max_cell_size=1.6, range_sigma=0.02
    ),
    "paper": lambda dim: ndtree.AdaptiveMap(
        dim=dim, refinement="paper", min_cell_size=0.1, max_cell_size=1.6, range_sigma=0.02
    ),
    "fixed": lambda dim: ndtree.FixedMap(dim=dim, min_cell_size=0.1, range_sigma=0.02),
}


def room(dim, kind="adaptive"):
    """A room of 4 m with a pillar, seen from two places; behind a door in one wall it is mostly unseen."""
    m = MAPS[kind](dim)
    for x in (0.53, -0.81):
        origin = np.full(dim, 0.37)
        origin[0] = x
        directions = RNG.normal(size=(1500 if dim == 2 else 6000, dim))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        with np.errstate(divide="ignore"):
            walls = np.where(directions > 0, (2.0 - origin) / directions, (-2.0 - origin) / directions)
        ranges = walls.min(axis=1)
        returned = ~((directions[:, 0] > 0.9) & (ranges > 0))
        m.insert(origin + directions * ranges[:, None], origin, returned=returned)
    return m


@pytest.fixture(scope="module", params=[(2, kind) for kind in MAPS] + [(3, "adaptive")], ids=str)
def any_room(request):
    return room(*request.param)


def test_bounds_are_those_of_the_observed_leaves(any_room):
    leaves = any_room.leaves()
    lower, upper = any_room.bounds()
    np.testing.assert_array_equal(lower, leaves.lower[leaves.observed].min(axis=0))
    np.testing.assert_array_equal(upper, (leaves.lower + leaves.size[:, None])[leaves.observed].max(axis=0))
    assert ndtree.AdaptiveMap(dim=2).bounds() is None


def test_leaves_of_a_box_and_of_states_are_some_of_all(any_room):
    box = np.array([np.full(any_room.dim, -1.03), np.full(any_room.dim, 0.71)])
    every = any_room.leaves()
    touches = (every.lower <= box[1]).all(axis=1) & (every.lower + every.size[:, None] >= box[0]).all(axis=1)
    for names, states in ((("occupied",), [1]), (("free", "unknown"), [0, -1]), (None, [-1, 0, 1])):
        some = any_room.leaves(box, states=names)
        expected = touches & np.isin(every.state, states)
        np.testing.assert_array_equal(some.lower, every.lower[expected])
        np.testing.assert_array_equal(some.log_odds, every.log_odds[expected])
    assert len(any_room.leaves(states=("occupied",)).size) == (every.state == 1).sum() > 10
    with pytest.raises(ValueError, match="states: 'full'"):
        any_room.leaves(states=("full",))
    with pytest.raises(ValueError, match=r"box has shape \(1, "):
        any_room.leaves(box[:1])


def test_the_nearest_point_is_as_far_as_the_distance_says(any_room):
    points = RNG.uniform(-3, 3, (300, any_room.dim))
    nearest = any_room.nearest_occupied(points)
    np.testing.assert_array_equal(nearest.distance, any_room.distance_to_occupied(points))
    np.testing.assert_allclose(np.linalg.norm(nearest.point - points, axis=1), nearest.distance, atol=1e-12)
    near = any_room.nearest_occupied(points, max_distance=0.3)
    far = nearest.distance > 0.3
    assert 0 < far.sum() < 300
    assert np.isinf(near.distance[far]).all() and np.isnan(near.point[far]).all()
    np.testing.assert_array_equal(near.distance[~far], nearest.distance[~far])


def test_rays_that_stop_at_unknown_space_end_before_it(any_room):
    directions = RNG.normal(size=(200, any_room.dim))
    origin = np.full(any_room.dim, 0.3)
    plain = any_room.cast_rays(origin, directions, max_range=9.0, at="cell")
    ends = any_room.cast_rays(origin, directions, max_range=9.0, details=True, at="cell")
    np.testing.assert_array_equal(plain, ends.distance)
    hit = np.isfinite(plain)
    assert (ends.state[hit] == 1).all() and (ends.state[~hit] == 0).all()
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    at = origin + (plain[hit] + 1e-6)[:, None] * unit[hit]
    assert (at >= ends.lower[hit] - 2e-6).all() and (
        at <= (ends.lower + ends.size[:, None])[hit] + 2e-6
    ).all()
    stopped = any_room.cast_rays(origin, directions, max_range=9.0, unknown="stop", details=True, at="cell")
    np.testing.assert_array_equal(
        stopped.distance, any_room.cast_rays(origin, directions, max_range=9.0, unknown="stop", at="cell")
    )
    assert np.isfinite(stopped.distance).all(), "somewhere it ends"
    assert set(stopped.state) == {-1, 1}
    for share in np.linspace(0.0, 0.99, 20):
        on_way = origin + (share * stopped.distance)[:, None] * unit
        assert (any_room.state(on_way)[stopped.distance > 1e-6] == 0).all()
    with pytest.raises(ValueError, match="unknown = 'no'"):
        any_room.cast_rays(origin, directions, unknown="no")


def test_rays_at_the_surface_end_a_little_behind_the_entry(any_room):
    directions = RNG.normal(size=(200, any_room.dim))
    origin = np.full(any_room.dim, 0.3)
    for unknown in ("pass", "stop"):
        asked = {"max_range": 9.0, "unknown": unknown, "details": True}
        cell = any_room.cast_rays(origin, directions, at="cell", **asked)
        surface = any_room.cast_rays(origin, directions, **asked)
        for name in ("state", "lower", "size"):
            np.testing.assert_array_equal(getattr(surface, name), getattr(cell, name))
        np.testing.assert_array_equal(
            surface.distance,
            any_room.cast_rays(origin, directions, max_range=9.0, unknown=unknown, at="surface"),
        )
        met = cell.state == 1
        assert met.sum() > 20
        depth = (surface.distance - cell.distance)[met]
        assert (depth > 0.0).all() and (depth <= 0.75 * any_room.min_cell_size * (1 + 1e-9)).all()
        assert np.unique(np.round(depth, 4)).size > 10
        np.testing.assert_array_equal(surface.distance[~met], cell.distance[~met])
    with pytest.raises(ValueError, match="at = 'wall': must be 'cell' or 'surface'"):
        any_room.cast_rays(origin, directions, at="wall")


@pytest.mark.parametrize("unknown", ["free", "occupied"])
def test_a_distance_field_is_scipys_up_to_where_cells_begin(any_room, unknown):
    edt = pytest.importorskip("scipy.ndimage").distance_transform_edt
    dim = any_room.dim
    box = np.array([np.full(dim, -2.8), np.full(dim, 3.1)])
    field = any_room.distance_field(box, 0.1, max_distance=1.5, unknown=unknown)
    grid = any_room.to_grid(box, 0.1)
    assert field.values.shape == grid.shape
    obstacle = (grid == 1) | ((grid == -1) & (unknown == "occupied"))
    inner = tuple(slice(16, -16) for _ in range(dim))  # As far from the border as a distance may be.
    assert (np.sign(field.values) == np.where(obstacle, -1, 1)).all()
    # SciPy measures to centres: at least half a cell more, at most half its diagonal.
    outside = edt(~obstacle) * 0.1
    inside = edt(obstacle) * 0.1
    plain = np.where(obstacle, -inside, outside)[inner]
    excess = np.abs(plain) - np.abs(field.values[inner])
    known = np.abs(field.values[inner]) < 1.4
    assert known.sum() > 100
    assert excess[known].min() > 0.05 - 1e-5
    assert excess[known].max() < 0.05 * np.sqrt(dim) + 1e-5


def test_gradients_of_a_field_lead_away_from_obstacles():
    m = room(2)
    field = m.distance_field([[-2.5, -2.5], [2.5, 2.5]], 0.05)
    points = RNG.uniform(-1.5, 1.5, (500, 2))
    gradient = field.gradient(points)
    ends = points + 0.01 * gradient
    between = [np.floor((at + 2.5) / 0.05 - 0.5) for at in (points, ends)]  # At centres it has kinks.
    smooth = (between[0] == between[1]).all(axis=1)
    assert smooth.sum() > 300
    np.testing.assert_allclose(
        (field.distance(ends) - field.distance(points))[smooth],
        0.01 * (gradient**2).sum(axis=1)[smooth],
        atol=0.002,
    )
    free = field.distance(points) > 0.1
    assert np.median(np.linalg.norm(gradient[free], axis=1)) == pytest.approx(1.0, abs=0.05)
    assert np.isnan(field.distance([[9.0, 9.0]])).all() and np.isnan(field.gradient([[9.0, 9.0]])).all()
    with pytest.raises(ValueError, match="cell_size"):
        m.distance_field([[0, 0], [1, 1]], 0.0)
    with pytest.raises(ValueError, match="box: from"):
        m.distance_field([[0, 0], [0, 1]], 0.1)


def test_frontiers_lie_where_free_space_ends(any_room):
    frontiers = any_room.frontiers(min_cells=0)
    assert frontiers
    for frontier in frontiers:
        assert (any_room.state(frontier.cells + 0.5 * frontier.size[:, None]) == 0).all()
    assert [f.area for f in frontiers] == sorted((f.area for f in frontiers), reverse=True)
    # The border of free cells with anything unknown, counted on a grid of smallest cells.
    grid = any_room.to_grid([np.full(any_room.dim, -6.4), np.full(any_room.dim, 6.4)], 0.1)
    faces = sum(
        ((np.take(grid, range(1, 128), axis) == a) & (np.take(grid, range(127), axis) == b)).sum()
        for axis in range(any_room.dim)
        for a, b in ((0, -1), (-1, 0))
    )
    total = sum(f.area for f in frontiers)
    assert total == pytest.approx(faces * 0.1 ** (any_room.dim - 1), rel=1e-6)
    large = any_room.frontiers(min_cells=20)
    assert len(large) == sum(f.area > 20 * 0.1 ** (any_room.dim - 1) * (1 - 1e-9) for f in frontiers)


def test_the_goal_of_a_frontier_is_a_cell_of_it(any_room):
    """Also of one that surrounds the robot, whose center is where the robot is."""
    way = np.random.default_rng(0).normal(size=(3000, any_room.dim))
    around = ndtree.AdaptiveMap(dim=any_room.dim, min_cell_size=0.1)
    origin = np.zeros(any_room.dim)
    around.insert(3 * way / np.linalg.norm(way, axis=1)[:, None], origin, returned=np.zeros(3000, bool))
    for m in (around, any_room):
        for frontier in m.frontiers(min_cells=5):
            apart = np.linalg.norm(frontier.cell_centers - frontier.goal, axis=1)
            assert apart.min() == 0 and m.state(frontier.goal[None])[0] == 0
    largest = around.frontiers(min_cells=5)[0]
    distances = np.linalg.norm(largest.cell_centers, axis=1)
    assert np.linalg.norm(largest.center) < distances.min() / 2, "no cell of it is where its center is"
    assert np.linalg.norm(largest.goal) >= distances.min()


def test_bodies_collide_as_the_field_says():
    m = room(2)
    poses = np.c_[RNG.uniform(-2.3, 2.3, (400, 2)), RNG.uniform(-3, 3, 400)]
    disc = m.collides(ndtree.Sphere(0.3), poses)
    np.testing.assert_array_equal(disc, m.occupied_within(poses[:, :2], 0.3))
    assert 0 < disc.sum() < 400
    body = ndtree.Sphere(0.1, (0.5, 0.0)) | ndtree.Box((0.4, 0.2))
    turned = poses[:, :2] + 0.5 * np.c_[np.cos(poses[:, 2]), np.sin(poses[:, 2])]
    assert (m.collides(body, poses) >= m.occupied_within(turned, 0.1)).all()
    matrices = np.zeros((400, 3, 3))
    cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    matrices[:, 0, 0], matrices[:, 0, 1], matrices[:, 1, 0], matrices[:, 1, 1] = cos, -sin, sin, cos
    matrices[:, :2, 2], matrices[:, 2, 2] = poses[:, :2], 1.0
    np.testing.assert_array_equal(m.collides(body, poses), m.collides(body, matrices))
    careful = m.collides(body, poses, unknown="occupied")
    assert (careful >= m.collides(body, poses)).all()
    assert "Sphere" in repr(body) and "Box" in repr(body)


def test_a_path_collides_between_its_poses():
    m = room(2)
    start, end = [0.0, -1.0, 0.0], [0.0, 1.0, 0.5]
    beyond = [0.0, 9.0, 0.0]  # Through the wall.
    body = ndtree.Capsule((-0.2, 0.0), (0.2, 0.0), 0.1)
    assert m.path_collides(body, [start, end]) == -1
    assert m.path_collides(body, [start, end, beyond]) == 2
    assert not m.collides(body, [beyond])[0]
    assert m.path_collides(body, [[0.0, 2.05, 0.0], end]) == 0
    with pytest.raises(ValueError, match=r"poses has shape \(2, 4\)"):
        m.collides(body, np.zeros((2, 4)))
    with pytest.raises(ValueError, match="pose 0: its rotation is not one"):
        m.collides(body, 2 * np.eye(3)[None])
    with pytest.raises(ValueError, match="radius = -1"):
        ndtree.Sphere(-1.0)
    with pytest.raises(ValueError, match="3 coordinates in a map with dim = 2"):
        m.collides(ndtree.Sphere(0.1, (0, 0, 0)), [start])


def test_what_is_forgotten_is_unknown(any_room):
    dim = any_room.dim
    points = RNG.uniform(-2.2, 2.2, (2000, dim))
    before = any_room.state(points)
    m = copy.copy(any_room)
    m.clear([np.full(dim, -0.5), np.full(dim, 0.7)])
    inside = ((points > -0.5) & (points < 0.7)).all(axis=1)
    away = ((points < -0.6) | (points > 0.8)).any(axis=1)
    assert (m.state(points)[inside] == -1).all()
    np.testing.assert_array_equal(m.state(points)[away], before[away])
    m = copy.copy(any_room)
    m.keep_near(np.zeros(dim), 1.0)
    near = np.linalg.norm(points, axis=1) < 1.0
    np.testing.assert_array_equal(m.state(points)[near], before[near])
    assert m.stats().observed_leaves < any_room.stats().observed_leaves
    m.crop([np.full(dim, 50.0), np.full(dim, 51.0)])
    assert m.bounds() is None and m.stats().leaves == 1
    with pytest.raises(ValueError, match="radius"):
        m.keep_near(np.zeros(dim), 0.0)
    m = copy.copy(any_room)
    m.keep_near(np.zeros(dim), np.inf)
    assert m == any_room
    with pytest.raises(ValueError, match="radius = nan"):
        m.keep_near(np.zeros(dim), np.nan)


def test_equal_maps_are_equal(any_room):
    same = copy.copy(any_room)
    assert same == any_room and not (same != any_room)
    same.insert(np.zeros((1, any_room.dim)), np.ones(any_room.dim))
    assert same != any_room
    assert any_room != "a map"
    with pytest.raises(TypeError, match="unhashable"):
        hash(any_room)


def test_maps_of_others_say_that_they_cannot():
    if not ndtree.has_octomap:
        pytest.skip("built without OctoMap")
    m = ndtree.OctoMap(min_cell_size=0.1)
    for call in (m.bounds, m.frontiers, lambda: m.keep_near(np.zeros(3), 1.0)):
        with pytest.raises(ValueError, match="a map of ndtree's own"):
            call()


def test_queries_run_beside_an_insertion():
    m = room(2)
    failed = []

    def ask():
        try:
            for _ in range(20):
                m.frontiers()
                m.distance_field([[-2, -2], [2, 2]], 0.1)
        except Exception as error:
            failed.append(error)

    threads = [threading.Thread(target=ask) for _ in range(2)]
    for thread in threads:
        thread.start()
    for _ in range(20):
        m.insert(RNG.uniform(-2, 2, (500, 2)), np.zeros(2))
    for thread in threads:
        thread.join()
    assert not failed
