# SPDX-License-Identifier: BSD-3-Clause
"""What a comparison found, as numbers and as a table."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from ndtree._native._core import OccupancyMap
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


def table_of(comparison: Mapping[str, Any]) -> str:
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

    def calibrated(of: str) -> Callable[[dict[str, Any]], str | None]:
        return lambda row: _error(row["calibration"][of]["ece"]) if row.get("calibration") else None

    def certified(row: dict[str, Any]) -> str | None:
        return _percent(row["certificate"]["at_most"], 1) if row.get("certificate") else None

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
    line("  of hits", lambda row: _nats((row["truth"] or {}).get("hit_log_score")))
    line("ray casts within 0.1 m", truth("casts_within", "casts"))
    line("  median error", lambda row: _centimetres((row["truth"] or {}).get("median_error")))
    line("  at the surface", truth("surfaces_within", "casts"))
    line("  median error", lambda row: _centimetres((row["truth"] or {}).get("surface_error")))
    line("free but unseen", claimed("free_unseen"))
    line("seen but unknown", claimed("seen_unknown"))
    line("wrong volume", claimed("wrong_volume"))
    line("calibration error", calibrated("all"))
    line("  in cells called free", calibrated("free"))
    line("  called occupied", calibrated("occupied"))
    line("free is occupied, at most", certified)
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


def _error(value: float | None) -> str | None:
    return None if value is None else f"{value:.4f}"


def _nats(value: float | None) -> str | None:
    return None if value is None else f"{value:.3f}"


def _centimetres(value: float | None) -> str | None:
    return None if value is None else f"{100 * value:.2f} cm"


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
