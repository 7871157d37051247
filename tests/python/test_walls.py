# SPDX-License-Identifier: BSD-3-Clause
"""What stands is not passed, what left is gone, what was not seen is unknown: with exact truth."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import ndtree

Floats = np.ndarray


def both(cell: float, sigma: float, branching: int = 2, dim: int = 2) -> list[Any]:
    """An adaptive map and one of equal cells."""
    return [
        ndtree.AdaptiveMap(dim=dim, branching=branching, min_cell_size=cell, range_sigma=sigma),
        ndtree.FixedMap(dim=dim, min_cell_size=cell, range_sigma=sigma),
    ]


@np.errstate(divide="ignore", invalid="ignore")
def in_room(origin: Floats, directions: Floats, box: Floats | None) -> tuple[Floats, Floats]:
    """Ranges in a room of 12 x 8 m about 0, and which beams end at a box (2, 2) in it."""
    half = np.array([6.0, 4.0])
    far = np.where(directions > 0, half - origin, -half - origin) / directions
    ranges = np.where(directions == 0, np.inf, far).min(1)
    if box is None:
        return ranges, np.zeros(len(ranges), bool)
    first, second = (box[0] - origin) / directions, (box[1] - origin) / directions
    near, past = np.minimum(first, second).max(1), np.maximum(first, second).min(1)
    meets = (near < past) & (near > 0) & (near < ranges)
    return np.where(meets, near, ranges), meets


@pytest.mark.parametrize(
    ("cell", "stood", "step"), [(0.05, 6, 0.0), (0.05, 20, 0.02), (0.1, 3, 0.02), (0.1, 12, 0.0)]
)
def test_what_stood_is_gone_after_as_many_scans_or_sixteen(cell: float, stood: int, step: float) -> None:
    rng = np.random.default_rng(stood)
    angles = np.linspace(-2.3, 2.3, 271)
    directions = np.c_[np.cos(angles), np.sin(angles)]
    box = np.array([[2.5, 0.4], [3.0, 1.1]])
    maps, left = both(cell, 0.03), []
    for i in range(stood + min(stood, 15) + 1):  # The first that passes may pass but a corner.
        origin = np.array([0.013 + step * i, 0.021])
        ranges, meets = in_room(origin, directions, box if i < stood else None)
        ends = origin + directions * (ranges + rng.normal(0, 0.01, len(ranges)))[:, None]
        left.append(ends[meets])
        for m in maps:
            m.insert(ends, origin)
    of_box = np.concatenate(left)
    wall = np.c_[np.full(50, 6.02), np.linspace(-1.0, 2.5, 50)]
    ghosts = [100 * np.mean(m.state(of_box) == 1) for m in maps]
    assert ghosts[0] <= ghosts[1] + 2.0, (
        f"of its points {ghosts[0]:.0f} % stay, {ghosts[1]:.0f} % in equal cells"
    )
    assert np.mean(maps[0].nearest_occupied(wall, max_distance=1.0).distance < 0.1) > 0.9, "the wall stands"


def test_a_ray_ends_in_a_cell_that_holds_something_only_before_the_unknown() -> None:
    m = ndtree.AdaptiveMap(dim=2, min_cell_size=0.1, range_sigma=0.01)
    beside = np.c_[np.full(61, 3.0), np.linspace(-0.3, 0.3, 61)]
    rod = np.c_[np.full(6, 1.45), np.linspace(0.045, 0.055, 6)]
    for i in range(30):
        m.insert(np.r_[beside + np.array([0, 0.0003 * i]), rod], [0.02, 0.031])
    assert m.state(rod)[0] == 0 and 0.44 < m.probability(rod)[0] < 0.5
    origin, ahead = [0.02, 0.051], [[1.0, 0.0]]
    assert m.cast_rays(origin, ahead, max_range=20)[0] > 2.9, "behind it is free space, and a wall"
    m.clear([[1.5, -1.0], [2.5, 1.0]])
    assert m.cast_rays(origin, ahead, max_range=20)[0] == pytest.approx(1.4, abs=0.1)
    assert m.cast_rays(origin, ahead, max_range=1.3)[0] != m.cast_rays(origin, ahead, max_range=1.3)[0]
    details = m.cast_rays(origin, ahead, max_range=20, details=True)
    assert details.state[0] == 1 and details.size[0] == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("cell", "sigma", "half"), [(0.05, 0.001, 0.78), (0.1, 0.005, 0.82), (0.05, 0.005, 0.99)]
)
def test_walls_that_a_precise_sensor_grazes_stand(cell: float, sigma: float, half: float) -> None:
    """A smooth corridor, seen on a short way: walls are met at 60 to 78 degrees, and passed more often."""
    rng = np.random.default_rng(5)
    m = both(cell, sigma)[0]
    angles = np.radians(np.arange(-89.75, 90.0, 0.5))
    directions = np.c_[np.cos(angles), np.sin(angles)]
    ranges = half / np.abs(directions[:, 1])
    met = []
    for x in np.linspace(0.0, 1.5, 60):
        near = ranges < 12.0
        told = (ranges + rng.normal(0, sigma, len(ranges)))[near, None]
        origin = np.array([x, 0.0])
        m.insert(origin + directions[near] * told, origin)
        met.append(origin + directions[near] * ranges[near, None])
    wall = np.concatenate(met)
    wall = wall[(wall[:, 0] > 2.5) & (wall[:, 0] < 3.8 * half + 1.0)]
    lost = np.asarray(m.nearest_occupied(wall, max_distance=1.0).distance) > 1.5 * cell
    assert len(wall) > 300 and np.mean(lost) < 0.02
