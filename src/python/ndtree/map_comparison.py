# SPDX-License-Identifier: BSD-3-Clause
"""Two maps of any kind beside each other: where their states agree, and how far their surfaces are apart."""

from __future__ import annotations

import json
import math
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Union

import numpy as np
from numpy.typing import NDArray

from ndtree import _core
from ndtree._core import OccupancyMap
from ndtree.files import replaced
from ndtree.maps import PlacedMap, open_map

AnyMap = Union[OccupancyMap, PlacedMap, str, "os.PathLike[str]"]
Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

STATES = ("unknown", "free", "occupied")
MAX_POINTS = 200_000
_BLOCKS_AT_ONCE = 1 << 15
_TOO_LARGE = 1 << 40  # Cells along an axis: more have no exact numbers.


class MapComparison(dict[str, Any]):
    """The figures of `compare_maps`, ready for JSON, with the maps themselves in ``placed``."""

    placed: tuple[PlacedMap, PlacedMap]

    def to_json(self) -> str:
        """The figures as JSON, indented."""
        return json.dumps(self, indent=2, allow_nan=False) + "\n"

    def draw(self, path: str | os.PathLike[str]) -> None:
        """Draw where the maps differ: the plane, or a view from above that shows what most of a column is.

        Parameters
        ----------
        path : str or path
            A picture file, by its ending; it appears whole or not at all.

        Raises
        ------
        OSError
            If it cannot be written.
        ValueError
            If neither map knows anything, or there is no such kind of picture.
        ImportError
            If matplotlib is not installed; it names the extra.
        """
        _draw(self, Path(path))

    def __str__(self) -> str:
        """Two tables: states, and distances."""
        return _table(self)


def compare_maps(
    a: AnyMap, b: AnyMap, *, cell_size: float | None = None, max_points: int = MAX_POINTS
) -> MapComparison:
    """Compare two maps, cell by cell and surface by surface.

    Both are asked at the centres of the same cells, which are those of the map with the smaller ones unless a
    size is given. Where both say one thing in a whole block, it is counted without asking for each cell: the
    counts are those of all cells nonetheless.

    Parameters
    ----------
    a, b : map, PlacedMap, str or path
        Maps, or files of ours, OctoMap's (.bt, .ot) or map_server's (.yaml).
    cell_size : float, optional
        Of the cells that are compared [m].
    max_points : int
        Distances are measured from so many cells of each map at most, drawn at random (always the same).

    Returns
    -------
    MapComparison
        A dict. "cells" counts by the states in a, and then in b; cells that both do not know are not counted.
        "agreement" is the share of cells on which both agree, of those that both know; "known_in_both" the
        share of those of all that one knows; "occupied_overlap" the cells that are occupied in both, of those
        that are in one. "distances" [m] are from centres of occupied cells of one map to the nearest occupied
        cell of the other, 0 inside it: "a_to_b" and "b_to_a" with their mean, median, 95th percentile and
        largest, and "hausdorff", the larger of these. What has no cell to count is None.

    Raises
    ------
    OSError
        If a file cannot be read.
    ValueError
        If a file is damaged, the maps have different dimensions, or a value is out of bounds.
    """
    first, second = _placed(a, "a"), _placed(b, "b")
    if first.map.dim != second.map.dim:
        raise ValueError(
            f"{first.name} is {first.map.dim}-D and {second.name} {second.map.dim}-D: must be the same"
        )
    if cell_size is not None and not (cell_size > 0 and math.isfinite(cell_size)):
        raise ValueError(f"cell_size = {cell_size} m: must be > 0 and finite")
    if max_points < 1:
        raise ValueError(f"max_points = {max_points}: must be >= 1")
    grid = _grid(first, second, cell_size)
    counts = np.zeros((3, 3), dtype=np.int64)
    for _, size, states in grid.blocks(first, second):
        np.add.at(counts, (states[:, 0], states[:, 1]), size**first.map.dim)
    a_to_b = _distances(first, second, grid.cell_size, max_points)
    b_to_a = _distances(second, first, grid.cell_size, max_points)
    both = counts[1:, 1:]
    known = int(counts.sum() - counts[0, 0])
    occupied = int(counts[2].sum() + counts[:, 2].sum() - counts[2, 2])
    result = MapComparison(
        a=_about(first),
        b=_about(second),
        dim=first.map.dim,
        cell_size=grid.cell_size,
        cells={
            one: {other: int(counts[i, j]) for j, other in enumerate(STATES) if (i, j) != (0, 0)}
            for i, one in enumerate(STATES)
        },
        agreement=_share(int(np.trace(both)), int(both.sum())),
        known_in_both=_share(int(both.sum()), known),
        occupied_overlap=_share(int(counts[2, 2]), occupied),
        distances={
            "a_to_b": a_to_b,
            "b_to_a": b_to_a,
            "hausdorff": max(a_to_b["max"], b_to_a["max"]) if a_to_b and b_to_a else None,
        },
    )
    result.placed = (first, second)
    return result


def _placed(m: AnyMap, name: str) -> PlacedMap:
    if isinstance(m, PlacedMap):
        return m
    if not isinstance(m, OccupancyMap):
        return open_map(m)
    if m.refinement == "octomap":  # Its file is the way to all that it knows.
        if m.dim != 3:
            raise ValueError(f"{name}: an OctoMap with dim = {m.dim}: must be 3 to be compared")
        with tempfile.TemporaryDirectory() as folder:
            m.save(Path(folder, "map.ot"))
            m = _core.load_octomap(Path(folder, "map.ot"))
    return PlacedMap(m, np.zeros(m.dim), name)


def _about(one: PlacedMap) -> dict[str, Any]:
    stats = one.map.stats()
    return {"map": one.name, "cell_size": one.cell_size, "cells": int(stats.observed_leaves)}


def _share(part: int, whole: int) -> float | None:
    return part / whole if whole else None


# --- States ---------------------------------------------------------------------------------------


def _grid(a: PlacedMap, b: PlacedMap, cell_size: float | None) -> _Grid:
    """Cells that begin where those of the finer map do."""
    finer = a if a.cell_size <= b.cell_size else b
    return _Grid(finer.offset, finer.cell_size if cell_size is None else cell_size)


class _Grid:
    """Cells of one size: number i on an axis is [origin + i * cell_size, origin + (i + 1) * cell_size)."""

    def __init__(self, origin: Floats, cell_size: float) -> None:
        self.origin = origin
        self.cell_size = cell_size

    def centres(self, cells: Integers) -> Floats:
        return self.origin + (cells + 0.5) * self.cell_size

    def around(self, *maps: PlacedMap) -> tuple[Integers, Integers] | None:
        """First and last numbers, (dim,) each, of the cells that any of the maps knows something of."""
        lows, highs = [], []
        for one in maps:
            leaves = one.map.leaves()
            known = leaves.state >= 0
            if known.any():
                lower = leaves.lower[known] + one.offset
                lows.append(lower.min(axis=0))
                highs.append((lower + leaves.size[known, None]).max(axis=0))
        if not lows:
            return None
        low = np.floor((np.min(lows, axis=0) - self.origin) / self.cell_size)
        high = np.ceil((np.max(highs, axis=0) - self.origin) / self.cell_size)
        if np.abs([low, high]).max() > _TOO_LARGE:
            raise ValueError(f"cell_size = {self.cell_size} m: too small for maps that lie so far from 0")
        return low.astype(np.int64), high.astype(np.int64) - 1

    def blocks(self, a: PlacedMap, b: PlacedMap) -> Iterator[tuple[Integers, int, Integers]]:
        """Blocks of cells in which each map has one state: all cells that one of them knows, each once.

        Yields lower cells (n, dim), the edge in cells, and states (n, 2), 0 to 2 for `STATES`.
        """
        bounds = self.around(a, b)
        if bounds is None:
            return
        first, last = bounds
        dim = len(first)
        edge = 1 << max(0, int(np.max(last - first)).bit_length())
        ways = np.stack(np.meshgrid(*[[0, 1]] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
        waiting = [(first[None, :], edge)]
        while waiting:
            lower, edge = waiting.pop()
            states = np.column_stack([self._states(one, lower, edge) for one in (a, b)])
            done = (states >= 0).all(axis=1)
            some = done & (states > 0).any(axis=1)
            if some.any():
                yield lower[some], edge, states[some]
            open_ = lower[~done]
            half = edge // 2
            for begin in range(0, len(open_), _BLOCKS_AT_ONCE):
                part = open_[begin : begin + _BLOCKS_AT_ONCE]
                waiting.append(((part[:, None, :] + ways * half).reshape(-1, dim), half))

    def _states(self, one: PlacedMap, lower: Integers, edge: int) -> Integers:
        """State of each block, 0 to 2, or -1 where it has more than one."""
        if edge == 1:
            return one.state(self.centres(lower)).astype(np.int64) + 1
        found = one.map.states_in(
            self.centres(lower) - one.offset, self.centres(lower + (edge - 1)) - one.offset
        )
        return np.where(found.sum(axis=1) == 1, found.argmax(axis=1), -1)


# --- Distances ------------------------------------------------------------------------------------


def _distances(one: PlacedMap, other: PlacedMap, cell_size: float, max_points: int) -> dict[str, Any] | None:
    """From occupied cells of one map to the other; None where one of them has none."""
    points = _surface(one, cell_size, max_points)
    if not len(points):
        return None
    distance = other.map.distance_to_occupied(points + one.offset - other.offset)
    if np.isnan(distance).any():
        return None
    return {
        "points": len(points),
        "mean": float(distance.mean()),
        "median": float(np.median(distance)),
        "p95": float(np.percentile(distance, 95)),
        "max": float(distance.max()),
    }


def _surface(one: PlacedMap, cell_size: float, max_points: int) -> Floats:
    """Centres of the parts of occupied leaves, in the map's own frame: each divided into as many as have
    about the cell size, of which those inside it are left out."""
    leaves = one.map.leaves()
    chosen = leaves.state == 1
    lower, size = leaves.lower[chosen], leaves.size[chosen]
    dim = lower.shape[1]
    parts = np.maximum(1, np.rint(size / cell_size).astype(np.int64))
    count = parts**dim - np.maximum(parts - 2, 0) ** dim
    total = int(count.sum())
    share = min(1.0, max_points / total) if total else 1.0
    generator = np.random.default_rng(0)
    result = []
    for n in np.unique(parts):
        here = parts == n
        border = _border(int(n), dim)
        at = (border + 0.5) / n
        points = (lower[here, None, :] + at * size[here, None, None]).reshape(-1, dim)
        if share < 1:
            points = points[generator.random(len(points)) < share]
        result.append(points)
    return np.concatenate(result) if result else np.empty((0, dim))


def _border(n: int, dim: int) -> Integers:
    """Numbers (m, dim) of the cells at the border of a cube of n cells an axis."""
    every = np.stack(np.meshgrid(*[np.arange(n)] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
    return every[((every == 0) | (every == n - 1)).any(axis=1)]


# --- Picture --------------------------------------------------------------------------------------

# What is shown of a cell: states in a and b, color and words. Of a column that has occupied cells, those are
# shown, and what most of them are.
_SHOWN = (
    ((0, 0), "#ffffff", None),
    ((1, 1), "#e6e6e6", "free in both"),
    ((1, 0), "#f6ddd2", "free in a, unknown in b"),
    ((0, 1), "#d3e3f3", "free in b, unknown in a"),
    ((2, 2), "#303030", "occupied in both"),
    ((2, 0), "#ef9a6a", "occupied in a, unknown in b"),
    ((0, 2), "#7fb2e0", "occupied in b, unknown in a"),
    ((2, 1), "#c4161c", "occupied in a, free in b"),
    ((1, 2), "#1f4fb4", "occupied in b, free in a"),
)
_FIRST_OCCUPIED = 4
_MAX_PIXELS = 2000


def _draw(result: MapComparison, path: Path) -> None:
    from ndtree import plot  # @raises ImportError that names the extra.

    if path.suffix.lower() not in plot.FORMATS:
        raise ValueError(f"{path}: the name must end in {', '.join(plot.FORMATS)}")
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.colors import ListedColormap
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    a, b = result.placed
    image, extent = _differences(result)
    wide, high = extent[1] - extent[0], extent[3] - extent[2]
    above, below = 0.6, 1.5  # Room for the title, and for the words below [inches].
    size = (9.0, min(14.0, max(3.0, 8.2 * high / wide)) + above + below)
    figure = Figure(figsize=size)
    FigureCanvasAgg(figure)
    figure.subplots_adjust(left=0.09, right=0.98, bottom=below / size[1], top=1 - above / size[1])
    axes = figure.add_subplot()
    axes.imshow(
        image.T,
        origin="lower",
        extent=extent,
        cmap=ListedColormap([color for _, color, _ in _SHOWN]),
        vmin=-0.5,
        vmax=len(_SHOWN) - 0.5,
        interpolation="nearest",
    )
    axes.set_aspect("equal")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    seen = "" if result["dim"] == 2 else ", from above"
    axes.set_title(f"a: {a.name}\nb: {b.name}{seen}", fontsize=9, loc="left")
    there = set(np.unique(image).tolist())
    patches = [
        Patch(facecolor=color, edgecolor="#808080", linewidth=0.5, label=text)
        for i, (_, color, text) in enumerate(_SHOWN)
        if text and i in there
    ]
    figure.legend(handles=patches, loc="lower center", ncol=3, fontsize=8, frameon=False)
    with replaced(path) as part:
        figure.savefig(part, dpi=150)


def _differences(result: MapComparison) -> tuple[NDArray[np.int8], tuple[float, float, float, float]]:
    """Numbers in `_SHOWN` by x and y, and x_min, x_max, y_min, y_max [m]."""
    a, b = result.placed
    grid = _grid(a, b, result["cell_size"])
    bounds = grid.around(a, b)
    if bounds is None:
        raise ValueError("neither map knows anything: there is nothing to draw")
    low, high = bounds[0][:2], bounds[1][:2] + 1
    step = max(1, math.ceil(int(np.max(high - low)) / _MAX_PIXELS))
    shape = -(-(high - low) // step)
    counts = np.zeros((len(_SHOWN), *shape), dtype=np.float32)
    number = np.zeros((3, 3), dtype=np.int64)
    for i, (states, _, _) in enumerate(_SHOWN):
        number[states] = i
    for lower, edge, states in grid.blocks(a, b):
        kind = number[states[:, 0], states[:, 1]]
        first = (lower[:, :2] - low) // step
        last = (lower[:, :2] + edge - 1 - low) // step + 1
        weight = edge ** (a.map.dim - 2) * min(edge, step) ** 2  # Of a block in each of its pixels.
        single = (last - first == 1).all(axis=1)
        np.add.at(counts, (kind[single], first[single, 0], first[single, 1]), weight)
        for shown, (x0, y0), (x1, y1) in zip(kind[~single], first[~single], last[~single]):
            counts[shown, x0:x1, y0:y1] += weight
    counts[_FIRST_OCCUPIED:] *= np.float32(2) ** 40  # However few they are.
    image = np.where(counts.any(axis=0), counts.argmax(axis=0), 0).astype(np.int8)
    corner = grid.origin[:2] + low * grid.cell_size
    upper = corner + shape * step * grid.cell_size
    return image, (float(corner[0]), float(upper[0]), float(corner[1]), float(upper[1]))


# --- Tables ---------------------------------------------------------------------------------------


def _table(result: MapComparison) -> str:
    lines = [
        f"{key}: {result[key]['map']}, {result[key]['cells']:,} cells from {result[key]['cell_size']:g} m"
        for key in "ab"
    ]
    lines += ["", f"cells of {result['cell_size']:g} m, by their state in a and in b:", ""]
    rows = [["a \\ b", *STATES]]
    for one in STATES:
        rows.append(
            [one, *(f"{result['cells'][one][o]:,}" if o in result["cells"][one] else "" for o in STATES)]
        )
    lines += _aligned(rows)
    lines.append("")
    for key, text in (
        ("agreement", "of the cells that both know, their states agree on"),
        ("known_in_both", "of the cells that one knows, both know"),
        ("occupied_overlap", "of the cells that are occupied in one, both have occupied"),
    ):
        share = result[key]
        lines.append(f"{text}: " + (f"{100 * share:.2f} %" if share is not None else "there are none"))
    distances = result["distances"]
    rows = [["distance to the nearest [m]", "cells", "mean", "median", "95 %", "largest"]]
    for key, text in (("a_to_b", "from a's occupied to b's"), ("b_to_a", "from b's occupied to a's")):
        if distances[key]:
            figures = (f"{distances[key][name]:.3f}" for name in ("mean", "median", "p95", "max"))
            rows.append([text, f"{distances[key]['points']:,}", *figures])
    if len(rows) > 1:
        lines += ["", *_aligned(rows)]
    return "\n".join(lines)


def _aligned(rows: list[list[str]]) -> list[str]:
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return [
        "  ".join(
            [row[0].ljust(widths[0]), *(cell.rjust(width) for cell, width in zip(row[1:], widths[1:]))]
        ).rstrip()
        for row in rows
    ]
