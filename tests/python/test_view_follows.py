# SPDX-License-Identifier: BSD-3-Clause
"""A snapshot that follows a map is that of the map as it is, and makes anew only what has changed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pytest.importorskip("matplotlib")
pytest.importorskip("viser")

from conftest import room_scan

import ndtree
from ndtree.viewer import snapshot
from ndtree.viewer.layers import Layer
from ndtree.viewer.look import KINDS, Look
from ndtree.viewer.snapshot import Snapshot


def made(kind: str, dim: int, branching: int = 2) -> Any:
    if kind == "fixed":
        return ndtree.FixedMap(dim=dim, branching=branching, min_cell_size=0.1)
    if kind == "octomap":
        return ndtree.OctoMap(min_cell_size=0.1)
    return ndtree.AdaptiveMap(
        dim=dim, branching=branching, refinement=kind, min_cell_size=0.1, max_cell_size=0.9
    )


def insert(m: Any, seed: int, away: Any = 0.0) -> None:
    points, origin = room_scan(m.dim, seed)
    m.insert(points + away, origin + away)


def rows(*arrays: np.ndarray) -> np.ndarray:
    table = np.column_stack([np.asarray(a, dtype=np.float64) for a in arrays])
    return table[np.lexsort(table.T)]


def colors_of(layer: Layer) -> np.ndarray:
    """(n, 3) of what is drawn for the cells."""
    parts = [part.pyramid.colors[: len(part.cells)] for part in layer.parts.values()]
    return np.concatenate([np.zeros((0, 3)), *parts])


def assert_same(one: Snapshot, other: Snapshot, looks: list[Look]) -> int:
    """Both show the same; returns how many boxes that were."""
    names = ("lower", "size", "probability", "observed", "state", "hits", "misses")
    np.testing.assert_array_equal(
        *(rows(*(getattr(s.cells.where(s.cells.observed), name) for name in names)) for s in (one, other))
    )
    assert one.counts == other.counts
    count = 0
    for look in looks:
        for kind in KINDS:
            if look.slice_at is None and kind.startswith("plane"):
                continue
            layers = [s.layer(kind, look) for s in (one, other)]
            if look.color == "probability":  # Which are stretched over the same, whatever the map.
                drawn = [rows(*layer.boxes, colors_of(layer), layer.cells.size) for layer in layers]
            else:
                drawn = [rows(*layer.boxes, layer.cells.size) for layer in layers]
            np.testing.assert_array_equal(*drawn)
            count += layers[0].leaves
    return count


LOOKS = [Look(color="probability"), Look(color="size", slice_at=0.31)]


@pytest.mark.parametrize(
    ("kind", "dim", "branching"),
    [("evidence", 3, 2), ("evidence", 3, 3), ("evidence", 2, 2), ("paper", 3, 2), ("fixed", 3, 2)],
)
def test_what_follows_a_map_shows_what_a_new_one_does(kind: str, dim: int, branching: int) -> None:
    looks = LOOKS if dim == 3 else LOOKS[:1]
    m = made(kind, dim, branching)
    insert(m, 0)
    seen = Snapshot(m)
    shown = 0
    far = np.eye(dim)[0] * 40.0  # So the root grows.
    steps = [
        *(lambda seed=seed: insert(m, seed) for seed in (1, 2, 2)),
        lambda: None,
        lambda: insert(m, 3, far),
        lambda: m.clear([np.full(dim, -0.5), np.full(dim, 0.7)]),
        lambda: m.crop([np.full(dim, -1.1), np.full(dim, 42.0)]),
        lambda: insert(m, 4, 0.05),
    ]
    for i, step in enumerate(steps):
        step()
        seen = seen.followed(m)
        if i % 2:  # Layers that were not asked for in between are right, too.
            new = Snapshot(m)
            new.origin = seen.origin
            shown += assert_same(seen, new, looks)
    assert shown > 1000 * (dim - 1)


def test_maps_of_other_kinds_are_shown_as_they_are() -> None:
    maps = [made(kind, 3) for kind in ("evidence", "fixed", "paper", "octomap", "octomap")]
    maps.append(ndtree.AdaptiveMap(dim=3, min_cell_size=0.2))
    for seed, m in enumerate(maps):
        insert(m, seed)
    seen = Snapshot(maps[0])
    for m in maps:
        seen = seen.followed(m)
        new = Snapshot(m)
        new.origin = seen.origin
        assert_same(seen, new, LOOKS)
    with pytest.raises(ValueError, match="the map is empty"):
        seen.followed(ndtree.AdaptiveMap(dim=3, min_cell_size=0.2))


def test_colors_follow_probabilities_that_change_within_a_state() -> None:
    m = made("fixed", 3)
    insert(m, 0)
    seen = Snapshot(m)
    look = Look(color="probability")
    before = seen.layer("occupied", look)
    insert(m, 0)
    later = seen.followed(m)
    assert later.counts == seen.counts
    assert not np.array_equal(colors_of(later.layer("occupied", look)), colors_of(before))
    new = Snapshot(m)
    new.origin = later.origin
    assert_same(later, new, [look])


def test_the_first_walls_have_colors() -> None:
    m = made("evidence", 3)
    points, origin = room_scan(3, 0)
    m.insert(points, origin, returned=np.zeros(len(points), dtype=bool))
    seen = Snapshot(m)
    look = Look(color="size")
    assert seen.layer("occupied", look).coloring is None
    m.insert(points[:9], origin)
    m.insert(points[:9], origin)
    later = seen.followed(m)
    assert later.layer("occupied", look).leaves > 0
    assert later.layer("occupied", look).coloring is not None


def test_only_what_has_changed_is_made_anew(monkeypatch: Any) -> None:
    m = made("evidence", 3)
    for room in range(12):
        insert(m, room, np.array([15.0 * room, 0.0, 0.0]))
    look = Look(color="size", free=True)
    seen = Snapshot(m)
    before = {kind: seen.layer(kind, look) for kind in KINDS[:3]}
    asked: list[int] = []
    hidden = snapshot.hidden
    monkeypatch.setattr(snapshot, "hidden", lambda cells: asked.append(len(cells)) or hidden(cells))
    monkeypatch.setattr(snapshot, "found_region", None)  # Is not called: less than a tenth is new.
    insert(m, 50)
    later = seen.followed(m)
    for kind, layer in before.items():
        now = later.layer(kind, look)
        same = sum(now.parts.get(block) is part for block, part in layer.parts.items())
        assert 0.8 * len(layer.parts) < same < len(layer.parts)
    assert len(asked) == 2
    assert sum(asked) < 0.25 * len(seen.cells)
    assert later.region is seen.region
    assert later.followed(m).layer("free", look).parts is later.layer("free", look).parts


def test_a_cell_is_picked_with_the_numbers_that_it_has_now() -> None:
    m = made("evidence", 3)
    for seed in range(8):
        insert(m, seed)
    look = Look(color="size")
    seen = Snapshot(m)
    hit = np.flatnonzero(seen.cells.occupied)[0]
    towards = (seen.cells.lower[hit] + 0.5) * seen.unit
    ray = (np.zeros(3) - seen.origin, towards / np.linalg.norm(towards))
    first = seen.picked(*ray, look)
    assert first is not None
    cells, number = first
    place = (cells.lower[number] + 0.5 * cells.size[number]) * cells.unit
    for _ in range(3):
        m.insert(place[None], np.zeros(3))
    later = seen.followed(m)
    now, at = later.picked(*ray, look)  # type: ignore[misc]
    np.testing.assert_array_equal(now.lower[at], cells.lower[number])
    assert now.hits[at] > cells.hits[number]
