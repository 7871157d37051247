# SPDX-License-Identifier: BSD-3-Clause
"""What people and arms know better: `clear` and `mark` of boxes and bodies, against points in and around."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from conftest import turned

import ndtree

RNG = np.random.default_rng(77)
#: Dimension, children per axis, and how cells are refined.
KINDS = [
    (2, 2, "evidence"), (2, 3, "evidence"), (2, 2, "paper"), (2, 2, "fixed"), (2, 3, "fixed"),
    (3, 2, "evidence"), (3, 3, "evidence"), (3, 2, "paper"), (3, 2, "fixed"),
]  # fmt: skip
CELL = 0.1


def empty(dim: int, branching: int, kind: str, **options: Any) -> Any:
    if kind == "fixed":
        return ndtree.FixedMap(dim=dim, branching=branching, min_cell_size=CELL, **options)
    return ndtree.AdaptiveMap(
        dim=dim, branching=branching, refinement=kind, min_cell_size=CELL, max_cell_size=CELL * branching**3,
        **options,
    )  # fmt: skip


@pytest.fixture(params=KINDS, ids=str)
def room(request: Any) -> Any:
    """Walls at 2 m all around, seen from inside."""
    m = empty(*request.param, range_sigma=0.02)
    ways = RNG.normal(size=(1500, m.dim))
    m.insert(2.0 * ways / np.abs(ways).max(axis=1, keepdims=True), np.full(m.dim, 0.31))
    return m


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
