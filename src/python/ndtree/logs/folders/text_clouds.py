# SPDX-License-Identifier: BSD-3-Clause
"""Points in text, a point a line: XYZ, PTS, ASC, CSV and their relatives.

Strategy: the first lines tell the separator, whether a comma is a decimal point, and the columns of x, y and
z, by a header that names them or else the first three. Then whole blocks of lines are parsed at once; where
that gives another number of values than expected, the block is read line by line, which finds the line at
fault.
"""

from __future__ import annotations

import math
import os
import re
import warnings
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from ndtree.logs.core.plain_file import PlainFile, open_plain
from ndtree.logs.core.source import Source

Floats = NDArray[np.float64]

#: Endings of files that hold nothing else; others (.csv, .txt) may be points, too, if they look like them.
ENDINGS = (".xyz", ".pts", ".asc", ".xyzi", ".xyzrgb", ".xyzn")
MAYBE = (".csv", ".txt", ".tsv", ".dat")
_COMMENT = (b"#", b"//", b"%")
#: Lines that are looked at for a header, and lines that are parsed at once.
_LOOKED_AT, _BLOCK = 50, 1 << 16
_DECIMAL_COMMA = re.compile(rb"[-+]?\d*,\d+(?:[eE][-+]?\d+)?|[-+]?\d+")
_AXES = (
    ("x", "y", "z"),
    ("east", "north", "up"),
    ("easting", "northing", "elevation"),
    ("easting", "northing", "height"),
    ("easting", "northing", "z"),
)


@dataclass(frozen=True)
class Columns:
    """How the lines of a file are to be read.

    Attributes
    ----------
    separator : bytes or None
        None for blanks.
    decimal_comma : bool
    xyz : tuple of 3 int
        Columns of the coordinates.
    count : int
        Columns of a line.
    named : bool
        A header says which columns they are.
    counted : bool
        A line with one whole number says how many points follow, as in PTS.
    worded : bool
        There are words behind the coordinates.
    """

    separator: bytes | None
    decimal_comma: bool
    xyz: tuple[int, int, int]
    count: int
    named: bool = False
    counted: bool = False
    worded: bool = False

    def fields(self, line: bytes) -> list[bytes]:
        """Fields of a line."""
        line = line.strip()
        fields = line.split(self.separator)
        if len(fields) > 1 and not fields[-1].strip() and self.count in (0, len(fields) - 1):
            fields.pop()  # A separator at the end of the line.
        return [
            field.strip().replace(b",", b".") if self.decimal_comma else field.strip() for field in fields
        ]


def columns_of(lines: Iterable[bytes]) -> Columns | None:
    """How a file is to be read, by its first lines; None if they are not points in text."""
    named: tuple[int, int, int] | None = None
    counted = False
    for line in islice(lines, _LOOKED_AT):
        content = line.strip()
        if not content:
            continue
        comment = next((mark for mark in _COMMENT if content.startswith(mark)), None)
        separator, decimal_comma = _separator(content.removeprefix(comment or b"").strip())
        columns = Columns(separator, decimal_comma, (0, 1, 2), 0)
        fields = columns.fields(content.removeprefix(comment or b""))
        if comment is None and (values := _values(fields)) is not None:
            if len(values) == 1 and values[0] == int(values[0]) >= 0 and not counted:
                counted = True
                continue
            xyz = named or (0, 1, 2)
            if len(values) <= max(xyz):  # Columns and rows, as 3DTK has them before the points.
                continue
            return Columns(separator, decimal_comma, xyz, len(values), named is not None, counted)
        found = _named(fields)
        if found is not None:
            named = found
        elif comment is None and not named and _values(fields[:3]) is not None:
            if len(fields) > 3:  # Words behind the coordinates.
                return Columns(separator, decimal_comma, (0, 1, 2), len(fields), False, counted, worded=True)
            return None
        elif comment is None and named:  # Words before the coordinates.
            wanted = [fields[i] for i in named if i < len(fields)]
            if len(wanted) == 3 and _values(wanted) is not None:
                return Columns(separator, decimal_comma, named, len(fields), True, counted)
            return None
    return None


def columns_in(source: Source) -> Columns | None:
    """As `columns_of`, of a file's beginning."""
    if b"\0" in source.head:
        return None
    return columns_of(source.head.splitlines())


def text_points(path: str) -> Floats:
    """(n, 3) points of a file of points in text; fields that are empty or nan are not measured.

    Raises
    ------
    ValueError
        If a line has no coordinates: which, and what was found.
    """
    with open_plain(path) as file:
        columns = columns_of(file)
    if columns is None:
        raise ValueError(f"{path}: expected a point a line, x y z first or as a header names the columns")
    parts = [np.empty((0, 3))]
    with open_plain(path) as file:
        for first, block in _blocks(file):
            parts.append(_parsed(path, columns, first, block))
    return np.concatenate(parts)


def _blocks(file: PlainFile) -> Iterator[tuple[int, list[bytes]]]:
    """Lines, many at a time, and the number of the first."""
    lines = iter(file)
    first, size = 1, _LOOKED_AT  # Headers are among the first.
    while block := list(islice(lines, size)):
        yield first, block
        first += len(block)
        size = _BLOCK


def _parsed(path: str, columns: Columns, first: int, lines: list[bytes]) -> Floats:
    quick = _quick(columns, lines)
    if quick is not None:
        return quick
    rows = []
    for number, line in enumerate(lines, start=first):
        content = line.strip()
        if not content or content.startswith(_COMMENT):
            continue
        fields = columns.fields(content)
        values = _values(fields[i] if i < len(fields) else b"?" for i in columns.xyz)
        if values is not None:
            rows.append(values)
        elif not (columns.counted and len(fields) == 1) and not (number <= _LOOKED_AT and not rows):
            found = content[:40].decode("utf-8", "replace")
            raise ValueError(f"{path}: line {number}: found {found!r}, expected x y z of a point")
    return np.array(rows, dtype=np.float64).reshape(-1, 3)


def _quick(columns: Columns, lines: list[bytes]) -> Floats | None:
    """All lines at once; None where they are not all alike."""
    text = b" ".join(lines)
    if columns.decimal_comma:
        text = text.replace(b",", b".")
    if columns.separator:
        text = text.replace(columns.separator, b" ")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            values = np.fromstring(text, dtype=np.float64, sep=" ")  # type: ignore[call-overload]
    except (ValueError, DeprecationWarning):
        return None
    if len(values) != len(lines) * columns.count:
        return None
    if any(len(line.split(columns.separator)) != columns.count for line in lines):
        return None
    return np.ascontiguousarray(values.reshape(-1, columns.count)[:, list(columns.xyz)])


def _separator(line: bytes) -> tuple[bytes | None, bool]:
    """What separates the fields of a line, and whether its commas are decimal points."""
    if b";" in line:
        return b";", b"," in line
    fields = line.split()
    if b"," in line and len(fields) >= 3 and all(_DECIMAL_COMMA.fullmatch(field) for field in fields):
        return None, True
    return (b",", False) if b"," in line else (None, False)


def _values(fields: Iterable[bytes]) -> list[float] | None:
    """Numbers of fields; None if one is none. An empty one is not measured."""
    try:
        values = [float(field) if field else math.nan for field in fields]
    except ValueError:
        return None
    return values or None


def _named(fields: list[bytes]) -> tuple[int, int, int] | None:
    """Columns of x, y and z, where fields are their names."""
    names = []
    for field in fields:
        name = re.sub(r"[\[(].*$", "", field.decode("utf-8", "replace")).strip(" \"'/#\t").lower()
        names.append(re.sub(r"^(?:pos|position|point|points|coord|cartesian)?[_.: ]?(?=[xyz]$)", "", name))
    for axes in _AXES:
        if all(names.count(axis) == 1 for axis in axes):
            x, y, z = (names.index(axis) for axis in axes)
            return x, y, z
    return None


def ends_as_points(name: str) -> bool:
    """Whether a file's name says that it holds points in text."""
    return os.path.splitext(name)[1].lower() in ENDINGS
