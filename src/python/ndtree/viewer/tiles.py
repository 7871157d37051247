# SPDX-License-Identifier: BSD-3-Clause
"""Boxes on a page by cubes of space: what has not changed in a cube is not sent again."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import viser

from ndtree.cells.lattice import Block, Integers, Pyramid
from ndtree.viewer.layers import drawn_boxes


@dataclass(frozen=True)
class _Tile:
    """What a page holds of one cube."""

    pyramid: Pyramid
    numbers: Integers
    digest: bytes
    handle: Any


class Tiles:
    """The boxes of one kind on one page: together the tiles hold what was shown last, each box once."""

    def __init__(self, client: viser.ClientHandle, name: str, **style: Any) -> None:
        """`style`: how meshes are drawn."""
        self._client, self._name, self._style = client, name, style
        self._there: dict[Block, _Tile] = {}

    def show(
        self, chosen: Mapping[Block, tuple[Pyramid, Integers]], flat_axis: int | None, lift: float
    ) -> int:
        """Have the page show the boxes of each cube, by their numbers, and no others.

        Returns the bytes that were sent. What looks as before is not, even if all else has changed.
        """
        sent = 0
        with self._client.atomic():
            for block in self._there.keys() - chosen.keys():
                self._there.pop(block).handle.remove()
            for block, (pyramid, numbers) in chosen.items():
                before = self._there.get(block)
                is_known = before is not None and before.pyramid is pyramid
                if before is not None and is_known and np.array_equal(before.numbers, numbers):
                    continue
                boxes = drawn_boxes(pyramid, numbers, flat_axis, lift)
                digest = _digest(boxes)
                if before is not None and before.digest == digest:
                    self._there[block] = _Tile(pyramid, numbers, digest, before.handle)
                    continue
                if before is not None:
                    before.handle.remove()
                name = "_".join(map(str, block)) or "larger"
                handle = self._client.scene.add_batched_meshes_simple(
                    f"{self._name}/{name}", **boxes, **self._style
                )
                self._there[block] = _Tile(pyramid, numbers, digest, handle)
                sent += sum(array.nbytes for array in boxes.values())
        return sent

    def remove(self) -> None:
        """Show nothing."""
        for tile in self._there.values():
            tile.handle.remove()
        self._there.clear()


def _digest(boxes: Mapping[str, Any]) -> bytes:
    whole = hashlib.blake2b(digest_size=16)
    for key in sorted(boxes):
        whole.update(np.ascontiguousarray(boxes[key]).tobytes())
    return whole.digest()
