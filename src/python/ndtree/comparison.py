# SPDX-License-Identifier: BSD-3-Clause
"""Maps of the same log side by side: cells, updates, time, memory and truth, all counted alike."""

from __future__ import annotations

import csv
import io
import json
import math
import os
import statistics
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any, Union

import numpy as np
from numpy.typing import NDArray

from ndtree import _core
from ndtree._core import OccupancyMap
from ndtree._options import make_map
from ndtree.exact_truth import FOUND_WITHIN, NEAR_SURFACE, ExactTruth
from ndtree.no_returns import AUTO, believed
from ndtree.readers.log import Log
from ndtree.readers.simulated import SimulatedLog
from ndtree.scan import Scan

MapMaker = Callable[[], OccupancyMap]
Maps = Union[Sequence[str], Mapping[str, MapMaker]]
Progress = Callable[[str, int, int], None]

DEFAULT_MAPS = ("adaptive", "fixed", "octomap") if _core.has_octomap else ("adaptive", "fixed")
NO_RETURN = ("free", "ignore", AUTO)
OUTCOMES = ("returned", "not_returned", "beyond_max_range", "invalid")
CLAIMED = ("points", "seen", "free", "free_and_unseen", "unknown_and_seen")
SHARES_OF_VOLUME = ("free_unseen", "seen_unknown", "wrong_volume")
COUNTED = ("leaves", "nodes", "updates", "splits", "merges", "memory_bytes")
NEEDED = ("cells", "nodes", "updates", "memory_bytes", "resident_bytes")


class Comparison(dict[str, Any]):
    """The figures of `compare`, ready for JSON, with the maps themselves in ``map_objects``."""

    map_objects: dict[str, OccupancyMap]

    def row(self, name: str) -> dict[str, Any]:
        """The figures of one map."""
        for row in self["maps"]:
            if row["map"] == name:
                return row
        raise KeyError(name)

    def to_json(self) -> str:
        """The figures as JSON, indented."""
        return json.dumps(self, indent=2, allow_nan=False) + "\n"

    def to_csv(self) -> str:
        """One line for each map, with the log and its size in front."""
        rows = [{"log": self["log"], "scans": self["scans"], **_flat(row)} for row in self["maps"]]
        columns = list(dict.fromkeys(column for row in rows for column in row))
        text = io.StringIO()
        writer = csv.DictWriter(text, columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
        return text.getvalue()

    def __str__(self) -> str:
        """A table with a column for each map."""
        return _table(self)


def compare(
    log: Log | Iterable[Scan],
    maps: Maps | None = None,
    *,
    held_out: int = 10,
    max_range: float = math.inf,
    no_return: str = AUTO,
    repeat: int = 1,
    cell_size: float | None = None,
    progress: Progress | None = None,
    **options: Any,
) -> Comparison:
    """Map a log in several ways, and say what each map costs and how true it is.

    Parameters
    ----------
    log : Log or iterable of Scan
        Read once, and kept in memory.
    maps : sequence of str, or mapping of str to callable, optional
        Names are "adaptive", "paper" (refined exactly as the paper has it), "fixed", "octomap" and
        "octomap-scan" (updated once a scan), with @ and a cell size [m] where it is not the common one, as
        in "fixed@0.1". A mapping has own names with functions that make the maps. Left out: adaptive, fixed
        and, where there is one, OctoMap.
    held_out : int
        Each held_out-th scan is not mapped, and tells how true the maps are; 0 maps all.
    max_range : float
        Longer beams say only that the space up to there is free [m].
    no_return : str
        What a beam without return says: "free", that space is free up to its end point; "ignore", nothing;
        "auto", of a log from a file what `ndtree.no_returns.judge` finds, else "free".
    repeat : int
        How often each map is made, in turns, for the times. Updates and cells do not depend on it.
    cell_size : float, optional
        Smallest cells [m]. Left out: the adaptive map's own default.
    progress : callable, optional
        Called as ``progress(what, done, total)`` with numbers of scans.
    **options
        As in `AdaptiveMap`; each map gets those that it knows.

    Returns
    -------
    Comparison
        A dict. "cells" are leaves that at least one beam updated, "updates" pairs of a beam and a leaf,
        "seconds" the insertion alone. "truth" is about the scans held out: of "samples", points every 0.1 m
        along the beams up to 0.1 m before their end, how many the map calls free, occupied and unknown; how
        many end points are within 0.05 m of an occupied cell; how many ray casts end within 0.1 m of the
        measured range, and their median error [m]; "balanced_accuracy", the mean of the shares of free space
        and end points that are right; and "log_score", the mean log-likelihood [nats] of both under the map's
        probabilities, clipped to [0.02, 0.98]. "claims" is about space that nobody looked at, and the scans
        that were mapped: of "points" drawn uniformly around the log's end points, how many were "seen" by
        some beam's share of its scan's view (`SeenSpace`; on simulated logs by the exact line of sight),
        and what the map says of them. "free_unseen" is the share of the space called free that was not seen,
        "seen_unknown" the share of the space seen that is called unknown, and "wrong_volume" both volumes
        over the volume seen. "exact", on simulated logs, compares with the world itself. "ratios" say what
        the adaptive map needs of the fixed one.

    Raises
    ------
    ValueError
        If an option is out of its limits, or the log is damaged or empty.
    """
    for name, value, least in (("held_out", held_out, 0), ("repeat", repeat, 1)):
        if value < least:
            raise ValueError(f"{name} = {value}: must be >= {least}")
    if held_out == 1:
        raise ValueError("held_out = 1: must be 0 or at least 2, or nothing is left to map")
    if no_return not in NO_RETURN:
        raise ValueError(f"no_return = {no_return!r}: must be one of {', '.join(NO_RETURN)}")
    if maps is None:
        maps = DEFAULT_MAPS
    if "min_cell_size" in options:
        if cell_size is not None:
            raise ValueError("cell_size and min_cell_size say the same: give one of them")
        cell_size = options.pop("min_cell_size")
    progress = progress or no_progress
    scans = _loaded(log, progress)
    if no_return == AUTO:
        no_return = believed(log, scans)
    if no_return == "ignore":
        scans = [scan.returned_only() for scan in scans]
    dim = scans[0].dim
    makers = _makers(maps, dim, cell_size, options)
    mapped = {i: scan for i, scan in enumerate(scans) if not is_held_out(i, held_out)}
    if not mapped:
        raise ValueError("held_out: no scan is left to map")
    unseen = [scan for i, scan in enumerate(scans) if is_held_out(i, held_out)]

    built = {name: _Built() for name in makers}
    for run in range(repeat):
        for name, make in makers.items():
            label = name if repeat == 1 else f"{name}, run {run + 1}"
            _build(built[name], make, mapped, max_range, partial(progress, label))

    space = _seen_space(log, list(mapped.values()), max_range, partial(progress, "what the scans saw"))
    rows = []
    for name, one in built.items():
        row = _figures(name, one)
        row["truth"] = _truth(one.map, unseen, max_range, partial(progress, f"{name}, truth"))
        row["claims"] = _claims(one.map, space)
        rows.append(row)
    if isinstance(log, SimulatedLog):
        exact = ExactTruth(log, scans, max_range)
        for row in rows:
            row["exact"] = exact.of(built[row["map"]].map)

    first = next(iter(built.values()))
    map_objects = {name: one.map for name, one in built.items()}
    result = Comparison(
        log=getattr(log, "name", "scans"),
        dim=dim,
        branching=first.map.branching,
        scans=len(scans),
        scans_mapped=len(mapped),
        beams={outcome: first.beams[outcome] for outcome in OUTCOMES},
        parameters={
            **_plain(first.map.options),
            "held_out": held_out,
            "max_range": _finite(max_range),
            "no_return": no_return,
            "repeat": repeat,
            "maps": {name: _plain(one.map.options) for name, one in built.items()},
        },
        maps=rows,
        truth_by_cell_size=_truth_by_size(map_objects, unseen, max_range),
        ratios=_ratios(rows),
    )
    result.map_objects = map_objects
    return result


def no_progress(what: str, done: int, total: int) -> None:
    pass


def is_held_out(i: int, held_out: int) -> bool:
    """Whether scan i, counted from 0, is kept for the truth: the last of every `held_out`."""
    return held_out > 0 and i % held_out == held_out - 1


def _loaded(log: Log | Iterable[Scan], progress: Progress) -> list[Scan]:
    total = len(log) if hasattr(log, "__len__") else 0
    scans: list[Scan] = []
    for scan in log:
        scans.append(scan)
        if scan.dim != scans[0].dim:
            raise ValueError(f"scan {len(scans) - 1} is {scan.dim}-D: must be {scans[0].dim}-D as the first")
        progress("reading", len(scans), total)
    if not scans:
        raise ValueError(f"{getattr(log, 'path', None) or 'log'}: no scans, expected at least one")
    return scans


def _makers(maps: Maps, dim: int, cell_size: float | None, options: dict[str, Any]) -> dict[str, MapMaker]:
    if isinstance(maps, Mapping):
        if options or cell_size is not None:
            raise TypeError("maps made by own functions take no further options")
        makers = dict(maps)
    else:
        if isinstance(maps, str) or len(set(maps)) != len(maps):
            raise ValueError(f"maps = {maps!r}: must be different names")
        makers = {
            name: lambda name=name: make_map(name, dim=dim, cell_size=cell_size, **options) for name in maps
        }
    if not makers:
        raise ValueError("maps: must name at least one")
    return makers


class _Built:
    """One candidate: the map of the first run, and the times of all."""

    map: OccupancyMap

    def __init__(self) -> None:
        self.seconds: list[float] = []
        self.beams = dict.fromkeys(OUTCOMES, 0)
        self.resident_bytes: int | None = None


def _build(
    built: _Built,
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
        built.resident_bytes = None if before is None or after is None else after - before


def _resident_bytes() -> int | None:
    """Memory of this process that is in use; None where the system does not say."""
    try:
        with open("/proc/self/statm", "rb") as file:
            return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, AttributeError):
        return None


def _figures(name: str, built: _Built) -> dict[str, Any]:
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


def _truth(
    target: OccupancyMap, scans: Sequence[Scan], max_range: float, progress: Callable[[int, int], None]
) -> dict[str, Any] | None:
    if not scans:
        return None
    truth = _core.HeldOutTruth()
    for done, scan in enumerate(scans, start=1):
        truth += scan.evaluate_on(target, max_range=max_range)
        progress(done, len(scans))
    result: dict[str, Any] = {}
    for total, shares in (
        ("samples", ("free", "occupied", "unknown")),
        ("endpoints", ("endpoints_near",)),
        ("casts", ("casts_within",)),
    ):
        n = getattr(truth, total)
        result.update({key: round(getattr(truth, key) * n) if n else 0 for key in shares})
        result[total] = n
    for key in ("balanced_accuracy", "log_score", "median_error"):
        result[key] = _finite(getattr(truth, key))
    return result


def _seen_space(
    log: Log | Iterable[Scan], scans: Sequence[Scan], max_range: float, progress: Callable[[int, int], None]
) -> _core.SeenSpace:
    progress(0, len(scans))
    of = log.seen_space if isinstance(log, SimulatedLog) else _core.SeenSpace
    space = of(scans, max_range=max_range)
    progress(len(scans), len(scans))
    return space


def _claims(target: OccupancyMap, space: _core.SeenSpace) -> dict[str, Any]:
    claims = target.claims(space)
    result: dict[str, Any] = {key: getattr(claims, key) for key in CLAIMED}
    result.update({key: _finite(getattr(claims, key)) for key in SHARES_OF_VOLUME})
    return result


def _truth_by_size(
    maps: Mapping[str, OccupancyMap], scans: Sequence[Scan], max_range: float
) -> dict[str, Any] | None:
    """Held-out truth of all maps, by the size of the first adaptive map's cells: where errors live.

    One point of each beam is drawn from the free space before its end, beside the end point itself.
    """
    ours = next((name for name, one in maps.items() if isinstance(one, _core.AdaptiveMap)), None)
    if ours is None or not scans:
        return None
    generator = np.random.default_rng(0)
    sizes: dict[float, dict[str, Any]] = {}

    def count(
        points: NDArray[np.float64],
        is_right: Callable[[OccupancyMap], NDArray[np.bool_]],
        total: str,
        right: str,
    ) -> None:
        size_here = np.nan_to_num(maps[ours].cell_size(points), nan=math.inf)  # type: ignore[attr-defined]
        answers = {name: is_right(one) for name, one in maps.items()}
        for size in np.unique(size_here):
            here = size_here == size
            row = sizes.setdefault(float(size), _no_counts(maps))
            row[total] += int(np.count_nonzero(here))
            for name, answer in answers.items():
                row[right][name] += int(np.count_nonzero(answer[here]))

    for scan in scans:
        start, way, far = scan.returned_beams(max_range)
        if not len(far):
            continue
        ends = start + far[:, None] * way
        count(ends, lambda m, p=ends: m.occupied_within(p, FOUND_WITHIN), "endpoints", "endpoints_near")
        long = far > 2 * NEAR_SURFACE
        along = generator.uniform(NEAR_SURFACE, far[long] - NEAR_SURFACE)
        free = start[long] + along[:, None] * way[long]
        if len(free):
            count(free, lambda m, p=free: np.asarray(m.state(p)) == 0, "samples", "free")
    rows = [{"size": _finite(size), **sizes[size]} for size in sorted(sizes, reverse=True)]
    return {"of": ours, "sizes": rows}


def _no_counts(maps: Iterable[str]) -> dict[str, Any]:
    none = dict.fromkeys(maps, 0)
    return {"samples": 0, "free": dict(none), "endpoints": 0, "endpoints_near": dict(none)}


def _ratios(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """What the adaptive map, or else the first, needs of the fixed one, and of others under their names."""
    ours = next((row for row in rows if row["map"] == "adaptive"), rows[0])
    result: dict[str, Any] = {}
    for row in rows:
        if row is ours:
            continue
        pairs = {key: (ours[key], row[key]) for key in NEEDED}
        pairs["seconds"] = (ours["seconds"]["median"], row["seconds"]["median"])
        if "cells_pruned" in row:
            pairs["cells_pruned"] = (ours["cells"], row["cells_pruned"])
        of_map = {key: one / other if one and other else None for key, (one, other) in pairs.items()}
        result.update(of_map if row["map"] == "fixed" else {row["map"]: of_map})
    return result


def _finite(value: float | None) -> float | None:
    """None for what JSON has no number for."""
    return None if value is None or not math.isfinite(value) else value


def _plain(options: Mapping[str, Any]) -> dict[str, Any]:
    return {
        key: _finite(float(value)) if isinstance(value, (float, np.floating)) else value
        for key, value in options.items()
    }


def _flat(row: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested figures as one level: "seconds" and "median" become "seconds_median". Lists are left out."""
    flat: dict[str, Any] = {}
    for key, value in row.items():
        if isinstance(value, Mapping):
            flat.update(_flat(value, f"{prefix}{key}_"))
        elif not isinstance(value, list):
            flat[prefix + key] = value
    return flat


def _table(comparison: Comparison) -> str:
    rows = comparison["maps"]
    lines: list[tuple[str, list[str]]] = []

    def line(label: str, text: Callable[[dict[str, Any]], str | None]) -> None:
        cells = [text(row) for row in rows]
        if any(cell is not None for cell in cells):
            lines.append((label, ["-" if cell is None else cell for cell in cells]))

    def truth(key: str, of: str) -> Callable[[dict[str, Any]], str | None]:
        return lambda row: _percent(row["truth"][key], row["truth"][of]) if row["truth"] else None

    def exact(where: str, state: str) -> Callable[[dict[str, Any]], str | None]:
        return lambda row: _percent(row["exact"].get(where, {}).get(state), 1) if "exact" in row else None

    def claimed(key: str) -> Callable[[dict[str, Any]], str | None]:
        return lambda row: _percent(row["claims"][key], 1)

    line("cells", lambda row: _grouped(row["cells"]))
    line("  after pruning", lambda row: _grouped(row.get("cells_pruned")))
    line("nodes", lambda row: _grouped(row["nodes"]))
    line("updates", lambda row: _grouped(row["updates"]))
    line("time", lambda row: f"{row['seconds']['median']:.3f} s")
    line("beams a second", lambda row: _grouped(row["beams_per_second"]))
    line("memory", lambda row: _bytes(row["memory_bytes"]))
    line("  resident", lambda row: _bytes(row["resident_bytes"]))
    line("free space called free", truth("free", "samples"))
    line("  called occupied", truth("occupied", "samples"))
    line("  called unknown", truth("unknown", "samples"))
    line("end points at occupied", truth("endpoints_near", "endpoints"))
    line("balanced accuracy", lambda row: _percent((row["truth"] or {}).get("balanced_accuracy"), 1))
    line("log score", lambda row: _nats((row["truth"] or {}).get("log_score")))
    line("ray casts within 0.1 m", truth("casts_within", "casts"))
    line("  median error", lambda row: _centimetres((row["truth"] or {}).get("median_error")))
    line("free but unseen", claimed("free_unseen"))
    line("seen but unknown", claimed("seen_unknown"))
    line("wrong volume", claimed("wrong_volume"))
    line("exactly free, called free", exact("free", "free"))
    line("  last 0.1 m before walls", exact("near", "free"))
    line("exactly inside, called occupied", exact("inside", "occupied"))
    line("area under the ROC curve", lambda row: _number((row.get("exact") or {}).get("auc")))
    line("thin things found", exact("thin", "found"))
    line("floor found, under grazing beams", exact("floor", "found"))

    labels = max(len(label) for label, _ in lines)
    widths = [max(len(row["map"]), *(len(cells[i]) for _, cells in lines)) for i, row in enumerate(rows)]
    beams = comparison["beams"]
    held_out = comparison["scans"] - comparison["scans_mapped"]
    head = [
        f"{comparison['log']}, {comparison['dim']}-D: {_grouped(comparison['scans_mapped'])} scans mapped, "
        f"{_grouped(held_out)} held out",
        ", ".join(f"{_grouped(beams[key])} beams {key.replace('_', ' ')}" for key in OUTCOMES if beams[key]),
        "",
        "  ".join([" " * labels, *(row["map"].rjust(width) for row, width in zip(rows, widths))]),
    ]
    body = [
        "  ".join([label.ljust(labels), *(cell.rjust(width) for cell, width in zip(cells, widths))])
        for label, cells in lines
    ]
    ratios = comparison["ratios"]
    needs = [
        f"{100 * ratios[key]:.1f} % of the {'time' if key == 'seconds' else key}"
        for key in ("cells", "updates", "seconds")
        if ratios.get(key) is not None
    ]
    ours = next((row["map"] for row in rows if row["map"] == "adaptive"), rows[0]["map"])
    tail = ["", f"{ours} needs {', '.join(needs)} that fixed needs"] if needs else []
    return "\n".join([*head, *body, *_sizes_table(comparison), *tail])


def _sizes_table(comparison: Comparison) -> list[str]:
    """Which cells of the adaptive map, by size, are right, and whether other maps are right there."""
    by_size = comparison["truth_by_cell_size"]
    if by_size is None:
        return []
    names = [row["map"] for row in comparison["maps"]]
    widths = [max(len(name), 8) for name in names]

    def line(label: str, texts: Iterable[str | None]) -> str:
        cells = ["-" if text is None else text for text in texts]
        return "  ".join([label, *(cell.rjust(width) for cell, width in zip(cells, widths))])

    lines = []
    for title, right, total in (
        ("free space called free, by the size of cells", "free", "samples"),
        ("end points at occupied, by the size of cells", "endpoints_near", "endpoints"),
    ):
        lines += ["", f"{title} ({by_size['of']})", line(" " * 20, names)]
        for row in by_size["sizes"]:
            size = "  not mapped" if row["size"] is None else f"  {row['size']:.4g} m"
            label = f"{size:<12}{_grouped(row[total]):>8}"
            lines.append(line(label, (_percent(row[right][name], row[total]) for name in names)))
    return lines


def _grouped(value: float | None) -> str | None:
    return None if value is None else f"{round(value):,}"


def _percent(part: float | None, whole: float) -> str | None:
    return None if part is None or not whole else f"{100 * part / whole:.2f} %"


def _bytes(value: float | None) -> str | None:
    return None if value is None else f"{value / 2**20:.2f} MiB"


def _number(value: float | None) -> str | None:
    return None if value is None else f"{value:.4f}"


def _nats(value: float | None) -> str | None:
    return None if value is None else f"{value:.3f}"


def _centimetres(value: float | None) -> str | None:
    return None if value is None else f"{100 * value:.2f} cm"
