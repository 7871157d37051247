# SPDX-License-Identifier: BSD-3-Clause
"""Maps made in turns from the same scans, and what each costs."""

from __future__ import annotations

import os
import statistics
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Union

import numpy as np

from ndtree._native import _core
from ndtree._native._core import OccupancyMap
from ndtree.base.scan import Scan
from ndtree.maps.kinds import make_map

MapMaker = Callable[[], OccupancyMap]
Maps = Union[Sequence[str], Mapping[str, MapMaker]]
OUTCOMES = ("returned", "not_returned", "beyond_max_range", "invalid")
COUNTED = ("leaves", "nodes", "updates", "splits", "merges", "memory_bytes")


def makers_of(maps: Maps, dim: int, options: dict[str, Any]) -> dict[str, MapMaker]:
    if isinstance(maps, Mapping):
        if options:
            raise TypeError("maps made by own functions take no further options")
        makers = dict(maps)
    else:
        if isinstance(maps, str) or len(set(maps)) != len(maps):
            raise ValueError(f"maps = {maps!r}: must be different names")
        makers = {name: lambda name=name: make_map(name, dim=dim, **options) for name in maps}
    if not makers:
        raise ValueError("maps: must name at least one")
    return makers


class Built:
    """One candidate: the map of the first run, and the times of all."""

    map: OccupancyMap

    def __init__(self) -> None:
        self.seconds: list[float] = []
        self.beams = dict.fromkeys(OUTCOMES, 0)
        self.resident_bytes: int | None = None


def build_once(
    built: Built,
    make: MapMaker,
    scans: Mapping[int, Scan],
    max_range: float,
    progress: Callable[[int, int], None],
) -> None:
    first = not built.seconds
    before = _resident_bytes()
    target = make()
    seconds = 0.0
    for done, (i, scan) in enumerate(scans.items(), start=1):
        try:
            report = scan.insert_into(target, max_range=max_range, threads=1)
        except ValueError as error:
            raise ValueError(f"scan {i}: {error}") from None
        seconds += report.seconds
        if first:
            for outcome in OUTCOMES:
                built.beams[outcome] += getattr(report, outcome)
        progress(done, len(scans))
    built.seconds.append(seconds)
    if first:
        # The maps of the first run are kept, so that no map grows into memory that another has freed.
        built.map = target
        after = _resident_bytes()
        if before is not None and after is not None:
            built.resident_bytes = _growth(after - before, target)


def _growth(grown: int, target: OccupancyMap) -> int | None:
    """Unless it is less than the map holds: then the map lies in pages that were freed before."""
    return grown if grown >= target.stats().memory_bytes else None


def _resident_bytes() -> int | None:
    """Memory of this process that is in use; None where the system does not say."""
    try:
        with open("/proc/self/statm", "rb") as file:
            return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, AttributeError):
        return None


def figures_of(name: str, built: Built) -> dict[str, Any]:
    stats = built.map.stats()
    leaves = built.map.leaves()
    median = statistics.median(built.seconds)
    is_octomap = _core.has_octomap and isinstance(built.map, _core.OctoMap)
    row: dict[str, Any] = {
        "map": name,
        "refinement": built.map.refinement,
        "cells": int(stats.observed_leaves),
    }
    row.update({key: int(getattr(stats, key)) for key in COUNTED})
    if is_octomap:  # It has no such thing, which is not the same as none.
        row["splits"] = row["merges"] = None
    row["seconds"] = {
        "median": median,
        "min": min(built.seconds),
        "max": max(built.seconds),
        "runs": len(built.seconds),
    }
    row["beams_per_second"] = sum(built.beams.values()) / median if median > 0 else None
    row["bytes_per_node"] = row["memory_bytes"] / row["nodes"] if row["nodes"] else None
    row["resident_bytes"] = built.resident_bytes
    if is_octomap:
        row["cells_pruned"] = int(stats.pruned_leaves)
    sizes, where, count = np.unique(leaves.size, return_inverse=True, return_counts=True)
    observed = np.bincount(where.ravel(), weights=leaves.observed, minlength=len(sizes))
    row["cell_sizes"] = [
        {"size": float(size), "observed": int(seen), "leaves": int(all_)}
        for size, seen, all_ in zip(sizes[::-1], observed[::-1], count[::-1])
    ]
    return row
