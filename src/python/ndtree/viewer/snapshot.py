# SPDX-License-Identifier: BSD-3-Clause
"""What is seen of a map at one time, by cubes of space: what has not changed in one is not made anew."""

from __future__ import annotations

import threading
from functools import cached_property
from typing import Any

import numpy as np

from ndtree._native._core import OccupancyMap
from ndtree.cells.lattice import (
    Block,
    Booleans,
    Cells,
    Floats,
    Pyramid,
    around,
    block_edge,
    block_runs,
    frontier,
    hidden,
    joined,
    parted,
    with_rim,
)
from ndtree.cells.regions import found_region, picture_region
from ndtree.plot import Coloring, coloring
from ndtree.viewer.layers import Kept, Layer, Part, current
from ndtree.viewer.look import IN_PLANE, Look, shown_kinds
from ndtree.viewer.picking import first_on_ray

BLOCK_CELLS = 64  # Smallest cells along the edge of a cube in which all is sent anew if something changes.
MAX_LAYERS = 6  # Kept for the next time they are asked for.
_GROWN = 0.1  # When so much of a map is new, its bounds are, and its colors are stretched over all.

_FREE_COLOR = (160, 190, 215)
_UNKNOWN_COLOR = (240, 140, 40)


class _Whole:
    """What concerns all of a map: made anew only when much of it has changed."""

    def __init__(self, cells: Cells) -> None:
        bounds = picture_region(cells) if cells.dim == 2 else found_region(cells)
        region = np.asarray(bounds).reshape(-1, 2)
        #: Bounds [m] of what was found, (3, 2) in the map's frame.
        self.region = np.vstack([region, np.zeros((3 - cells.dim, 2))])
        self._count, self._changed = len(cells), 0
        self._occupied = cells.where(cells.occupied)
        self._colorings: dict[str, Coloring] = {}

    def followed(self, later: Snapshot, changed: int) -> _Whole:
        """Of a later snapshot, in which `changed` regions are of another state."""
        self._changed += changed
        if self._changed > _GROWN * self._count or not len(self._occupied):
            return _Whole(later.cells)
        return self

    def coloring(self, color: str) -> Coloring | None:
        """Colors of occupied cells, if there are any."""
        if color not in self._colorings and len(self._occupied):
            self._colorings[color] = coloring(self._occupied, color)
        return self._colorings.get(color)


class Snapshot:
    """A map at one time, and what is drawn of it. Layers are made when they are first asked for."""

    def __init__(self, m: OccupancyMap) -> None:
        if m.dim not in (2, 3):
            raise ValueError(f"the map is {m.dim}-D: only 2-D and 3-D maps can be seen")
        self.dim, self.refinement, self.branching = m.dim, m.refinement, m.branching
        self._map = None if m.refinement == "octomap" else m.snapshot()
        #: Edge [m] of the smallest cells.
        self.unit = m.options["min_cell_size"]
        now = m if self._map is None else self._map
        leaves = now.leaves()
        if not np.any(leaves.observed):
            raise ValueError("the map is empty: nothing was inserted that could be drawn")
        every = Cells.of_leaves(leaves, self.unit, m.branching)
        # Of an OctoMap, changes are not told, and cells may be of any size.
        largest = 1.0 if self._map is None else m.options.get("max_cell_size", self.unit) / self.unit
        self._edge = block_edge(m.branching, max(largest, BLOCK_CELLS))
        self._none = every.where(slice(0))
        some = every.where(every.observed | (every.size <= self._edge))
        self._blocks = parted(some, self._edge)
        self._whole = _Whole(some)
        #: Where the page's frame is: far from the map's origin, float32 has no room for small cells.
        self.origin = np.round(self.region.mean(axis=1))
        self._lock = threading.Lock()
        self._kept: dict[Any, Kept] = {}
        self._layers: dict[Any, Layer] = {}

    def followed(self, m: OccupancyMap) -> Snapshot:
        """A snapshot of what the map has become, or of another one, in the frame of this one.

        Only cubes are looked at in which cells have changed, and made anew only what they, or cubes beside
        them, have a part in.
        """
        later = self._changed_to(m)
        if later is None:
            later = Snapshot(m)
            later.origin = self.origin
        return later

    def _changed_to(self, m: OccupancyMap) -> Snapshot | None:
        """None if changes do not tell."""
        kind = (self.refinement, self.dim, self.branching)
        if self._map is None or (m.refinement, m.dim, m.branching) != kind:
            return None
        now = m.snapshot()
        try:
            changes = now.changes(since=self._map, of="cells")
        except ValueError:  # Cells of other sizes.
            return None
        if len(changes) and changes.size.max() > self._edge * self.unit * (1 + 1e-9):
            return None
        at = np.floor((changes.lower + 0.5 * changes.size[:, None]) / (self._edge * self.unit))
        written = {tuple(row.tolist()) for row in np.unique(at.astype(np.int64), axis=0)}
        blocks = {block: cells for block, cells in self._blocks.items() if block not in written}
        moved: set[Block] = set()  # With cells elsewhere, of another size or state.
        for block in sorted(written):
            cells = self._cells_in(now, block)
            if len(cells):
                blocks[block] = cells
            if not _alike(self._blocks.get(block, self._none), cells):
                moved.add(block)
        if not any(np.any(cells.observed) for cells in blocks.values()):
            return None
        return self._with(now, blocks, written, moved, np.count_nonzero(changes.before != changes.after))

    def _with(
        self,
        now: OccupancyMap,
        blocks: dict[Block, Cells],
        written: set[Block],
        moved: set[Block],
        changed: int,
    ) -> Snapshot:
        """A snapshot of other cells: what was made of cubes stays, but for cubes that changed."""
        later = Snapshot.__new__(Snapshot)
        later.__dict__.update(self.__dict__)
        later.__dict__.pop("counts", None)
        later._map, later._blocks = now, blocks
        later._whole = self._whole.followed(later, changed)
        later._lock, later._layers = threading.Lock(), {}
        later._kept = {}
        with self._lock:
            for key, kept in self._kept.items():
                touched = written if key[0] == "layer" and key[2] == "probability" else set()
                later._kept[key] = Kept(kept.parts, kept.stale | around(moved) | touched, kept.coloring)
        return later

    def _cells_in(self, m: OccupancyMap, block: Block) -> Cells:
        edge = self._edge * self.unit
        corner = np.array(block) * edge
        inner = 0.25 * self.unit
        leaves = m.leaves([corner + inner, corner + (edge - inner)])
        cells = Cells.of_leaves(leaves, self.unit, self.branching)
        return cells.where(cells.size <= self._edge)

    @property
    def region(self) -> Floats:
        """Bounds [m] of what was found, (3, 2) in the map's frame."""
        return self._whole.region

    @property
    def cells(self) -> Cells:
        """All of them that were observed, or lie beside some that were."""
        return joined(self._blocks.values(), self._none)

    @cached_property
    def counts(self) -> tuple[int, int]:
        """How many cells were observed, and are occupied."""
        every = self._blocks.values()
        observed = sum(int(np.count_nonzero(cells.observed)) for cells in every)
        return observed, sum(int(np.count_nonzero(cells.occupied)) for cells in every)

    def layer(self, kind: str, look: Look) -> Layer:
        """Cells of one of the `KINDS`."""
        sliced = (look.axis, look.slice_at) if look.slice_at is not None else None
        if kind not in IN_PLANE and not look.cut:
            sliced = None
        color = look.color if kind.endswith("occupied") else None
        key = ("layer", kind, color, sliced)
        with self._lock:
            layer = self._layers.get(key)
            kept = self._kept.pop(key, None)
            if layer is None:
                colors = self._whole.coloring(color) if color is not None else None
                if kept is not None and kept.coloring is not colors:
                    kept = None
                kept = current(
                    kept,
                    around(self._blocks) if kind == "unknown" else set(self._blocks),
                    lambda blocks: self._made(kind, sliced, colors, blocks),
                )
                kept.coloring = colors
                layer = Layer(kept.parts, colors, self._none)
            assert kept is not None
            layers = [other for other in self._kept if other[0] == "layer"]
            for oldest in layers[: max(0, len(layers) - MAX_LAYERS + 1)]:
                del self._kept[oldest]
                self._layers.pop(oldest, None)
            self._layers[key], self._kept[key] = layer, kept  # The last, and so the last to be dropped.
            return layer

    def _hidden(self, state: int) -> dict[Block, Booleans]:
        """Which of each cube's cells of a state, in their order, cannot be seen from outside."""

        def made(blocks: set[Block]) -> dict[Block, Booleans]:
            near = with_rim(self._blocks, blocks, self._edge, self._none)
            near = near.where(near.state == state)
            inner = hidden(near)
            runs = block_runs(near.lower // self._edge)
            return {block: inner[run] for block, run in runs if block in blocks}

        return self._of_blocks(("hidden", state), set(self._blocks), made)

    def _frontier(self) -> dict[Block, Cells]:
        def made(blocks: set[Block]) -> dict[Block, Cells]:
            found = frontier(with_rim(self._blocks, blocks, self._edge, self._none))
            return {block: some for block, some in parted(found, self._edge).items() if block in blocks}

        return self._of_blocks(("frontier",), around(self._blocks), made)

    def _of_blocks(self, key: Any, every: set[Block], made: Any) -> dict[Block, Any]:
        self._kept[key] = current(self._kept.get(key), every, made)
        return self._kept[key].parts

    def _made(
        self, kind: str, sliced: tuple[int, float] | None, colors: Coloring | None, blocks: set[Block]
    ) -> dict[Block, Part]:
        """The parts of a layer."""
        if kind == "unknown":
            every = self._frontier()
            some = joined((every[block] for block in blocks if block in every), self._none)
        else:
            state = 1 if kind.endswith("occupied") else 0
            in_hidden = self._hidden(state)
            here = [block for block in blocks if block in in_hidden]
            some = joined((self._blocks[block] for block in here), self._none)
            some = some.where(some.state == state)
            if kind not in IN_PLANE and here:
                inner = np.concatenate([in_hidden[block] for block in here])
                if sliced is not None:
                    at = sliced[1] / self.unit
                    inner &= ~((some.lower[:, sliced[0]] <= at) & (at < some.upper[:, sliced[0]]))
                if self.dim == 3:  # All of a flat map is seen from above.
                    some = some.where(~inner)
        if sliced is not None:
            if kind in IN_PLANE:
                some = some.through(*sliced)
            else:
                some = some.where(some.lower[:, sliced[0]] * self.unit < sliced[1])
        lower, upper = np.zeros((2, len(some), 3))
        lower[:, : self.dim] = some.lower * self.unit
        upper[:, : self.dim] = some.upper * self.unit
        if sliced is not None:
            upper[:, sliced[0]] = np.minimum(upper[:, sliced[0]], sliced[1])
            if kind in IN_PLANE:
                lower[:, sliced[0]] = sliced[1]
        color = np.tile(np.array(_UNKNOWN_COLOR if kind == "unknown" else _FREE_COLOR), (len(some), 1))
        if colors is not None:
            color = np.rint(255 * colors(some))
        pyramids = Pyramid.of_blocks(
            some, lower - self.origin, upper - self.origin, color.astype(np.uint8), self._edge
        )
        cells = parted(some, self._edge)
        return {block: Part(cells[block], pyramid) for block, pyramid in pyramids.items()}

    def picked(self, origin: Floats, direction: Floats, look: Look) -> tuple[Cells, int] | None:
        """The first cell of those that are shown, on a ray in the page's frame, and its number there."""
        best: tuple[float, Cells, int] | None = None
        for kind in shown_kinds(look):
            layer = self.layer(kind, look)
            enter, number = first_on_ray(*layer.boxes, origin, direction)
            if number >= 0 and (best is None or enter < best[0]):
                best = (enter, layer.cells, number)
        return self._as_it_is(*best[1:]) if best else None

    def _as_it_is(self, cells: Cells, number: int) -> tuple[Cells, int]:
        """A layer's cell with what it holds now; where nothing is known, as it is in the layer."""
        lower = cells.lower[number]
        there = self._blocks.get(tuple((lower // self._edge).tolist()), self._none)
        same = np.flatnonzero((there.lower == lower).all(axis=1) & (there.size == cells.size[number]))
        return (there, int(same[0])) if len(same) else (cells, number)


def _alike(one: Cells, other: Cells) -> bool:
    """Whether cells are at the same places, of the same sizes and states."""
    return len(one) == len(other) and all(
        np.array_equal(getattr(one, name), getattr(other, name)) for name in ("lower", "size", "state")
    )
