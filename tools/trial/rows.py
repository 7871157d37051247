# SPDX-License-Identifier: BSD-3-Clause
"""Committed tables of figures: JSON in which each row is a line."""

from __future__ import annotations

import json
from typing import Any


def written(table: dict[str, dict[str, Any]]) -> str:
    """The table, of whose parts each member is a line."""
    parts = (
        f"{line(name)}: {{\n" + ",\n".join(f" {line(key)}: {line(row)}" for key, row in rows.items()) + "\n}"
        for name, rows in table.items()
    )
    return "{\n" + ",\n".join(parts) + "\n}\n"


def line(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False)
