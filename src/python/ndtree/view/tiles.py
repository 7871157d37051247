# SPDX-License-Identifier: BSD-3-Clause
"""Boxes on a page by tiles of space: what has not changed in a tile is not sent again."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from typing import Any

import numpy as np
import viser

from ndtree.lattice import Integers

Tile = tuple[int, ...]
_EACH = ("batched_wxyzs", "batched_positions", "batched_scales", "batched_colors")


class Tiles:
    """The boxes of one kind on one page: together the tiles hold what was shown last, each box once."""

    def __init__(self, client: viser.ClientHandle, name: str, edge: float, **style: Any) -> None:
        """`edge` is that of a tile [m], `style` how meshes are drawn."""
        self._client, self._name, self._edge, self._style = client, name, edge, style
        self._there: dict[Tile, tuple[bytes, Any]] = {}

    def show(self, boxes: dict[str, Any]) -> int:
        """Have the page show boxes, as by `drawn_boxes`, and no others; returns the bytes that were sent."""
        wanted = dict(self._parted(boxes))
        sent = 0
        with self._client.atomic():
            for tile in self._there.keys() - wanted.keys():
                self._there.pop(tile)[1].remove()
            for tile, part in wanted.items():
                digest = _digest(part)
                before = self._there.get(tile)
                if before is not None and before[0] == digest:
                    continue
                if before is not None:
                    before[1].remove()
                name = "_".join(map(str, tile))
                handle = self._client.scene.add_batched_meshes_simple(
                    f"{self._name}/{name}", **part, **self._style
                )
                self._there[tile] = (digest, handle)
                sent += sum(array.nbytes for array in part.values())
        return sent

    def remove(self) -> None:
        """Show nothing."""
        for _, handle in self._there.values():
            handle.remove()
        self._there.clear()

    def _parted(self, boxes: dict[str, Any]) -> Iterator[tuple[Tile, dict[str, Any]]]:
        """Each tile with its boxes, in an order that depends on nothing but them."""
        at, size = boxes["batched_positions"], boxes["batched_scales"]
        tiles = np.floor(at / self._edge).astype(np.int64)
        order = np.lexsort([*size.T, *at.T, *tiles.T])
        for part in np.split(order, _breaks(tiles[order])):
            if len(part):
                own = {key: array[part] if key in _EACH else array for key, array in boxes.items()}
                yield tuple(int(number) for number in tiles[part[0]]), own


def _breaks(rows: Integers) -> Integers:
    """Where rows differ from those before them."""
    return np.flatnonzero(np.any(rows[1:] != rows[:-1], axis=1)) + 1


def _digest(part: dict[str, Any]) -> bytes:
    whole = hashlib.blake2b(digest_size=16)
    for key in sorted(part):
        whole.update(np.ascontiguousarray(part[key]).tobytes())
    return whole.digest()
