# SPDX-License-Identifier: BSD-3-Clause
"""What a page holds in tiles is always the whole snapshot, and only tiles that changed are sent."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

pytest.importorskip("viser")

import ndtree
from ndtree.snapshot import Look, Snapshot
from ndtree.view.boxes import drawn_boxes
from ndtree.view.tiles import Tiles

EACH = ("batched_positions", "batched_scales", "batched_colors")


class Page:
    """Keeps what a page would: the meshes that were added and not removed, by their names."""

    def __init__(self) -> None:
        self.scene = self
        self.meshes: dict[str, dict[str, Any]] = {}
        self.added = 0

    @contextlib.contextmanager
    def atomic(self) -> Iterator[None]:
        yield

    def add_batched_meshes_simple(self, name: str, **mesh: Any) -> Any:
        assert name not in self.meshes
        self.meshes[name] = mesh
        self.added += 1
        page = self

        class Handle:
            def remove(self) -> None:
                del page.meshes[name]

        return Handle()

    def rows(self) -> np.ndarray:
        return rows(*(np.concatenate([mesh[key] for mesh in self.meshes.values()]) for key in EACH))


def rows(*arrays: np.ndarray) -> np.ndarray:
    """All boxes as sorted rows of numbers."""
    table = np.concatenate([array.astype(np.float64) for array in arrays], axis=1)
    return table[np.lexsort(table.T)]


@pytest.mark.parametrize(("world", "edge"), [("office", 3.2), ("apartment", 1.6)])
def test_the_page_holds_the_whole_snapshot_at_each_step(world: str, edge: float) -> None:
    log = ndtree.simulate(world, scans=40)
    m = ndtree.AdaptiveMap(dim=log.dim, min_cell_size=0.1)
    page = Page()
    tiles = Tiles(page, "/occupied", edge, side="front")  # type: ignore[arg-type]
    origin, sent, whole, resent, steps = None, 0, 0, 0, 0
    before: dict[str, Any] = {}
    look = Look.of(log.dim, color="size")
    for scan in log:
        scan.insert_into(m)
        snapshot = Snapshot(m)
        origin = snapshot.origin if origin is None else origin
        snapshot.origin = origin
        layer = snapshot.layer("occupied", look)
        chosen = layer.pyramid.chosen(None, 3000)
        boxes = drawn_boxes(layer.pyramid, chosen, 2 if log.dim == 2 else None, 0.0)
        count = page.added
        sent += tiles.show(boxes)
        whole += sum(array.nbytes for array in boxes.values())
        np.testing.assert_array_equal(page.rows(), rows(*(boxes[key] for key in EACH)))
        changed = {name for name, mesh in page.meshes.items() if before.get(name) is not mesh}
        assert len(changed) == page.added - count
        for name in changed & before.keys():  # None of them was sent as it was.
            old, new = (rows(*(held[name][key] for key in EACH)) for held in (before, page.meshes))
            assert old.shape != new.shape or not np.array_equal(old, new)
            resent += 1
        before = dict(page.meshes)
        steps += 1
    assert steps == 40 and resent > 20
    assert sent < 0.6 * whole
    tiles.remove()
    assert page.meshes == {}


def test_the_order_of_boxes_does_not_matter() -> None:
    generator = np.random.default_rng(4)
    n = 500
    boxes = {
        "vertices": np.zeros((4, 3), dtype=np.float32),
        "batched_wxyzs": np.tile(np.array([1, 0, 0, 0], dtype=np.float32), (n, 1)),
        "batched_positions": generator.uniform(-5, 5, (n, 3)).astype(np.float32),
        "batched_scales": np.full((n, 3), 0.1, dtype=np.float32),
        "batched_colors": generator.integers(0, 255, (n, 3)).astype(np.uint8),
    }
    page = Page()
    tiles = Tiles(page, "/free", 2.0)  # type: ignore[arg-type]
    assert tiles.show(boxes) > 0
    mixed = generator.permutation(n)
    shuffled = {key: array if key == "vertices" else array[mixed] for key, array in boxes.items()}
    assert tiles.show(shuffled) == 0
    assert 27 <= len(page.meshes) <= 216
