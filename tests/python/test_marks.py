# SPDX-License-Identifier: BSD-3-Clause
"""What people and arms know better: `clear` and `mark` of boxes and bodies, against points in and around."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest

import ndtree

RNG = np.random.default_rng(77)
#: Dimension, children per axis, and how cells are refined.
KINDS = [
    (2, 2, "evidence"), (2, 3, "evidence"), (2, 2, "paper"), (2, 2, "fixed"), (2, 3, "fixed"),
    (3, 2, "evidence"), (3, 3, "evidence"), (3, 2, "paper"), (3, 2, "fixed"),
]  # fmt: skip
CELL = 0.1
STATES = {"free": 0, "occupied": 1}


def empty(dim: int, branching: int, kind: str, **options: Any) -> Any:
    if kind == "fixed":
        return ndtree.FixedMap(dim=dim, branching=branching, min_cell_size=CELL, **options)
    return ndtree.AdaptiveMap(
        dim=dim,
        branching=branching,
        refinement=kind,
        min_cell_size=CELL,
        max_cell_size=CELL * branching**3,
        **options,
    )


@pytest.fixture(params=KINDS, ids=str)
def room(request: Any) -> Any:
    """Walls at 2 m all around, seen from inside."""
    m = empty(*request.param, range_sigma=0.02)
    ways = RNG.normal(size=(1500, m.dim))
    m.insert(2.0 * ways / np.abs(ways).max(axis=1, keepdims=True), np.full(m.dim, 0.31))
    return m


def turned(dim: int, angle: float, position: Any) -> np.ndarray:
    pose = np.eye(dim + 1)
    c, s = np.cos(angle), np.sin(angle)
    pose[:2, :2] = [[c, -s], [s, c]]
    pose[:dim, dim] = position
    return pose


def depth_of(shape: str, points: np.ndarray) -> np.ndarray:
    """How far points lie outside of a body [m]; negative inside."""
    if shape == "sphere":
        return np.linalg.norm(points, axis=1) - 0.45
    if shape == "capsule":
        at = np.clip(points[:, 0], -0.5, 0.5)
        points = points.copy()
        points[:, 0] -= at
        return np.linalg.norm(points, axis=1) - 0.2
    half = np.array([0.7, 0.3, 0.4])[: points.shape[1]]
    outside = np.maximum(np.abs(points) - half, 0)
    return np.linalg.norm(outside, axis=1) + np.minimum((np.abs(points) - half).max(axis=1), 0)


def body_of(shape: str, dim: int) -> Any:
    if shape == "sphere":
        return ndtree.Sphere(0.45)
    if shape == "capsule":
        ends = np.zeros((2, dim))
        ends[:, 0] = -0.5, 0.5
        return ndtree.Capsule(*ends, 0.2)
    return ndtree.Box([1.4, 0.6, 0.8][:dim])


@pytest.mark.parametrize("shape", ["sphere", "capsule", "box"])
def test_space_in_a_body_changes_and_space_away_does_not(room: Any, shape: str) -> None:
    dim, body = room.dim, body_of(shape, room.dim)
    place = np.full(dim, 0.4)
    place[0] = 1.7  # Across a wall.
    pose = turned(dim, 0.6, place)
    points = RNG.uniform(-2.5, 2.9, (4000, dim))
    points[:2000] = place + RNG.uniform(-1.0, 1.0, (2000, dim))
    own = (points - place) @ pose[:dim, :dim]
    depth = depth_of(shape, own)
    inside, away = depth < -1e-9, depth > CELL * np.sqrt(dim) + 1e-6
    assert inside.sum() > 30 and away.sum() > 1000
    before = room.state(points)
    m = copy.copy(room)
    m.clear(body, pose)
    assert (m.state(points)[inside] == -1).all()
    np.testing.assert_array_equal(m.state(points)[away], before[away])
    assert not m.collides(body, [pose])[0] and room.collides(body, [pose])[0]
    for name, state in STATES.items():
        m = copy.copy(room)
        was = m.revision
        m.mark(body, name, pose)
        assert (m.state(points)[inside] == state).all()
        np.testing.assert_array_equal(m.state(points)[away], before[away])
        assert m.collides(body, [pose], unknown="occupied")[0] == (name == "occupied")
        changes = m.changes(since=was)
        assert (changes.after == state).all() and len(changes.after)
        # A change set has all that differs.
        differs = m.state(points) != before
        lower, size = changes.lower, changes.size[:, None]
        held = ((points[:, None] >= lower) & (points[:, None] < lower + size)).all(axis=2).any(axis=1)
        np.testing.assert_array_equal(held, differs)
        np.testing.assert_array_equal(was.state(points), before)
        once = m.to_bytes()
        m.mark(body, name, pose)
        assert m.to_bytes() == once


def test_a_box_of_corners_is_in_the_maps_frame(room: Any) -> None:
    dim = room.dim
    box = np.array([np.full(dim, -0.5), np.full(dim, 0.7)])
    points = RNG.uniform(-2.2, 2.2, (3000, dim))
    inside = ((points > -0.5) & (points < 0.7)).all(axis=1)
    away = ((points < -0.5 - CELL) | (points > 0.7 + CELL)).any(axis=1)
    before = room.state(points)
    for name, state in STATES.items():
        m = copy.copy(room)
        m.mark(box, name, beams=3)
        assert (m.state(points)[inside] == state).all()
        np.testing.assert_array_equal(m.state(points)[away], before[away])
    with pytest.raises(ValueError, match="a box of two corners has none"):
        room.mark(box, "free", np.zeros(3))
    with pytest.raises(ValueError, match="a box of two corners has none"):
        room.clear(box, np.zeros(3))


def test_poses_are_those_of_collides() -> None:
    m = empty(2, 2, "evidence")
    arm = ndtree.Capsule([0, 0], [1, 0], 0.1) | ndtree.Sphere(0.2)
    ways: list[Any] = [np.array([1.0, 2.0, 0.5]), turned(2, 0.5, [1.0, 2.0])]
    made = []
    for pose in ways:
        m = empty(2, 2, "evidence")
        m.mark(arm, "occupied", pose)
        made.append(m.to_bytes())
    assert made[0] == made[1]
    m = empty(2, 2, "evidence")
    m.mark(arm, "occupied")
    other = empty(2, 2, "evidence")
    other.mark(arm, "occupied", [0, 0, 0])
    assert m == other
    m = empty(3, 2, "evidence")
    m.mark(ndtree.Sphere(0.3), "occupied", [1, 2, 3, 0, 0, 0, 1])
    assert m.state([[1, 2, 3]])[0] == 1


def test_later_beams_may_change_a_mark() -> None:
    m = empty(2, 2, "evidence")
    m.mark([[0.9, -0.5], [1.1, 0.5]], "occupied")
    ends = np.stack([np.full(31, 3.0), np.linspace(-1, 1, 31)], axis=1)
    scans = 0
    while m.state([[1.0, 0.01]])[0] == 1:
        m.insert(ends, np.zeros(2))
        scans += 1
        assert scans < 40
    assert scans > 1
    more = empty(2, 2, "evidence")
    more.mark([[0.9, -0.5], [1.1, 0.5]], "occupied", beams=200)
    for _ in range(scans):
        more.insert(ends, np.zeros(2))
    assert more.state([[1.0, 0.01]])[0] == 1


def test_wrong_calls_change_nothing(room: Any) -> None:
    dim = room.dim
    before = room.to_bytes()
    ball = ndtree.Sphere(0.3)
    for call, said in (
        (lambda: room.mark(ball, "unknown"), "state = 'unknown': must be 'free' or 'occupied'; clear"),
        (lambda: room.mark(ball, "free", beams=0), "beams = 0: must be from 1 to 511"),
        (lambda: room.mark(ball, "free", beams=512), "beams = 512"),
        (lambda: room.mark(ball, "free", np.full(dim + 1, np.nan)[:, None]), "pose"),
        (lambda: room.mark(ndtree.Sphere(0.3, [0.0] * (5 - dim)), "free"), "coordinates in a map"),
        (lambda: room.mark(np.zeros((2, dim)), "free"), "where: from 0"),
        (lambda: room.mark(ball, "occupied", turned(dim, 0, np.full(dim, 1e14))), "of 0"),
    ):
        with pytest.raises(ValueError, match=said):
            call()
    for call in (lambda: room.mark(ball), lambda: room.mark("here", "free"), lambda: room.clear(None)):
        with pytest.raises(TypeError):
            call()
    assert room.to_bytes() == before


def test_a_map_of_four_dimensions_knows_boxes() -> None:
    m = ndtree.AdaptiveMap(dim=4, min_cell_size=0.5, max_cell_size=2.0)
    m.mark([np.zeros(4), np.ones(4)], "occupied")
    assert m.state([np.full(4, 0.3)])[0] == 1
    for call in (lambda: m.mark(ndtree.Sphere(0.3), "free"), lambda: m.clear(ndtree.Sphere(0.3))):
        with pytest.raises(ValueError, match="shapes are of maps with dim = 2 or 3"):
            call()


def test_values_of_layers_stay_under_a_mark() -> None:
    m = ndtree.AdaptiveMap(dim=2, min_cell_size=CELL, layers={"warm": "mean"})
    m.insert([[1.03, 0.02]], [0.0, 0.0], layers={"warm": [3.0]})
    m.mark(ndtree.Sphere(0.02), "free", [1.03, 0.02, 0.0])
    assert m.state([[1.03, 0.02]])[0] == 0 and m.layer("warm", [[1.03, 0.02]])[0] == 3.0
    m.clear(ndtree.Sphere(0.02), [1.03, 0.02, 0.0])
    assert np.isnan(m.layer("warm", [[1.03, 0.02]])[0])


def test_a_scan_history_gives_copies() -> None:
    history = ndtree.ScanHistory(dim=2)
    history.insert(1, [[1.0, 0.0]], [0.0, 0.0, 0.0])
    m = history.map
    m.mark(ndtree.Sphere(0.3), "occupied", [5.0, 0.0, 0.0])
    assert m.state([[5.0, 0.0]])[0] == 1 and history.map.state([[5.0, 0.0]])[0] == -1
    history.freeze(1)
    assert len(history) == 0 and history.num_frozen == 1 and history.map.state([[0.5, 0.0]])[0] == 0
    for count in (1, -1):
        with pytest.raises(ValueError, match=f"count = {count}"):
            history.freeze(count)


def test_maps_of_others_say_that_they_cannot() -> None:
    if not ndtree.has_octomap:
        pytest.skip("built without OctoMap")
    m = ndtree.OctoMap(min_cell_size=0.1)
    with pytest.raises(ValueError, match="a map of ndtree's own"):
        m.mark(ndtree.Sphere(0.3), "free")
