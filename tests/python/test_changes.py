# SPDX-License-Identifier: BSD-3-Clause
"""Snapshots, what has changed since, windows, and maps that are put together or moved."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from conftest import room_scan

import ndtree

MAKERS: list[Any] = [
    lambda **options: ndtree.AdaptiveMap(dim=3, branching=3, min_cell_size=0.1, max_cell_size=0.9, **options),
    lambda **options: ndtree.FixedMap(dim=2, min_cell_size=0.05, **options),
]


def grown(m: ndtree.OccupancyMap, seeds: range) -> ndtree.OccupancyMap:
    for seed in seeds:
        m.insert(*room_scan(m.dim, seed))
    return m


def points_around(dim: int, n: int = 3000) -> np.ndarray:
    return np.random.default_rng(2).uniform(-4, 4, (n, dim))


@pytest.mark.parametrize("make", MAKERS)
def test_a_snapshot_stays_and_tells_what_has_changed(make: Any) -> None:
    m = grown(make(), range(3))
    seen, bytes_then = m.snapshot(), m.to_bytes()
    assert type(seen) is type(m) and seen.to_bytes() == bytes_then and len(m.changes(since=seen)) == 0
    revision = m.revision
    points = points_around(m.dim)
    before = m.state(points)
    grown(m, range(3, 6))
    assert seen.to_bytes() == bytes_then == revision.to_bytes() != m.to_bytes()
    changes = m.changes(since=seen)
    assert len(changes) > 0 and repr(changes) == f"Changes({len(changes)} regions)"
    assert changes.lower.shape == (len(changes), m.dim)
    after = m.state(points)
    # Each point whose state differs lies in one of the regions, and no other does.
    inside = (
        (points[:, None] >= changes.lower)
        & (points[:, None] < changes.lower + changes.size[:, None, None].swapaxes(0, 1))
    ).all(axis=2)
    assert (inside.sum(axis=1) == (before != after)).all()
    where = inside.argmax(axis=1)[before != after]
    np.testing.assert_array_equal(changes.before[where], before[before != after])
    np.testing.assert_array_equal(changes.after[where], after[before != after])
    # The other way round, and a snapshot that goes on by itself.
    np.testing.assert_array_equal(np.sort(seen.changes(since=m).size), np.sort(changes.size))
    grown(seen, range(6, 7))
    assert revision.to_bytes() == bytes_then


@pytest.mark.parametrize("of", ["states", "cells"])
@pytest.mark.parametrize("make", MAKERS)
def test_changes_in_a_box_are_those_that_share_a_volume_with_it(make: Any, of: Any) -> None:
    m = grown(make(), range(3))
    seen = m.snapshot()
    grown(m, range(3, 6))
    every, some = m.changes(since=seen, of=of), 0
    unit = m.options["min_cell_size"]
    for low, high in ((-50.0, 0.5), (0.3, 0.3 + unit), (-50.0, 50.0), (40.0, 50.0)):
        box = np.array([[low] * m.dim, [high] * m.dim])
        inside = (every.lower < high - 1e-9).all(1) & (every.lower + every.size[:, None] > low + 1e-9).all(1)
        part = m.changes(since=seen, of=of, box=box)
        for name in ("lower", "size", "before", "after"):
            np.testing.assert_array_equal(getattr(part, name), getattr(every, name)[inside])
        some += 0 < len(part) < len(every)
    assert some > 0 and len(part) == 0
    with pytest.raises(ValueError, match="box"):
        m.changes(since=seen, box=[[0.0] * m.dim, [0.0] * m.dim])


def test_what_cannot_be_compared_is_told() -> None:
    m = ndtree.AdaptiveMap(dim=2)
    with pytest.raises(ValueError, match=r"refinement = 'fixed' beside one with dim = 2.*same kind"):
        m.changes(since=ndtree.FixedMap(dim=2))
    with pytest.raises(ValueError, match=r"smallest cells of 0\.1 and 0\.05 m"):
        m.changes(since=ndtree.AdaptiveMap(dim=2, min_cell_size=0.1))
    with pytest.raises(ValueError, match=r"cells from 0\.1 to 1\.6 m cannot be merged"):
        m.merge(ndtree.AdaptiveMap(dim=2, min_cell_size=0.1))
    with pytest.raises(TypeError):
        m.changes(since=3)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"pose has shape \(2,\): must be \(3, 3\), or \(3,\) of x, y"):
        m.transformed([1.0, 2.0])
    with pytest.raises(ValueError, match="rotation is not one"):
        m.transformed(np.diag([2.0, 1.0, 1.0]))
    field, solid = m.distance_field([[0, 0], [1, 1]], 0.1), ndtree.AdaptiveMap(dim=3)
    with pytest.raises(ValueError, match="a field with dim"):
        field.update(solid, since=solid)
    with pytest.raises(ValueError, match=r"window: from 1\.0 to 0\.0 m on axis 0"):
        m.insert(np.ones((1, 2)), np.zeros(2), window=[[1, 0], [0, 1]])
    assert len(m.leaves().size) == 1
    if ndtree.has_octomap:
        with pytest.raises(ValueError, match="must be a map of ndtree's own"):
            ndtree.OctoMap(min_cell_size=0.1).snapshot()
