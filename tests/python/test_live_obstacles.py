# SPDX-License-Identifier: BSD-3-Clause
"""Obstacles around a robot: in each sector the nearest cell, which an oracle finds without a ray."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import ndtree
from ndtree.live import LiveMapper, ObstacleSink, ScansIntake, obstacle_distance, play
from ndtree.live.obstacles import NOT_KNOWN, SECTORS
from ndtree.tuning.config import Config

WIDTH = 2 * math.pi / SECTORS


def pillars(dim: int, seed: int) -> ndtree.OccupancyMap:
    """Single occupied cells at random places, seen from far above or from outside of nothing."""
    generator = np.random.default_rng(seed)
    m = ndtree.AdaptiveMap(dim=dim, min_cell_size=0.1)
    ends = np.floor(generator.uniform(-8, 8, (60 if dim == 2 else 200, dim)) / 0.1) * 0.1 + 0.05
    if dim == 3:
        ends[:, 2] *= 0.15
    ends = ends[np.linalg.norm(ends[:, :2], axis=1) > 0.5]
    for _ in range(5):
        m.insert(ends, ends - 0.01)
    return m


def nearest_by_hand(m: Any, position: Any, yaw: float, low: float, high: float, far: float) -> Any:
    """Least and largest distance that a sector may have: of points of cells, well inside and at all in it."""
    leaves = m.leaves(states=["occupied"])
    bounds = np.full((2, SECTORS), np.inf)
    steps = np.linspace(0, 1, 41)
    for lower, size in zip(leaves.lower, leaves.size):
        if m.dim == 3 and not (lower[2] < position[2] + high and lower[2] + size > position[2] + low):
            continue
        x, y = (np.add.outer(lower[:2], size * steps) - np.asarray(position)[:2, None])[:, :]
        points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        distance = np.hypot(*points.T)
        turn = (yaw - np.arctan2(points[:, 1], points[:, 0])) / WIDTH
        for number, at in enumerate((turn, turn)):
            sector = np.round(at).astype(int)
            inside = np.abs(at - sector) < (0.5 + 0.06 if number == 0 else 0.5 - 0.06)
            which = sector[inside] % SECTORS
            np.minimum.at(bounds[number], which, distance[inside])
        for shift in (-1, 1):  # On the border of two sectors.
            sector = np.round(turn).astype(int)
            near = np.abs(turn - sector - 0.5 * shift) < 0.06
            np.minimum.at(bounds[0], (sector[near] + shift) % SECTORS, distance[near])
    return bounds


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("seed", range(4))
def test_no_cell_is_missed_and_none_is_invented(dim: int, seed: int) -> None:
    m, generator = pillars(dim, seed), np.random.default_rng(100 + seed)
    yaw, far = float(generator.uniform(-3, 3)), 7.0
    position = np.zeros(dim)
    position[:2] = generator.uniform(-0.2, 0.2, 2)
    pose = [*position, yaw] if dim == 2 else [*position, 0, 0, math.sin(yaw / 2), math.cos(yaw / 2)]
    found = obstacle_distance(m, pose, max_distance=far, height=(-0.25, 0.35), unknown="free")
    assert found.distances.dtype == np.uint16 and found.max_distance == 700
    least, most = nearest_by_hand(m, position, yaw, -0.25, 0.35, far)
    told = np.where(found.distances == 701, np.inf, found.distances / 100)
    step = 0.01 + 0.1 / 40 * math.sqrt(2)
    for sector in range(SECTORS):
        assert told[sector] >= min(least[sector], far) - step or told[sector] == np.inf
        if most[sector] < far - 0.1:  # Rays are a cell apart: one meets it, on a corner a little later.
            assert told[sector] <= most[sector] + 0.15, sector
    assert 10 < np.count_nonzero(np.isfinite(told)) < SECTORS and np.count_nonzero(most < far - 0.1) > 10


def test_sectors_are_clockwise_from_ahead() -> None:
    m = ndtree.AdaptiveMap(dim=2, min_cell_size=0.1)
    ends = np.array([[3.05, 0.05], [0.05, -4.05]])  # Ahead, and to the right.
    m.insert(ends, [0.05, 0.05])
    told = obstacle_distance(m, [0.05, 0.05, 0.0], unknown="free").distances
    assert abs(int(told[0]) - 295) <= 1 and abs(int(told[18]) - 405) <= 6
    assert np.count_nonzero(told != 1001) <= 4
    turned = obstacle_distance(m, [0.05, 0.05, -math.pi / 2], unknown="free").distances
    assert turned[0] == told[18] and turned[54] == told[0]


def test_what_is_unknown_is_told_or_taken_for_something() -> None:
    m = ndtree.AdaptiveMap(dim=2, min_cell_size=0.1)
    angles = np.linspace(-1.0, 1.0, 600)  # It looks ahead alone.
    ways = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    for _ in range(3):
        m.insert(5.0 * ways, np.zeros(2))
    pose = [0.0, 0.0, 0.0]
    told = obstacle_distance(m, pose, max_distance=4.0).distances
    assert told[0] == 401 and told[36] == NOT_KNOWN and told[60:].tolist().count(401) > 6
    assert set(obstacle_distance(m, pose, max_distance=4.0, unknown="free").distances) == {401}
    taken = obstacle_distance(m, pose, max_distance=4.0, unknown="occupied").distances
    assert taken[0] == 401 and taken[36] < 30
    near = obstacle_distance(m, pose, max_distance=8.0, min_distance=6.0, unknown="free")
    assert near.distances[0] == near.min_distance == 600  # Nearer ones are not passed over.
    fields = near.as_dict()
    assert len(fields["distances"]) == 72 and fields["increment"] == 5 and fields["frame"] == 12


@pytest.mark.parametrize(
    "wrong, said",
    [
        ({"max_distance": 0.0}, "max_distance = 0 m: must be > 0 and <= 655.33"),
        ({"max_distance": 700.0}, "max_distance = 700 m"),
        ({"min_distance": 11.0}, "min_distance = 11 m: must be from 0 to max_distance = 10 m"),
        ({"height": (1.0, 0.0)}, "height = 1 to 0 m"),
        ({"unknown": "maybe"}, "unknown = 'maybe'"),
    ],
)
def test_wrong_numbers_are_refused(wrong: Any, said: str) -> None:
    m = ndtree.AdaptiveMap(dim=2)
    with pytest.raises(ValueError, match=said):
        obstacle_distance(m, [0, 0, 0], **wrong)
    with pytest.raises(ValueError, match="x axis points up or down"):
        half = math.sqrt(0.5)
        obstacle_distance(ndtree.AdaptiveMap(dim=3), [0, 0, 0, 0, half, 0, half])


def test_a_live_map_tells_what_is_around_the_robot() -> None:
    told, poses = [], [None, [0.0, 0.0, 0.0]]
    scans = list(ndtree.simulate("office", scans=5))

    def pose() -> Any:
        return poses[0]

    sink = ObstacleSink(pose, lambda one, stamp: told.append((one, stamp)), period=0.0, max_distance=5.0)
    with LiveMapper(ScansIntake(Config.of(no_return="free"), 2), sinks=[sink]) as mapper:
        play(((scan, 0.0) for scan in scans[:2]), mapper, rate=0)
    assert not told and not mapper.failures
    poses[0] = [*scans[-1].origin, 0.0]
    with LiveMapper(ScansIntake(Config.of(no_return="free"), 2), sinks=[sink]) as mapper:
        play(((scan, 0.0) for scan in scans), mapper, rate=0)
    last, stamp = told[-1]
    assert stamp == scans[-1].stamp
    expected = obstacle_distance(mapper.snapshot(), poses[0], max_distance=5.0)
    assert np.array_equal(last.distances, expected.distances) and (last.distances < 500).sum() > 10


def test_what_is_thinner_than_a_cell_is_an_obstacle() -> None:
    """For MAVLink, a body and the grid of nav2: of the beams, a third ends at a rod, others pass beside."""
    m = ndtree.AdaptiveMap(dim=2, min_cell_size=0.25)
    m.mark(ndtree.Box((6.0, 6.0)), "free", [0.0, 0.0, 0.0])
    rod, returned = np.array([1.125, 0.125]), np.arange(12) < 4
    ends = np.where(returned[:, None], rod, rod + np.array([0.5, 0.0]))
    for _ in range(6):
        m.insert(ends, rod - np.array([0.5, 0.0]), returned=returned)
    assert m.state([rod]) == 0 and m.leaves().thin.sum() == 1
    said = obstacle_distance(m, [-1.0, 0.125, 0.0], max_distance=4.0).distances
    assert said[0] == 200 and (said[10:60] > 300).all()
    assert m.collides(ndtree.Sphere(0.2), [[1.0, 0.0, 0.0]])
    assert np.count_nonzero(m.map_server_image()[0] == 0) == 1
