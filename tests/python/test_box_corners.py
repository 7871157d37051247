# SPDX-License-Identifier: BSD-3-Clause
"""Boxes whose corners are decimal: each call takes the cells that the corners mean."""

import numpy as np
import pytest

import ndtree

CELLS = 10
SIZES = (0.05, 0.1, 0.2, 0.3, 0.7, 1 / 3)


def corners(size: float) -> list[tuple[int, tuple[float, float]]]:
    """Ways to write where cell i begins and ends: products, sums, and what a leaf says of itself."""
    sums = np.cumsum(np.full(CELLS + 1, size)) - size
    ways = []
    for i in range(CELLS):
        ways.append((i, (i * size, (i + 1) * size)))
        ways.append((i, (sums[i], sums[i + 1])))
        ways.append((i, (i * size, i * size + size)))
        ways.append((i, (round(i * size, 10), round((i + 1) * size, 10))))
    return ways


def row(size: float, refinement: str) -> ndtree.OccupancyMap:
    return ndtree.from_grid(np.ones((CELLS, 1), int), [0, 0], size, refinement=refinement)


def states(m: ndtree.OccupancyMap, size: float) -> list[int]:
    return m.state(np.c_[(np.arange(CELLS) + 0.5) * size, np.full(CELLS, 0.5 * size)]).tolist()


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("refinement", ["fixed", "evidence"])
def test_clear_and_crop_take_the_cells_that_decimal_corners_mean(size: float, refinement: str) -> None:
    for i, (begin, end) in corners(size):
        box = [[begin, 0.0], [end, size]]
        m = row(size, refinement)
        m.clear(box)
        assert states(m, size) == [-1 if j == i else 1 for j in range(CELLS)], (i, begin, end)
        m = row(size, refinement)
        m.crop(box)
        expected = [i] if refinement == "fixed" else range(CELLS)  # Larger leaves stay whole.
        assert states(m, size)[i] == 1
        assert all(s == -1 for j, s in enumerate(states(m, size)) if j not in expected), (i, begin, end)


@pytest.mark.parametrize("size", SIZES)
def test_windows_leaves_and_grids_take_the_same_cells(size: float) -> None:
    m = row(size, "fixed")
    for i, (begin, end) in corners(size):
        box = [[begin, 0.0], [end, size]]
        # The box is closed: neighbours share a border with it.
        neighbours = [j for j in (i - 1, i, i + 1) if 0 <= j < CELLS]
        found = m.leaves(box, states=["occupied"])
        assert np.rint(found.lower[:, 0] / size).astype(int).tolist() == neighbours, (begin, end)
        window = ndtree.FixedMap(dim=2, min_cell_size=size)
        ends = np.c_[(np.arange(CELLS) + 0.5) * size, np.full(CELLS, 0.5 * size)]
        window.insert(ends, [0.5 * size, -3 * size], window=box)
        observed = window.leaves()
        inside = observed.lower[observed.observed]
        assert set(np.rint(inside[:, 0] / size).astype(int)) == {i}, (begin, end)
        assert set(np.rint(inside[:, 1] / size).astype(int)) == {0}
        field = m.distance_field(box, size)
        assert field.values.shape == (1, 1)
