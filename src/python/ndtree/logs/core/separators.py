# SPDX-License-Identifier: BSD-3-Clause
"""What is between the numbers of a line of text, and whether a comma is a decimal point."""

from __future__ import annotations

import re

_DECIMAL_COMMA = re.compile(rb"[-+]?\d*,\d+(?:[eE][-+]?\d+)?|[-+]?\d+")


def separator_of(line: bytes) -> tuple[bytes | None, bool]:
    """What separates the fields of a line, None for blanks, and whether its commas are decimal points."""
    if b";" in line:
        return b";", b"," in line
    fields = line.split()
    if b"," in line and len(fields) >= 3 and all(_DECIMAL_COMMA.fullmatch(field) for field in fields):
        return None, True
    return (b",", False) if b"," in line else (None, False)


def with_points(line: str) -> str:
    """A line with decimal points where it has decimal commas."""
    if "," in line and separator_of(line.encode())[1]:
        return line.replace(",", ".")
    return line


def are_numbers(fields: list[str]) -> bool:
    """Whether there are fields, and all are numbers."""
    try:
        return bool([float(field) for field in fields])
    except ValueError:
        return False


def floats_of(path: str, number: int, fields: list[str]) -> list[float]:
    """Numbers of a line's fields; ValueError if one is none."""
    if fields and not are_numbers(fields):
        found = " ".join(fields)[:40]
        raise ValueError(f"{path}: line {number}: found {found!r}, expected only numbers")
    return [float(field) for field in fields]
