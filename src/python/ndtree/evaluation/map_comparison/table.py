# SPDX-License-Identifier: BSD-3-Clause
"""A comparison of two maps as tables."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ndtree.evaluation.map_comparison.blocks import STATES


def table_of(result: Mapping[str, Any]) -> str:
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
