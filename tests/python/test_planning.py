# SPDX-License-Identifier: BSD-3-Clause
"""What planners and explorers ask of a map, from Python: against dense grids and SciPy."""

import copy

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


def test_the_goal_of_a_frontier_is_a_cell_of_it(any_room):
    """Also of one that surrounds the robot, whose center is where the robot is."""
    way = np.random.default_rng(0).normal(size=(30000, any_room.dim))
    around = ndtree.AdaptiveMap(dim=any_room.dim, min_cell_size=0.1)
    origin = np.zeros(any_room.dim)
    around.insert(3 * way / np.linalg.norm(way, axis=1)[:, None], origin, returned=np.zeros(30000, bool))
    for m in (around, any_room):
        for frontier in m.frontiers(min_cells=5):
            apart = np.linalg.norm(frontier.cell_centers - frontier.goal, axis=1)
            assert apart.min() == 0 and m.state(frontier.goal[None])[0] == 0
    largest = around.frontiers(min_cells=5)[0]
    distances = np.linalg.norm(largest.cell_centers, axis=1)
    assert np.linalg.norm(largest.center) < distances.min(), "no cell of it is where its center is"
    assert np.linalg.norm(largest.goal) > distances.min() - 1e-9


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


def test_equal_maps_are_equal(any_room):
    same = copy.copy(any_room)
    assert same == any_room and not (same != any_room)
    same.insert(np.zeros((1, any_room.dim)), np.ones(any_room.dim))
    assert same != any_room
    assert any_room != "a map"
    with pytest.raises(TypeError, match="unhashable"):
        hash(any_room)
