# SPDX-License-Identifier: BSD-3-Clause
"""What commands print of maps and logs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ndtree._native._core import OccupancyMap, default_options, leaf_counts
from ndtree.base.words import aligned, in_full, number_of, percent
from ndtree.cells.lattice import observed_bounds
from ndtree.cli.commands.logs import length_of
from ndtree.cli.commands.messages import indented
from ndtree.cli.commands.progress import progress
from ndtree.logs import Log

_SPACES = {2: "area", 3: "volume", 4: "volume"}
#: Frames of a bag that are printed.
FRAME_LINES = 60
#: A beam may pass this many of the smallest cells; maps refuse longer ones.
LONGEST_BEAM = 2**20
#: The median range of longer logs is that of every second, fourth, ... beam.
RANGE_SAMPLE = 2_000_000
#: Of a log without an index, what is read to say what it is.
FIRST_BEAMS = 1_000_000


def map_figures(m: OccupancyMap) -> dict[str, Any]:
    stats, rows = m.stats(), leaf_counts(m)
    counts = ("leaves", "observed_leaves", "nodes", "updates", "splits", "merges", "memory_bytes")
    states = {state: sum(row[at] for row in rows) for state, at in (("free", 2), ("occupied", 3))}
    bounds = None
    if rows:
        lower, upper = observed_bounds(m)
        bounds = {"lower": lower.tolist(), "upper": upper.tolist()}
    return {
        "dim": m.dim,
        "branching": m.branching,
        "refinement": m.refinement,
        "options": m.options,
        "stats": {key: int(getattr(stats, key)) for key in counts},
        "cells": states,
        "disputed": m.disputed if m.refinement == "evidence" and rows else None,
        "cell_sizes": [{"size": row[0], "observed": row[1]} for row in rows],
        "observed_bounds": bounds,
    }


def print_map(figures: dict[str, Any]) -> None:
    """What `map_figures` found."""
    stats, states = figures["stats"], figures["cells"]
    print(
        f"  {stats['observed_leaves']:,} observed leaves of {stats['leaves']:,}: "
        f"{states['occupied']:,} occupied, {states['free']:,} free; "
        f"{number_of(stats['nodes'], 'node')} in {stats['memory_bytes'] / 2**20:.2f} MiB"
    )
    print(f"  {', '.join(number_of(stats[one + 's'], one) for one in ('update', 'split', 'merge'))}")
    if figures["observed_bounds"]:
        print(
            f"  observed from {point(figures['observed_bounds']['lower'])} "
            f"to {point(figures['observed_bounds']['upper'])} m"
        )
    if figures["disputed"] is not None:
        space = _SPACES[figures["dim"]]
        print(f"  disputed (inconsistent over time): {percent(figures['disputed'])} of the observed {space}")
    for row in figures["cell_sizes"]:
        print(f"  cells of {row['size']:g} m: {row['observed']:,}")


def log_figures(log: Log, *, most: int | None = None) -> dict[str, Any]:
    """Figures of a log, or of its first scans with at least `most` beams."""
    beams = dict.fromkeys(("beams", "returned", "not_returned", "invalid"), 0)
    ranges: list[Any] = []
    low, high = np.full(log.dim, np.inf), np.full(log.dim, -np.inf)
    kept, thin = 0, 1
    scans, longest, first, last = 0, 0.0, math.inf, -math.inf
    with progress() as advance:
        for scan in log:
            scans += 1
            first, last = min(first, scan.stamp), max(last, scan.stamp)
            distance = np.linalg.norm(scan.endpoints - scan.origin, axis=1)
            valid = np.isfinite(distance) & ((distance > 0) | scan.points_only)
            returned = valid & scan.did_return
            beams["beams"] += len(scan)
            beams["invalid"] += int(np.count_nonzero(~valid))
            beams["returned"] += int(np.count_nonzero(returned))
            beams["not_returned"] += int(np.count_nonzero(valid & ~returned))
            ranges.append(distance[returned & (distance > 0)][::thin])
            kept += len(ranges[-1])
            if kept > RANGE_SAMPLE:
                ranges = [np.concatenate(ranges)[::2]]
                kept, thin = len(ranges[0]), 2 * thin
            if returned.any():
                longest = max(longest, float(distance[returned].max()))
                low = np.minimum(low, scan.endpoints[returned].min(axis=0))
                high = np.maximum(high, scan.endpoints[returned].max(axis=0))
            advance("reading", scans, length_of(log))
            if most is not None and beams["beams"] >= most:
                break
    is_whole = most is None or beams["beams"] < most or scans == length_of(log)
    if not scans:
        raise log.without_scans()
    every = np.concatenate(ranges)
    known = every.size > 0
    return {
        "log": str(log.path),
        "format": log.format,
        "uses": log.uses,
        "dim": log.dim,
        "scans": scans,
        "is_whole": is_whole,
        "beams": beams,
        "seconds": float(last - first),
        "range": {"median": float(np.median(every)), "max": longest} if known else None,
        "bounds": {"lower": low.tolist(), "upper": high.tolist()} if (low <= high).all() else None,
    }


def print_contents(path: Path, held: dict[str, Any]) -> None:
    """The topics of a bag."""
    start, end = held["start"], held["end"]
    times = f"{end - start:.1f} s from {start:.3f} to {end:.3f} s"
    print(f"{path}: {times if held['topics'] else 'no messages'}")
    rows = [
        [
            topic["topic"],
            topic["type"],
            str(topic["messages"]),
            topic["frame"] or "",
            "" if topic["rate"] is None else f"{in_full(topic['rate'], 3)} Hz",
            topic["encoding"] or "",
        ]
        for topic in held["topics"]
    ]
    for line in aligned(rows, left=len(rows[0])) if rows else ():
        print(f"  {line}")
    if held["frames"]:
        print("  frames:")
        for line in held["frames"][:FRAME_LINES]:
            print(f"    {line}")
        if len(held["frames"]) > FRAME_LINES:
            print(f"    ... and {len(held['frames']) - FRAME_LINES} more")
    for line in held["damage"]:
        print(f"  {line}")


def print_log(figures: dict[str, Any]) -> None:
    first = "" if figures["is_whole"] else "the first "
    print(
        f"{figures['log']}: {figures['format']} log, {figures['dim']}-D, "
        f"{first}{number_of(figures['scans'], 'scan')}"
        + (f" in {figures['seconds']:.1f} s" if figures["seconds"] > 0 else "")
    )
    if figures["uses"]:
        print(indented(f"uses {figures['uses']}"))
    print(f"  {counted(figures['beams'])}")
    if figures["range"]:
        median, longest = figures["range"]["median"], figures["range"]["max"]
        print(f"  ranges: median {_metres(median)} m, longest {_metres(longest)} m")
        if longest > LONGEST_BEAM * (cell := default_options()["min_cell_size"]):
            print(f"  beams longer than {LONGEST_BEAM * cell:,.0f} m fit into no map, expected --max-range M")
    if figures["bounds"]:
        print(
            f"  end points from {point(figures['bounds']['lower'])} to {point(figures['bounds']['upper'])} m"
        )


def counted(counts: dict[str, int]) -> str:
    parts = [
        f"{count:,} {key.replace('_', ' ')}" for key, count in counts.items() if key != "beams" and count
    ]
    return number_of(counts["beams"], "beam") + (f": {', '.join(parts)}" if parts else "")


def point(values: Sequence[float]) -> str:
    return f"({', '.join(_metres(value) for value in values)})"


def _metres(value: float) -> str:
    return f"{value:.2f}" if abs(value) < 1e9 else f"{value:.3g}"  # Not three hundred digits.
