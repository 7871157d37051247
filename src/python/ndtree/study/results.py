# SPDX-License-Identifier: BSD-3-Clause
"""The results of a study, a row for each job: as CSV, JSON and Markdown."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ndtree.base.files import replaced
from ndtree.base.words import aligned
from ndtree.evaluation.comparison.table import cell_of, csv_of, grouped, percent

#: Columns of the table for people: their head, where they are in a row, and how they are written.
_COLUMNS = (
    ("cells", "cells", grouped),
    ("updates", "updates", grouped),
    ("beams/s", "beams_per_second", grouped),
    ("bytes", "memory_bytes", grouped),
    ("accuracy", "truth.balanced_accuracy", percent),
    ("log score", "truth.log_score", "{:.3f}".format),
    ("free but unseen", "claims.free_unseen", percent),
    ("wrong volume", "claims.wrong_volume", percent),
)


class StudyTable:
    """Rows of a study, in its order. A row of a job that failed has its "error" instead of figures."""

    def __init__(self, file: Path, rows: list[dict[str, Any]]) -> None:
        self.file = file
        self.rows = rows

    @property
    def done(self) -> list[dict[str, Any]]:
        """Rows with figures."""
        return [row for row in self.rows if "error" not in row]

    @property
    def failed(self) -> list[dict[str, Any]]:
        """Rows with errors."""
        return [row for row in self.rows if "error" in row]

    def write(self, folder: Path) -> None:
        """Write ``table.csv``, ``table.json`` and ``table.md``, each whole or not at all."""
        for ending, text in (("csv", self.to_csv()), ("json", self.to_json()), ("md", self.to_markdown())):
            with replaced(folder / f"table.{ending}") as part:
                part.write_text(text, encoding="utf-8")

    def figures(self) -> dict[str, Any]:
        """All of it, ready for JSON."""
        return {"study": str(self.file), "rows": self.rows}

    def to_json(self) -> str:
        """The rows as JSON, indented."""
        return json.dumps(self.figures(), indent=2, allow_nan=False) + "\n"

    def to_csv(self) -> str:
        """A line for each row; nested figures are columns like ``truth_log_score``."""
        return csv_of(self.rows)

    def to_markdown(self) -> str:
        """A table for people, with the figures that say most."""
        head, *lines = self._lines()
        lines = [head, ["---", "---", *["--:"] * len(_COLUMNS)], *lines]
        return "".join(
            f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in one)} |\n" for one in lines
        )

    def __str__(self) -> str:
        """The same, aligned."""
        return "\n".join(aligned(self._lines(), left=2))

    def _lines(self) -> list[list[str]]:
        head = ["log", "map", *(name for name, _, _ in _COLUMNS)]
        return [head, *([row["log"], row["map"], *_cells(row)] for row in self.rows)]


def _cells(row: Mapping[str, Any]) -> list[str]:
    if "error" in row:
        return ["failed", *["-"] * (len(_COLUMNS) - 1)]
    return [cell_of(row, figure, form) or "-" for _, figure, form in _COLUMNS]
