# SPDX-License-Identifier: BSD-3-Clause
"""Cells by cubes of space, each of which can be replaced alone."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import fields, replace

import numpy as np

from ndtree.cells.lattice.cells import SCALARS, Booleans, Cells, Integers

#: Which cube: its lower corner in edges of cubes.
Block = tuple[int, ...]


def block_edge(branching: int, least: float) -> int:
    """Edge in units of cubes that no cell of a tree, of at most `least` units, reaches beyond."""
    edge = 1
    while edge < least:
        edge *= branching
    return edge


def block_runs(blocks: Integers) -> list[tuple[Block, Integers]]:
    """Each of some rows (n, dim), once, and where it stands, in order."""
    order = np.lexsort(blocks.T[::-1])
    begins = np.flatnonzero(np.any(np.diff(blocks[order], axis=0), axis=1)) + 1
    return [(tuple(blocks[run[0]].tolist()), run) for run in np.split(order, begins) if len(run)]


def parted(cells: Cells, edge: int) -> dict[Block, Cells]:
    """Cells by the cube of `edge` units that their lower corner is in.

    Of leaves in the order of their tree, those of a cube follow each other, and stay parts of one array.
    """
    parts = {}
    for block, run in block_runs(cells.lower // edge):
        first, last = int(run[0]), int(run[-1])
        parts[block] = cells.where(slice(first, last + 1) if last - first + 1 == len(run) else run)
    return parts


def joined(parts: Iterable[Cells], none: Cells) -> Cells:
    """Cells of several parts, one after the other; of no parts, none, with the unit of some others."""
    every = list(parts)
    if not every:
        return none.where(slice(0))
    arrays = {
        field.name: np.concatenate([getattr(part, field.name) for part in every])
        for field in fields(Cells)
        if field.name not in SCALARS
    }
    return replace(none, **arrays)


def _beside(block: Block) -> Iterator[tuple[int, int, Block]]:
    """Axis, side (-1 or 1) and cube of each that shares a face with one."""
    for axis, at in enumerate(block):
        for step in (-1, 1):
            yield axis, step, (*block[:axis], at + step, *block[axis + 1 :])


def around(blocks: Collection[Block]) -> set[Block]:
    """Some cubes, and those that share a face with one of them."""
    return {*blocks, *(other for block in blocks for _, _, other in _beside(block))}


def with_rim(cells: Mapping[Block, Cells], blocks: Collection[Block], edge: int, none: Cells) -> Cells:
    """The cells of some cubes, and then those of others that share a face with a cube."""
    inside = set(blocks)
    rims: dict[Block, Booleans] = {}
    for block in inside:
        for axis, step, beside in _beside(block):
            if beside in inside or beside not in cells:
                continue
            some, at = cells[beside], block[axis]
            touches = some.upper[:, axis] == at * edge if step < 0 else some.lower[:, axis] == (at + 1) * edge
            rims[beside] = rims[beside] | touches if beside in rims else touches
    own = [cells[block] for block in blocks if block in cells]
    return joined([*own, *(cells[block].where(rim) for block, rim in rims.items())], none)
