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
