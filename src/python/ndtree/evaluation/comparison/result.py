# SPDX-License-Identifier: BSD-3-Clause
"""The figures of a comparison, as JSON, CSV and a table."""

from __future__ import annotations

import json
from typing import Any

from ndtree._native._core import OccupancyMap
from ndtree.evaluation.comparison.table import csv_of, table_of


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
