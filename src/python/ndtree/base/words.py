# SPDX-License-Identifier: BSD-3-Clause
"""Numbers of things and tables for people, and numbers that people type."""

from __future__ import annotations

import math
from collections.abc import Sequence
from decimal import Decimal


def number_of(count: int, thing: str) -> str:
    """As "1 scan" and "2,000 scans"."""
    return f"{count:,} {thing}{'' if count == 1 else 's'}"


def numbers_in(text: str) -> list[float]:
    """Numbers between commas; no number at all if one of them is none."""
    try:
        return [float(field) for field in text.split(",")]
    except ValueError:
        return []


def percent(share: float) -> str:
    """As "41 %", "0.41 %" and "less than 0.01 %"."""
    value = 100 * share
    if 0 < value < 0.01:
        return "less than 0.01 %"
    return f"{value:.0f} %" if value >= 9.95 else f"{value:.2g} %"


def in_full(value: float, digits: int | None = None) -> str:
    """A number without an exponent: rounded to some digits, or exact; or as "inf" and "nan"."""
    if not math.isfinite(value):
        return str(float(value))
    return f"{Decimal(repr(float(value)) if digits is None else f'{value:.{digits}g}'):f}"


def listed(things: Sequence[object]) -> str:
    """As "a", "a and b", and "a, b and c"."""
    *others, last = map(str, things)
    return f"{', '.join(others)} and {last}" if others else last


def aligned(rows: Sequence[Sequence[str]], left: int = 1) -> list[str]:
    """Rows of a table as lines: the first `left` columns begin below each other, the others end so."""
    widths = [max(map(len, column)) for column in zip(*rows)]
    return [
        "  ".join(
            cell.ljust(width) if i < left else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(row, widths))
        ).rstrip()
        for row in rows
    ]
