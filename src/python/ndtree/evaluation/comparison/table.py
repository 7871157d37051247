# SPDX-License-Identifier: BSD-3-Clause
"""What a comparison found, as numbers and as a table."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from ndtree._native._core import OccupancyMap
from ndtree.base.words import aligned, number_of
from ndtree.evaluation.comparison.building import OUTCOMES


def csv_of(rows: Sequence[Mapping[str, Any]]) -> str:
    """A line for each row; nested figures are columns like ``truth_log_score``, and lists are left out."""
    flat = [_flat(row) for row in rows]
    text = io.StringIO()
    columns = list(dict.fromkeys(column for row in flat for column in row))
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(flat)
    return text.getvalue()


def _flat(row: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested figures as one level: "seconds" and "median" become "seconds_median"."""
    flat: dict[str, Any] = {}
    for key, value in row.items():
        if isinstance(value, Mapping):
            flat.update(_flat(value, f"{prefix}{key}_"))
        elif not isinstance(value, list):
            flat[prefix + key] = value
    return flat


def percent(value: float) -> str:
    return f"{100 * value:.2f} %"


def grouped(value: float) -> str:
    return f"{round(value):,}"


#: Of each line what it is called, the figure of a map that it has, or two of which it is the ratio, and how
#: it is written.
_LINES: tuple[tuple[str, str, Callable[[float], str]], ...] = (
    ("cells", "cells", grouped),
    ("  after pruning", "cells_pruned", grouped),
    ("nodes", "nodes", grouped),
    ("updates", "updates", grouped),
    ("time", "seconds.median", "{:.3f} s".format),
    ("beams a second", "beams_per_second", grouped),
    ("memory", "memory_bytes", lambda value: f"{value / 2**20:.2f} MiB"),
    ("  resident", "resident_bytes", lambda value: f"{value / 2**20:.2f} MiB"),
    ("free space called free", "truth.free/truth.samples", percent),
    ("  called occupied", "truth.occupied/truth.samples", percent),
    ("  called unknown", "truth.unknown/truth.samples", percent),
    ("end points at occupied", "truth.endpoints_near/truth.endpoints", percent),
    ("balanced accuracy", "truth.balanced_accuracy", percent),
    ("log score", "truth.log_score", "{:.3f}".format),
    ("  of hits", "truth.hit_log_score", "{:.3f}".format),
    ("ray casts within 0.1 m", "truth.surfaces_within/truth.casts", percent),
    ("  median error", "truth.surface_error", lambda value: f"{100 * value:.2f} cm"),
    ("  to the cell", "truth.casts_within/truth.casts", percent),
    ("  median error", "truth.median_error", lambda value: f"{100 * value:.2f} cm"),
    ("free but unseen", "claims.free_unseen", percent),
    ("seen but unknown", "claims.seen_unknown", percent),
    ("wrong volume", "claims.wrong_volume", percent),
    ("calibration error", "calibration.all.ece", "{:.4f}".format),
    ("  in cells called free", "calibration.free.ece", "{:.4f}".format),
    ("  called occupied", "calibration.occupied.ece", "{:.4f}".format),
    ("free is occupied, at most", "certificate.at_most", percent),
    ("exactly free, called free", "exact.free.free", percent),
    ("  last 0.1 m before walls", "exact.near.free", percent),
    ("exactly inside, called occupied", "exact.inside.occupied", percent),
    ("area under the ROC curve", "exact.auc", "{:.4f}".format),
    ("thin things found", "exact.thin.found", percent),
    ("floor found, under grazing beams", "exact.floor.found", percent),
)


def _at(row: Any, figure: str) -> Any:
    """A figure of a map; None where it has none."""
    for name in figure.split("."):
        row = row.get(name) if isinstance(row, Mapping) else None
    return row


def cell_of(row: Mapping[str, Any], figure: str, form: Callable[[float], str]) -> str | None:
    part, _, whole = figure.partition("/")
    return _ratio(_at(row, part), _at(row, whole) if whole else 1, form)


def _ratio(part: Any, whole: Any, form: Callable[[float], str]) -> str | None:
    return None if part is None or not whole else form(part / whole)


def table_of(comparison: Mapping[str, Any]) -> str:
    rows = comparison["maps"]
    found = [(label, [cell_of(row, figure, form) for row in rows]) for label, figure, form in _LINES]
    lines = [
        (label, ["-" if cell is None else cell for cell in cells]) for label, cells in found if any(cells)
    ]
    beams = comparison["beams"]
    held_out = comparison["scans"] - comparison["scans_mapped"]
    head = [
        f"{comparison['log']}, {comparison['dim']}-D: {number_of(comparison['scans_mapped'], 'scan')} "
        f"mapped, {grouped(held_out)} held out",
        ", ".join(
            f"{number_of(beams[key], 'beam')} {key.replace('_', ' ')}" for key in OUTCOMES if beams[key]
        ),
        "",
    ]
    body = aligned([["", *(row["map"] for row in rows)], *([label, *cells] for label, cells in lines)])
    ratios = comparison["ratios"]
    needs = [
        f"{100 * ratios[key]:.1f} % of the {'time' if key == 'seconds' else key}"
        for key in ("cells", "updates", "seconds")
        if ratios.get(key) is not None
    ]
    ours = next((row["map"] for row in rows if row["map"] == "adaptive"), rows[0]["map"])
    tail = ["", f"{ours} needs {', '.join(needs)} that fixed needs"] if needs else []
    return "\n".join([*head, *body, *_sizes_table(comparison), *tail])


def _sizes_table(comparison: Mapping[str, Any]) -> list[str]:
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
        for row in (one for one in by_size["sizes"] if one[total]):
            size = "  not mapped" if row["size"] is None else f"  {row['size']:.4g} m"
            label = f"{size:<12}{grouped(row[total]):>8}"
            shares = [_ratio(row[right][name], row[total], percent) for name in names]
            lines.append(line(label, shares))
    return lines


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
        rows = [{"log": self["log"], "scans": self["scans"], **row} for row in self["maps"]]
        return csv_of(rows)

    def __str__(self) -> str:
        """A table with a column for each map."""
        return table_of(self)
