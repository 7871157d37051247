# SPDX-License-Identifier: BSD-3-Clause
"""Neighbours, hidden cells, the border of the unknown and coarser views, against looking at every pair."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from conftest import room_scan

import ndtree
from ndtree.base.voxels import distinct
from ndtree.cells.lattice import CellIndex, Cells, Pyramid, coarsened, covered_faces, frontier, hidden

SHAPES = [(2, 2), (3, 2), (2, 3)]  # branching, dim


def room(branching: int, dim: int, far: float = 0.0, open_side: bool = False) -> Any:
    """A map of a room, 0.2 m; with an open side only what is seen to the right of the sensor."""
    m = ndtree.AdaptiveMap(dim=dim, branching=branching, min_cell_size=0.2, max_cell_size=1.9)
    for seed in range(12):
        points, origin = room_scan(dim, seed)
        if open_side:
            points = points[points[:, 0] > origin[0]]
        m.insert(points + far, origin + far)
    return m


def containing(some: Cells, points: np.ndarray) -> np.ndarray:
    """Which cell each point is in, by looking at all; -1 for none."""
    found = np.full(len(points), -1)
    for i, (lower, size) in enumerate(zip(some.lower, some.size)):
        found[((points >= lower) & (points < lower + size)).all(axis=1)] = i
    return found


@pytest.mark.parametrize("far", [0.0, -777.7])
@pytest.mark.parametrize("branching, dim", SHAPES)
def test_cells_are_found_where_they_are(branching: int, dim: int, far: float) -> None:
    every = Cells.of(room(branching, dim, far))
    some = every.where(every.observed)
    generator = np.random.default_rng(3)
    points = generator.integers(some.lower.min() - 3, some.upper.max() + 3, (1500, dim))
    index = CellIndex(some.lower, some.size, branching)
    expected = containing(some, points)
    np.testing.assert_array_equal(index.find(points), expected)
    assert 50 < np.count_nonzero(expected >= 0) < 1500


def test_cells_far_apart_are_found() -> None:
    lower = np.array([[-(1 << 40), 5, 0], [3, 3, 3], [1 << 40, -8, 1 << 39]])
    index = CellIndex(lower, np.ones(3, dtype=np.int64), 2)
    np.testing.assert_array_equal(index.find(lower), [0, 1, 2])
    np.testing.assert_array_equal(index.find(lower + np.array([0, 1, 0])), [-1, -1, -1])
    with pytest.raises(ValueError, match="too different in size"):
        CellIndex(lower, np.array([1, 1, 1 << 30]), 2)


def unit_cells(some: Cells) -> dict[tuple[int, ...], int]:
    """The cell of each unit of the lattice."""
    units = {}
    for i, (lower, size) in enumerate(zip(some.lower, some.size)):
        for offset in np.ndindex(*([int(size)] * some.dim)):
            units[tuple(int(c) for c in lower + offset)] = i
    return units


@pytest.mark.parametrize("branching, dim", SHAPES)
def test_a_face_is_covered_if_each_unit_of_it_is(branching: int, dim: int) -> None:
    every = Cells.of(room(branching, dim))
    some = every.where(every.observed)
    units = unit_cells(some)
    covered = covered_faces(some)
    counted = 0
    for i in range(0, len(some), max(1, len(some) // 250)):
        lower, size = some.lower[i], int(some.size[i])
        for axis in range(dim):
            for side in (0, 1):
                at = lower[axis] + (size if side else -1)
                face = [
                    tuple(int(c) for c in np.insert(np.delete(lower, axis) + offset, axis, at))
                    for offset in np.ndindex(*([size] * (dim - 1)))
                ]
                assert covered[i, axis, side] == all(unit in units for unit in face)
                counted += covered[i, axis, side]
    assert counted > 50
    np.testing.assert_array_equal(hidden(some), covered.all(axis=(1, 2)))
    assert 0 < np.count_nonzero(hidden(some)) < len(some)


@pytest.mark.parametrize("branching, dim", [(2, 2), (3, 2), (2, 3)])
def test_frontier_is_unknown_beside_free(branching: int, dim: int) -> None:
    every = Cells.of(room(branching, dim, open_side=True))
    known = unit_cells(every.where(every.known))
    free = unit_cells(every.where(every.free))
    border = frontier(every)
    units = unit_cells(border)
    assert not set(units) & set(known)
    beside = set()
    for unit in free:
        for axis in range(dim):
            for step in (-1, 1):
                other = tuple(c + step * (a == axis) for a, c in enumerate(unit))
                if other not in known:
                    beside.add(other)
    assert beside <= set(units), "unknown space beside free space was left out"
    touched = {units[unit] for unit in beside}
    assert touched == set(range(len(border))), "a cell is not beside free space"
    assert len(beside) > 10


@pytest.mark.parametrize("branching, dim", SHAPES)
def test_coarser_views_have_each_cell_under_one_box_within_budget(branching: int, dim: int) -> None:
    every = Cells.of(room(branching, dim))
    some = every.where(every.occupied)
    lower, upper = np.zeros((2, len(some), 3))
    lower[:, :dim], upper[:, :dim] = some.lower * some.unit, some.upper * some.unit
    colors = np.random.default_rng(1).integers(0, 255, (len(some), 3)).astype(np.uint8)
    pyramid = Pyramid.of(some, lower, upper, colors)
    eye = np.array([0.5, 0.2, 3.0])
    for budget in (1 << dim, 20, 60, len(some), 10**6):
        chosen = pyramid.chosen(eye, budget)
        assert len(chosen) <= budget
        assert len(chosen) > min(budget, len(some)) // (2 * branching**dim)
        drawn = set(chosen.tolist())
        for leaf in range(len(some)):
            node, above = leaf, []
            while node >= 0:
                assert (pyramid.lower[node] <= lower[leaf] + 1e-5).all()
                assert (pyramid.upper[node] >= upper[leaf] - 1e-5).all()
                above.append(node)
                node = int(pyramid.parent[node])
            assert len(drawn & set(above)) == 1
        assert pyramid.weight[chosen].sum() == len(some)
    near, far = (pyramid.chosen(np.array(at), 60) for at in ((2.0, 2.0, 0.5), (-2.0, -2.0, 0.5)))
    corner = np.array([2.0, 2.0, 0.0])
    finest = [np.linalg.norm(pyramid.upper[c] - corner, axis=1).argmin() for c in (near, far)]
    extents = [pyramid.extent[c][i] for c, i in zip((near, far), finest)]
    assert extents[0] <= extents[1], "what is near is coarser than what is far"


@pytest.mark.parametrize("branching, dim", SHAPES)
def test_coarsened_cells_hold_what_they_were_made_of(branching: int, dim: int) -> None:
    every = Cells.of(room(branching, dim))
    some = every.where(every.observed)
    joined, number = coarsened(some, branching)
    assert len(joined) < len(some)
    assert (joined.size >= branching).all()
    assert (joined.lower[number] <= some.lower).all()
    assert (joined.upper[number] >= some.upper).all()
    np.testing.assert_array_equal(joined.size[number], np.maximum(some.size, branching))
    assert len(unit_cells(joined)) == (joined.size**dim).sum(), "cells overlap"
    for i in np.flatnonzero(np.bincount(number) > 1)[:50]:
        members = some.where(number == i)
        assert joined.probability[i] == members.probability.max()
        assert (joined.state[i], joined.hits[i]) == (members.state.max(), members.hits.sum())
    same, number = coarsened(some, 1)
    np.testing.assert_array_equal(same.lower[number], some.lower)


def test_coarser_views_of_nothing_are_nothing() -> None:
    every = Cells.of(room(2, 3))
    none = every.where(np.zeros(len(every), dtype=np.bool_))
    pyramid = Pyramid.of(none, np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3), dtype=np.uint8))
    assert len(pyramid.chosen(None, 10)) == 0
    assert not hidden(none).size and not len(frontier(none))


@pytest.mark.parametrize("span", [3, 1 << 19, 1 << 40], ids=["many alike", "one number", "no number"])
def test_different_rows_are_those_of_numpy(span: int) -> None:
    rows = np.random.default_rng(5).integers(-span, span, (200, 3))
    rows = np.concatenate([rows, rows[::3]])
    for also in ({}, {"return_counts": True}, {"return_inverse": True}):
        for some in (rows, rows[:0]):
            found, expected = distinct(some, **also), np.unique(some, axis=0, **also)
            assert len(found) == len(expected) and all(map(np.array_equal, found, expected)), also
