# SPDX-License-Identifier: BSD-3-Clause
"""What maps write and give as arrays is what they say when they are asked point by point."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import with_room

import ndtree


def room(dim: int, branching: int = 2, cls: type = ndtree.AdaptiveMap) -> Any:
    size = {"cell_size": 0.1} if cls is ndtree.FixedMap else {"min_cell_size": 0.1, "max_cell_size": 1.6}
    return with_room(cls(dim=dim, branching=branching, **size), 3, 500)


def centres(lower: np.ndarray, shape: tuple[int, ...], cell_size: float) -> np.ndarray:
    """(i, j, ..., dim): where the cells of a grid have their centres."""
    indices = np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"), axis=-1)
    return lower + (indices + 0.5) * cell_size


def test_grids_of_cells_no_larger_than_the_maps_hold_what_it_says_at_their_centres(
    shape: tuple[int, int],
) -> None:
    branching, dim = shape
    m = room(dim, branching)
    lower = np.array([-2.3, -1.7, -0.4, 0.0])[:dim]
    for cell_size, counts in ((0.1, (40, 33, 12, 2)), (0.035, (51, 39, 15, 3))):
        upper = lower + np.array(counts[:dim]) * cell_size
        grid = m.to_grid([lower, upper], cell_size)
        assert grid.dtype == np.int8 and grid.shape == counts[:dim]
        points = centres(lower, grid.shape, cell_size).reshape(-1, dim)
        np.testing.assert_array_equal(grid.ravel(), m.state(points))
        probability = m.to_grid([lower, upper], cell_size, values="probability")
        np.testing.assert_array_equal(probability.ravel(), m.probability(points))
        log_odds = m.to_grid([lower, upper], cell_size, values="log_odds")
        np.testing.assert_array_equal(log_odds > 0, grid == 1)
    assert set(np.unique(m.to_grid([[-2.5] * dim, [2.5] * dim]))) == {-1, 0, 1}
    assert m.to_grid([[0.0] * dim, [1.0] * dim], 0.3).shape == (4,) * dim  # As many as cover it.
    assert m.to_grid([[0.0] * dim, [0.3] * dim], 0.1).shape == (3,) * dim  # 0.3 / 0.1 is a little below 3.
    assert m.to_grid([[1.0] * dim, [1.0] * dim]).size == 0


@pytest.mark.parametrize(
    "box, options, message",
    [
        ([[0, 0, 0]], {}, r"box has shape \(1, 3\): must be \(2, 3\)"),
        ([[1, 0, 0], [0, 1, 1]], {}, "box: axis 0 is from 1.0"),
        ([[0, 0, 0], [1, 1, np.inf]], {}, "box: axis 2"),
        ([[0, 0, 0], [1, 1, 1]], {"cell_size": 0}, "cell_size = 0.0"),
        ([[0, 0, 0], [1, 1, 1]], {"cell_size": 1e-300}, "more cells than"),
        ([[0, 0, 0], [1, 1, 1]], {"values": "colour"}, "values = 'colour'"),
    ],
)
def test_grids_that_cannot_be_made_are_refused(box: Any, options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        room(3).to_grid(box, **options)


def test_files_that_cannot_be_opened_say_so(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"none\.bt"):
        ndtree.load_octomap(tmp_path / "none.bt")
    with pytest.raises(FileNotFoundError):
        room(3).save_octomap(tmp_path / "none" / "a.bt")
    with pytest.raises(TypeError, match="whole numbers"):
        ndtree.from_grid(np.zeros((2, 2)), [0, 0], 0.1)
