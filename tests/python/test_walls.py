# SPDX-License-Identifier: BSD-3-Clause
"""What stands is not passed, what left is gone, what was not seen is unknown: with exact truth."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ndtree
from ndtree.maps.open import open_map

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


@pytest.mark.parametrize("cell", [0.05, 0.1])
@pytest.mark.parametrize("stood", [3, 6, 12, 20])
@pytest.mark.parametrize("step", [0.0, 0.02])
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


@pytest.mark.parametrize("branching", [2, 3])
@pytest.mark.parametrize("sigma", [0.003, 0.02])
@pytest.mark.parametrize("turn", [0.0, 0.1, 0.6])
def test_rays_end_at_a_wall_that_is_grazed(branching: int, sigma: float, turn: float) -> None:
    rng = np.random.default_rng(3)
    c, s = np.cos(turn), np.sin(turn)
    rotation = np.array([[c, -s], [s, c]])
    maps = both(0.1, max(sigma, 0.01), branching)
    at_wall = np.arange(-4.0, 4.0, 0.02)
    for offset in np.arange(0.0, 0.4, 0.02):
        origin = np.array([0.013, 0.021 + offset])
        wall = np.c_[np.full(len(at_wall), 0.98), at_wall]
        way = wall - origin
        length = np.linalg.norm(way, axis=1, keepdims=True)
        ends = origin + way * (1 + rng.normal(0, sigma, length.shape) / length)
        for m in maps:
            m.insert(ends @ rotation.T, rotation @ origin)
    origin = np.array([0.013, 0.2])
    targets = np.c_[np.full(3000, 0.98), rng.uniform(-3.8, 3.8, 3000)]
    way = (targets - origin) @ rotation.T
    far = np.linalg.norm(way, axis=1)
    ends = [np.asarray(m.cast_rays(rotation @ origin, way, max_range=20)) for m in maps]
    passes = [~(found < far + 0.4) for found in ends]
    assert np.mean(passes[0] & ~passes[1]) <= 0.005
    stopped = maps[0].cast_rays(rotation @ origin, way, max_range=20, unknown="stop")
    assert (np.asarray(stopped)[~passes[0]] <= ends[0][~passes[0]] + 1e-9).all()


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


@pytest.mark.parametrize("branching", [2, 3])
def test_large_cells_are_free_only_where_they_were_seen(branching: int) -> None:
    m = ndtree.AdaptiveMap(dim=2, branching=branching, min_cell_size=0.05, range_sigma=0.01)
    angles = np.linspace(0.0, 0.5, 300)  # Above a line from the origin, and not below.
    turn = np.array([[np.cos(0.3), -np.sin(0.3)], [np.sin(0.3), np.cos(0.3)]])
    directions = np.c_[np.cos(angles), np.sin(angles)] @ turn.T
    for _ in range(10):
        m.insert([0.02, 0.03] + 6 * directions, [0.02, 0.03], returned=np.zeros(300, bool))
    across = np.random.default_rng(0).uniform([1.0, -1.0], [5.5, 0.0], (4000, 2))
    below = [0.02, 0.03] + across @ turn.T
    free = across[m.state(below) == 0]
    assert len(free) > 20 and free[:, 1].min() > -0.05 * 2 * np.sqrt(2) - 0.05


def test_far_walls_in_images_are_as_thick_as_their_noise(tmp_path: Path) -> None:
    yaml = pytest.importorskip("yaml")
    rng = np.random.default_rng(1)
    m = ndtree.AdaptiveMap(dim=2, min_cell_size=0.05, range_sigma=0.01, range_sigma_quadratic=0.004)
    angles = np.linspace(-0.5, 0.5, 400)
    for i in range(60):
        origin = np.array([0.013, 0.02 * i - 0.6])
        length = 8.0 / np.cos(angles)
        noisy = length + rng.normal(0, 1, 400) * (0.01 + 0.004 * length**2)
        m.insert(origin + np.c_[np.cos(angles), np.sin(angles)] * noisy[:, None], origin)

    def thickness(**options: Any) -> float:
        ndtree.convert(m, tmp_path / "far.yaml", **options)
        assert yaml.safe_load((tmp_path / "far.yaml").read_text())["resolution"] == 0.05
        image = open_map(tmp_path / "far.yaml").map
        wall = np.c_[np.arange(6.5, 10.0, 0.05) + 0.025, np.zeros(70)]
        rows = [image.state(wall + np.array([0, y])) == 1 for y in np.arange(-2.0, 2.0, 0.1)]
        assert all(row.any() for row in rows), "no hole"
        return 0.05 * float(np.mean([row.sum() for row in rows]))

    assert thickness(wall_depth=np.inf) > 0.4
    assert thickness() < 0.3
    assert thickness(wall_depth=0.3) > thickness()


@pytest.mark.parametrize("cell", [0.05, 0.1])
@pytest.mark.parametrize("sigma", [0.001, 0.005])
@pytest.mark.parametrize("half", [0.78, 0.82, 0.99])
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
