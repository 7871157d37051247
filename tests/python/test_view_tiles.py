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
from ndtree.cells.lattice import Pyramid
from ndtree.viewer import snapshot
from ndtree.viewer.layers import drawn_boxes
from ndtree.viewer.look import Look
from ndtree.viewer.snapshot import Snapshot
from ndtree.viewer.tiles import Tiles

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


def drawn(chosen: Any, flat_axis: int | None) -> dict[str, Any]:
    """All boxes of a page in one."""
    parts = [drawn_boxes(pyramid, numbers, flat_axis, 0.0) for pyramid, numbers in chosen.values()]
    return {key: np.concatenate([part[key] for part in parts]) for key in EACH}


@pytest.mark.parametrize("world", ["office", "apartment"])
def test_the_page_holds_the_whole_snapshot_at_each_step(world: str, monkeypatch: Any) -> None:
    monkeypatch.setattr(snapshot, "BLOCK_CELLS", 16)
    log = ndtree.simulate(world, scans=40)
    m = ndtree.AdaptiveMap(dim=log.dim, min_cell_size=0.1)
    page = Page()
    tiles = Tiles(page, "/occupied", side="front")  # type: ignore[arg-type]
    seen: Snapshot | None = None
    sent, whole, resent, steps = 0, 0, 0, 0
    before: dict[str, Any] = {}
    look = Look.of(log.dim, color="size")
    flat_axis = 2 if log.dim == 2 else None
    for scan in log:
        scan.insert_into(m)
        seen = Snapshot(m) if seen is None else seen.followed(m)
        chosen = seen.layer("occupied", look).chosen(None, 3000)
        boxes = drawn(chosen, flat_axis)
        count = page.added
        sent += tiles.show(chosen, flat_axis, 0.0)
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


def test_what_looks_the_same_is_not_sent_again() -> None:
    generator = np.random.default_rng(4)
    lower = generator.uniform(-5, 5, (500, 3)).astype(np.float32)
    colors = generator.integers(0, 255, (500, 3)).astype(np.uint8)
    pyramids = [
        Pyramid(lower, lower + 1, colors, np.ones(500), np.full(500, -1), np.ones(500, dtype=np.bool_))
        for _ in range(2)
    ]
    page = Page()
    tiles = Tiles(page, "/free")  # type: ignore[arg-type]
    every = np.arange(500)
    assert tiles.show({(0, 0): (pyramids[0], every), (1, 0): (pyramids[0], every[:9])}, None, 0.0) > 0
    assert tiles.show({(0, 0): (pyramids[1], every.copy()), (1, 0): (pyramids[0], every[:9])}, None, 0.0) == 0
    assert page.added == 2
    assert tiles.show({(0, 0): (pyramids[1], every[1:])}, None, 0.0) > 0
    assert (page.added, len(page.meshes)) == (3, 1)
