# SPDX-License-Identifier: BSD-3-Clause
"""Ways through a live map: followed as it grows, and to the nearest place where the robot fits."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import ndtree
from ndtree.live.routing import Router, _around

START, GOAL = np.array([-1.0, 0.0]), np.array([1.0, 0.0])


def square() -> Any:
    m = ndtree.AdaptiveMap(dim=2, min_cell_size=0.05, max_cell_size=1.6)
    m.mark([[-2.0, -2.0], [2.0, 2.0]], "free")
    return m


def test_ways_follow_the_map_and_other_maps() -> None:
    m, router = square(), Router()
    assert router.way(m, START, GOAL, 0.2).length == pytest.approx(2.0)
    m.mark([[0.0, -2.0], [0.1, 1.0]], "occupied")
    around = router.way(m, START, GOAL, 0.2)
    assert around.length > 2.5 and not router.way(m, START, GOAL, 0.6)
    fixed = ndtree.FixedMap(dim=2, cell_size=0.1)
    fixed.mark([[-2.0, -2.0], [2.0, 2.0]], "free")
    assert router.way(fixed, START, GOAL, 0.2).length == pytest.approx(2.0)


def test_a_goal_in_collision_is_moved_within_the_tolerance() -> None:
    m = square()
    m.mark([[0.9, -0.1], [1.1, 0.1]], "occupied")
    with pytest.raises(ValueError, match=r"goal = .* meets the occupied cell"):
        Router().way(m, START, GOAL, 0.2)
    with pytest.raises(ValueError, match="goal = "):
        Router().way(m, START, GOAL, 0.2, tolerance=0.2)
    way = Router().way(m, START, GOAL, 0.2, tolerance=0.5)
    assert way and 0.3 <= np.linalg.norm(way.points[-1] - GOAL) <= 0.45


def test_a_goal_is_moved_to_where_the_robot_gets_to() -> None:
    m = square()
    m.mark([[0.5, -2.0], [0.9, 2.0]], "occupied")  # A wall; behind it no way leads.
    goal = np.array([0.75, 0.0])
    assert not m.collides(ndtree.Sphere(0.2), [[1.15, 0.0]], unknown="occupied")[0]
    way = Router().way(m, START, goal, 0.2, tolerance=0.6)
    assert way and way.points[-1, 0] < 0.3
    assert "proved" in Router().way(m, START, goal, 0.2, tolerance=0.4).reason


def test_unknown_space_is_what_was_asked_for() -> None:
    m = square()
    m.clear([[-0.1, -2.0], [0.1, 2.0]])
    blocked = Router().way(m, START, GOAL, 0.2)
    assert not blocked and "proved" in blocked.reason
    assert Router("free").way(m, START, GOAL, 0.2).length == pytest.approx(2.0)


@pytest.mark.parametrize("dim", [2, 3])
def test_places_around_a_goal_lie_on_all_its_sides(dim: int) -> None:
    found = _around(np.zeros(dim), 0.5)
    away = np.linalg.norm(found, axis=1)
    assert (np.diff(away) > -1e-12).all() and away[0] > 0 and away[-1] == pytest.approx(0.5)
    key = {tuple(one) for one in np.round(found, 6).tolist()}
    assert {tuple(one) for one in np.round(0.0 - found, 6).tolist()} == key and len(key) == len(found)
    ends = {tuple(one) for one in (0.5 * np.concatenate([np.eye(dim), -np.eye(dim)])).tolist()}
    assert ends <= key
    assert not len(_around(np.zeros(dim), 0.0))
