# SPDX-License-Identifier: BSD-3-Clause
"""Two maps of any kind, cell by cell and surface by surface."""

from __future__ import annotations

import json
import math
import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Union

import numpy as np

from ndtree._errors import WrongValue
from ndtree._native import _core
from ndtree._native._checked import checked
from ndtree._native._core import OccupancyMap
from ndtree.base.words import aligned, number_of
from ndtree.evaluation.map_comparison.blocks import STATES, Floats, Integers, common_grid
from ndtree.maps.open import PlacedMap, open_map


def table_of(result: Mapping[str, Any]) -> str:
    lines = [
        f"{key}: {result[key]['map']}, {number_of(result[key]['cells'], 'cell')} from "
        f"{result[key]['cell_size']:g} m"
        for key in "ab"
    ]
    lines += ["", f"cells of {result['cell_size']:g} m, by their state in a and in b:", ""]
    rows = [["a \\ b", *STATES]]
    for one in STATES:
        rows.append(
            [one, *(f"{result['cells'][one][o]:,}" if o in result["cells"][one] else "" for o in STATES)]
        )
    lines += aligned(rows)
    lines.append("")
    for key, text in (
        ("agreement", "of the cells observed in both, alike in both"),
        ("known_in_both", "of the cells observed in either, observed in both"),
        ("occupied_overlap", "of the cells occupied in either, occupied in both"),
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
        lines += ["", *aligned(rows)]
    return "\n".join(lines)


def distances_between(
    one: PlacedMap, other: PlacedMap, cell_size: float, max_points: int
) -> dict[str, Any] | None:
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


AnyMap = Union[OccupancyMap, PlacedMap, str, "os.PathLike[str]"]
MAX_POINTS = 200_000


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
        from ndtree.plot import FORMATS  # It names the extra where matplotlib is missing.

        path = Path(path)
        if path.suffix.lower() not in FORMATS:
            raise ValueError(f"{path}: the name must end in {', '.join(FORMATS)}")
        from ndtree.evaluation.map_comparison.picture import draw_differences

        draw_differences(*self.placed, self["cell_size"], path)

    def __str__(self) -> str:
        """Two tables: states, and distances."""
        return table_of(self)


@checked
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
        Of the cells that are compared [m]: at least a 64th of those of the finer map.
    max_points : int
        Distances are measured from at most this many cells of each map, drawn at random (always the same).

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
        raise WrongValue.of("cell_size", f"{cell_size} m", "> 0 and finite")
    if max_points < 1:
        raise ValueError(f"max_points = {max_points}: must be >= 1")
    grid = common_grid(first, second, cell_size)
    counts = np.zeros((3, 3), dtype=np.int64)
    for _, size, states in grid.blocks(first, second):
        np.add.at(counts, (states[:, 0], states[:, 1]), size**first.map.dim)
    a_to_b = distances_between(first, second, grid.cell_size, max_points)
    b_to_a = distances_between(second, first, grid.cell_size, max_points)
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
