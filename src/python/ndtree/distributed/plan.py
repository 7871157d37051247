# SPDX-License-Identifier: BSD-3-Clause
"""Which task takes which scans into which block of tiles, and in which order: the same for every engine."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from ndtree.distributed.scans import IndexedScan, ScanIndex
from ndtree.distributed.stages import Job, ScanRef, block_of
from ndtree.tiles.grid import Tile


@dataclass(frozen=True)
class Range:
    """Scans of one task: some of those that cross a block of tiles, one after the other."""

    part: int
    scans: tuple[ScanRef, ...]
    beams: int


@dataclass
class Chain:
    """All tasks of a block, one after the other, and the tiles that its scans cross."""

    block: Tile
    ranges: list[Range]
    tiles: tuple[Tile, ...]

    @property
    def beams(self) -> int:
        """Of all its tasks."""
        return sum(one.beams for one in self.ranges)


def in_order(indexes: Iterable[ScanIndex]) -> Iterator[tuple[ScanRef, IndexedScan]]:
    """All scans of the run: by time, those of one time by the name of their log."""
    every = [
        ((scan.time, index.log, number), scan) for index in indexes for number, scan in enumerate(index.scans)
    ]
    every.sort(key=lambda one: one[0])
    for order, ((_, log, number), scan) in enumerate(every):
        yield ScanRef(log, number, scan.batch, scan.position, order), scan


def chains(
    job: Job, scans: Iterable[tuple[ScanRef, IndexedScan]], range_beams: int, only: set[Tile] | None = None
) -> list[Chain]:
    """Tasks of all blocks, or of some, those with the most beams first.

    Parameters
    ----------
    scans : iterable
        In their order.
    range_beams : int
        A block's task ends where it has this many beams.
    only : set of Tile, optional
        Blocks.
    """
    found: dict[Tile, list[list[ScanRef]]] = {}
    beams: dict[Tile, list[int]] = {}
    tiles: dict[Tile, set[Tile]] = {}
    for ref, scan in scans:
        crossed: dict[Tile, set[Tile]] = {}
        for tile in scan.tiles:
            crossed.setdefault(block_of(job, tile), set()).add(tile)
        for block, of_block in crossed.items():
            if only is not None and block not in only:
                continue
            parts = found.setdefault(block, [])
            counts = beams.setdefault(block, [])
            if not parts or counts[-1] >= range_beams:
                parts.append([])
                counts.append(0)
            parts[-1].append(ref)
            counts[-1] += scan.beams
            tiles.setdefault(block, set()).update(of_block)
    made = [
        Chain(
            block,
            [Range(i, tuple(refs), beams[block][i]) for i, refs in enumerate(found[block])],
            tuple(sorted(tiles[block])),
        )
        for block in sorted(found)
    ]
    return sorted(made, key=lambda chain: (-chain.beams, chain.block))
