# SPDX-License-Identifier: BSD-3-Clause
"""Cells of one kind with what is drawn for them, by cubes of space that are made one by one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndtree.cells.lattice import Block, Cells, Floats, Integers, Pyramid, joined
from ndtree.plot import Coloring


@dataclass(frozen=True, eq=False)
class Part:
    """Cells of one kind in one cube, with the boxes that are drawn for them, in the page's frame."""

    cells: Cells
    pyramid: Pyramid


@dataclass(frozen=True, eq=False)
class Layer:
    """Cells of one kind."""

    parts: Mapping[Block, Part]
    coloring: Coloring | None
    none: Cells

    @cached_property
    def cells(self) -> Cells:
        return joined((part.cells for part in self.parts.values()), self.none)

    @cached_property
    def boxes(self) -> tuple[Floats, Floats]:
        """Lower and upper corners (n, 3) [m] of what is drawn for the cells."""
        corners = np.zeros((2, len(self.cells), 3), dtype=np.float32)
        at = 0
        for part in self.parts.values():
            n = len(part.cells)
            corners[0, at : at + n], corners[1, at : at + n] = part.pyramid.lower[:n], part.pyramid.upper[:n]
            at += n
        return corners[0], corners[1]

    @cached_property
    def leaves(self) -> int:
        return sum(len(part.cells) for part in self.parts.values())

    @cached_property
    def whole(self) -> Pyramid:
        """Of all parts."""
        return Pyramid.over({block: part.pyramid for block, part in self.parts.items()}, self.none.branching)

    def chosen(
        self, eye: Floats | None, budget: int, finest: float = 0.0
    ) -> dict[Block, tuple[Pyramid, Integers]]:
        """The boxes to be drawn of each cube, and as () of what is larger than one, see `Pyramid.chosen`."""
        if self.leaves <= budget:
            return {block: (part.pyramid, np.arange(len(part.cells))) for block, part in self.parts.items()}
        numbers = self.whole.chosen(eye, budget, finest)
        sizes = [len(part.pyramid.parent) for part in self.parts.values()]
        ends = np.cumsum(sizes)
        found: dict[Block, tuple[Pyramid, Integers]] = {}
        for block, end, size, own in zip(
            self.parts, ends, sizes, np.split(numbers, np.searchsorted(numbers, ends))
        ):
            if len(own):
                found[block] = (self.parts[block].pyramid, own - (end - size))
        larger = numbers[np.searchsorted(numbers, ends[-1]) :]
        if len(larger):
            found[()] = (self.whole, larger)
        return found


@dataclass
class Kept:
    """What was made of each cube, and of which it has to be made anew."""

    parts: dict[Block, Any] = field(default_factory=dict)
    stale: set[Block] = field(default_factory=set)
    coloring: Coloring | None = None


def current(kept: Kept | None, every: set[Block], made: Callable[[set[Block]], dict[Block, Any]]) -> Kept:
    """What is made of each cube, made anew where it is stale."""
    if kept is None:
        return Kept(made(every))
    if not kept.stale:
        return kept
    parts = {block: part for block, part in kept.parts.items() if block not in kept.stale}
    parts.update(made(kept.stale))
    return Kept(parts)


#: The page takes instances' colors as amounts of light, not as what a screen is told.
_LINEAR = np.rint(255 * (np.arange(256) / 255) ** 2.2).astype(np.uint8)
_CUBE = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
_CUBE_FACES = np.array(
    [
        *((0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1)),
        *((2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)),
    ]
)


def drawn_boxes(pyramid: Pyramid, chosen: Integers, flat_axis: int | None, lift: float) -> dict[str, Any]:
    """What the page needs to draw boxes: one cube or tile, and where and how large it is each time."""
    lower, upper = pyramid.lower[chosen], pyramid.upper[chosen]
    positions, scales = 0.5 * (lower + upper), upper - lower
    vertices, faces = _CUBE, _CUBE_FACES
    if flat_axis is not None:
        vertices = np.zeros((4, 3))
        across = [a for a in range(3) if a != flat_axis]
        vertices[:, across] = ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))
        faces = np.array([(0, 1, 2), (0, 2, 3)])
        scales[:, flat_axis] = 1.0
        positions[:, flat_axis] += lift
    wxyzs = np.zeros((len(chosen), 4), dtype=np.float32)
    wxyzs[:, 0] = 1.0
    return {
        "vertices": vertices.astype(np.float32),
        "faces": faces.astype(np.uint32),
        "batched_wxyzs": wxyzs,
        "batched_positions": positions.astype(np.float32),
        "batched_scales": scales.astype(np.float32),
        "batched_colors": _LINEAR[pyramid.colors[chosen]],
    }


def edges_of(lower: Floats, upper: Floats) -> NDArray[np.float32]:
    """The edges of a box: (12, 2, 3)."""
    corners = np.where(_CUBE > 0, upper, lower)
    pairs = [(i, j) for i in range(8) for j in range(i) if np.count_nonzero(_CUBE[i] != _CUBE[j]) == 1]
    return corners[np.array(pairs)].astype(np.float32)
