# SPDX-License-Identifier: BSD-3-Clause
"""The ground of a 3-D map, and grids of what stands on it."""

from __future__ import annotations

import numpy as np
import pytest
from test_live_grid import Listener

import ndtree
from ndtree.cells.raster import pixels_in
from ndtree.live.grid import GroundFollower
from ndtree.maps.ground import ground_below

SIZE, CELL = 8.0, 0.1


def floor(x: np.ndarray, slope: float) -> np.ndarray:
    """Level until x = 2 m, then a ramp."""
    return slope * np.maximum(x - 2.0, 0.0)


def yard(slope: float) -> ndtree.AdaptiveMap:
    """A ramp with a box of 0.6 m on it, a table of which only the top is seen, and free space above."""
    m = ndtree.AdaptiveMap(dim=3, min_cell_size=CELL)
    middles = np.arange(0.5 * CELL, SIZE, CELL)
    for x in middles:
        z = CELL * np.floor(floor(np.array([x]), slope)[0] / CELL)
        m.mark([[x - 0.4 * CELL, 0.01, z + 0.01], [x + 0.4 * CELL, SIZE - 0.01, z + 0.09]], "occupied")
        m.mark([[x - 0.4 * CELL, 0.01, z + 0.11], [x + 0.4 * CELL, SIZE - 0.01, z + 1.99]], "free")
    box = floor(np.array([5.0]), slope)[0]
    m.mark([[5.01, 5.01, box + 0.01], [5.39, 5.39, box + 0.6]], "occupied")
    m.clear([[1.01, 1.01, -0.1], [1.59, 1.59, 0.71]])
    m.mark([[1.01, 1.01, 0.71], [1.59, 1.59, 0.79]], "occupied")
    return m


def test_the_ground_is_the_highest_surface_below_that_is_not_too_steep() -> None:
    rng = np.random.default_rng(4)
    for _ in range(20):
        rows, columns = rng.integers(1, 25, 2)
        levels = np.where(rng.random((rows, columns)) < 0.4, np.inf, rng.uniform(-1, 1, (rows, columns)))
        slope, pixel = rng.uniform(0, 2), rng.uniform(0.05, 0.5)
        at = np.stack(np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij"), -1).reshape(-1, 2)
        apart = np.abs(at[:, None] - at[None])
        levels_of = np.where((apart <= np.ceil(1.0 / pixel)).all(2), levels.reshape(1, -1), np.inf)
        expected = (levels_of + apart.sum(2) * slope * pixel).min(1).reshape(rows, columns)
        np.testing.assert_allclose(ground_below(levels, pixel, slope), expected, atol=1e-12)


def test_pixels_of_boxes_are_all_of_them_once() -> None:
    rng = np.random.default_rng(5)
    first = rng.integers(0, 10, (30, 2))
    last = first + rng.integers(0, 4, (30, 2))
    at, which = pixels_in(first, last, 20)
    found = sorted(zip(which.tolist(), at.tolist()))
    expected = [
        (i, y * 20 + x)
        for i in range(30)
        for y in range(first[i, 1], last[i, 1])
        for x in range(first[i, 0], last[i, 0])
    ]
    assert found == sorted(expected) and len(found) > 40
    none = np.zeros((0, 2), dtype=np.int64)
    assert not pixels_in(none, none, 5)[0].size


@pytest.mark.parametrize("slope", [0.0, 0.2])
def test_what_stands_on_a_ramp_is_in_the_grid_and_the_ramp_is_not(slope: float) -> None:
    m = yard(slope)
    grid = GroundFollower(None, (0.25, 1.5))
    grid.follow(m)
    assert grid.values is not None

    def at(x: float, y: float) -> int:
        column, row = (np.array([x, y]) - grid.origin) // grid.cell_size
        return int(grid.values[int(row), int(column)])

    places = np.arange(0.25, SIZE - 0.2, 0.3)
    seen = {(x, y): at(x, y) for x in places for y in places}
    box = {(x, y) for x, y in seen if 5.0 < x < 5.4 and 5.0 < y < 5.4}
    table = {(x, y) for x, y in seen if 1.0 < x < 1.6 and 1.0 < y < 1.6}
    assert len(box) >= 1 and len(table) >= 2
    assert {place for place, value in seen.items() if value == 100} == box | table
    assert all(value >= 0 for value in seen.values())


def test_of_a_cliff_the_edge_is_an_obstacle() -> None:
    m = ndtree.AdaptiveMap(dim=3, min_cell_size=CELL)
    m.mark([[0.01, 0.01, -0.09], [5.99, 3.99, -0.01]], "occupied")
    m.mark([[0.01, 0.01, 0.01], [5.99, 3.99, 1.99]], "free")
    m.mark([[6.01, 0.01, -9.99], [7.99, 3.99, 1.99]], "free")
    grid = GroundFollower(None, (0.2, 1.5))
    grid.follow(m)
    assert grid.values is not None
    row, column = ((2.05 - grid.origin[1]) // CELL, -grid.origin[0] // CELL)
    along = grid.values[int(row), int(column) : int(column) + 60]
    assert (along[:49] == 0).all() and not (along[51:] == 0).any()


def test_its_parts_make_it_whole_at_a_listener() -> None:
    scans = list(ndtree.simulate("apartment", scans=6))
    m, grid, listener = ndtree.AdaptiveMap(dim=3), GroundFollower(None, (0.15, 1.5)), Listener()
    assert grid.follow(m.snapshot()) is None
    for scan in scans:
        for half in (scan.only(slice(None, None, 2)), scan.only(slice(1, None, 2))):
            half.insert_into(m)
            listener.take(grid.follow(m.snapshot()))
            assert np.array_equal(listener.values, grid.values)
    assert grid.follow(m.snapshot()) is None and np.count_nonzero(grid.values == 100) > 50
    whole = GroundFollower(None, (0.15, 1.5))
    whole.follow(m)
    assert np.array_equal(whole.values, grid.values) and listener.parts > 0
    m.clear([[-100.0] * 3, [100.0] * 3])
    listener.take(grid.follow(m.snapshot()))
    assert (listener.values == -1).all()


def test_a_wrong_slope_is_refused() -> None:
    with pytest.raises(ValueError, match=r"slope = -1: must be >= 0 and finite"):
        GroundFollower(None, (0.1, 1.0), -1.0)
