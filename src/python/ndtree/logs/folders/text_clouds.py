# SPDX-License-Identifier: BSD-3-Clause
"""Points in text, a point a line: XYZ, PTS, ASC, CSV and their relatives.

Strategy: the first lines tell the separator, whether a comma is a decimal point, and the columns of x, y and
z, by a header that names them or else the first three. Then blocks of lines that are all alike are parsed at
once; others by NumPy, which bears blank lines and any numbers; where that fails, too, line by line, which
finds the line at fault.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from ndtree.logs.core.arrays import Floats
from ndtree.logs.core.plain_file import open_plain, separator_of, wrong_line
from ndtree.logs.core.source import Source

#: Endings of files that hold nothing else; others (.csv, .txt) may be points, too, if they look like them.
ENDINGS = (".xyz", ".pts", ".asc", ".xyzi", ".xyzrgb", ".xyzn")
MAYBE = (".csv", ".txt", ".tsv", ".dat")
_COMMENT = (b"#", b"//", b"%")
#: Lines that are looked at for a header, and lines that are parsed at once.
_LOOKED_AT, _BLOCK = 50, 1 << 16
_AXES = (
    ("x", "y", "z"),
    ("east", "north", "up"),
    ("easting", "northing", "elevation"),
    ("easting", "northing", "height"),
    ("easting", "northing", "z"),
    ("x1", "y1", "z1"),  # Ouster's first return.
    ("points:0", "points:1", "points:2"),  # ParaView's.
    ("points_m_xyz:0", "points_m_xyz:1", "points_m_xyz:2"),  # VeloView's.
)
_METRES = {
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), 1.0),
    **dict.fromkeys(("ft", "foot", "feet"), 0.3048),
    **{"km": 1e3, "cm": 1e-2, "mm": 1e-3},
}
#: Behind a name, its unit: in brackets, or as in x_mm.
_UNIT = re.compile(rf"[\[(]\s*(\w+)\s*[\])]|_({'|'.join(_METRES)})$")
#: In the first line that rostopic echo -p prints.
ECHOED = b"field.header"
#: What is between a name and its unit.
_UNIT_APART = re.compile(rb"\s+(?=[\[(])")


#: Quotes around a whole field; others are damage.
_QUOTED = re.compile(rb'(?:^|(?<=[;,\t ]))"([^"\s;,]*)"(?=[;,\t ]|\r?$)', re.MULTILINE)


def _unquoted(field: bytes) -> bytes:
    return field[1:-1] if len(field) > 1 and field[:1] == field[-1:] == b'"' else field


@dataclass(frozen=True)
class Columns:
    """How the lines of a file are to be read."""

    separator: bytes | None  # None for blanks.
    decimal_comma: bool
    xyz: tuple[int, int, int]  # Columns of the coordinates.
    count: int  # Columns of a line.
    named: bool = False  # A header says which columns they are.
    counted: bool = False  # A line with one whole number says how many points follow, as in PTS.
    worded: bool = False  # There are words behind the coordinates.
    metres: float = 1.0  # What a 1 in the file is [m], as a header may say.

    def fields(self, line: bytes) -> list[bytes]:
        """Fields of a line."""
        line = line.strip()
        fields = line.split(self.separator)
        if len(fields) > 1 and not fields[-1].strip() and self.count in (0, len(fields) - 1):
            fields.pop()  # A separator at the end of the line.
        fields = [_unquoted(field.strip()) for field in fields]
        return [field.replace(b",", b".") for field in fields] if self.decimal_comma else fields


@dataclass(frozen=True)
class _Header:
    """Which columns a line names: of how many, in which unit, and whether it is a comment."""

    xyz: tuple[int, int, int]
    count: int
    metres: float
    is_comment: bool

    def fits(self, count: int) -> bool:
        """Whether lines of some columns may be what it names; a comment may name x, y and z in a sentence."""
        return count == self.count if self.is_comment else count >= self.count


def columns_of(lines: Iterable[bytes]) -> Columns | None:
    """How a file is to be read, by its first lines; None if they are not points in text."""
    header: _Header | None = None
    counted, titles = False, 0
    for line in islice(lines, _LOOKED_AT):
        content = line.strip()
        if not content:
            continue
        if header is None and (is_of_degrees(content) or ECHOED in content):
            return None
        comment = next((mark for mark in _COMMENT if content.startswith(mark)), None)
        content = content.removeprefix(comment or b"").strip()
        separator, decimal_comma = separator_of(content)
        known = header.count if header is not None and not header.is_comment else 0
        columns = Columns(separator, decimal_comma, (0, 1, 2), known)
        fields = columns.fields(content)
        values = None if comment else _values(fields)
        if values is not None and len(values) == 1 and values[0] == int(values[0]) >= 0 and not counted:
            counted = True
            continue
        if values is not None:
            columns = replace(columns, count=len(values), counted=counted)
            if header is not None and header.fits(len(values)):
                return replace(columns, xyz=header.xyz, metres=header.metres, named=True)
            if len(values) >= 3 and (header is None or header.is_comment):
                return None if len(values) == titles else columns  # Columns of other names.
            continue  # Columns and rows, as 3DTK has them before the points.
        found = _header(columns.fields(_UNIT_APART.sub(b"", content)), comment is not None)
        if found is not None:
            header = found
        elif comment is None:
            titles = len(fields) if separator is not None else 0  # Else it may be a sentence.
            at = header.xyz if header is not None else (0, 1, 2)
            wanted = [fields[i] for i in at if i < len(fields)]
            if len(wanted) == 3 and len(fields) > 3 and _values(wanted) is not None:  # Words beside numbers.
                columns = replace(columns, xyz=at, count=len(fields), counted=counted)
                if header is None:
                    return replace(columns, worded=True)
                return replace(columns, metres=header.metres, named=True)
            if header is not None or _values(fields[:3]) is not None:
                return None
    return None


def columns_in(source: Source) -> Columns | None:
    """As `columns_of`, of a file's beginning."""
    if b"\0" in source.head:
        return None
    return columns_of(source.head.splitlines())


def text_points(path: str) -> Floats:
    """(n, 3) points of a file of points in text; fields that are empty or nan are not measured.

    Raises ValueError if a line has no coordinates: which, and what was found.
    """
    with open_plain(path) as file:
        columns = columns_of(file)
    if columns is None:
        raise ValueError(f"{path}: expected a point a line, x y z first or as a header names the columns")
    parts = [np.empty((0, 3))]
    with open_plain(path) as file:
        head = list(islice(file, _LOOKED_AT))  # Headers are among the first lines.
        parts.append(_parsed(path, columns, 1, head))
        first = file.line + 1
        while lines := list(islice(file, _BLOCK)):
            parts.append(_parsed(path, columns, first, lines))
            first = file.line + 1
    found = np.concatenate(parts)
    return found if columns.metres == 1.0 else found * columns.metres


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
            raise wrong_line(path, number, content, "x y z of a point")
    return np.array(rows, dtype=np.float64).reshape(-1, 3)


def _quick(columns: Columns, lines: list[bytes]) -> Floats | None:
    """All lines at once; None where they are not all points."""
    delimiter = None if columns.separator is None else columns.separator.decode()
    if columns.decimal_comma:
        lines = [line.replace(b",", b".") for line in lines]
    lines = [_QUOTED.sub(rb"\1", line) if b'"' in line else line for line in lines]
    if not any(line.strip() for line in lines):
        return None
    try:
        found = np.loadtxt(
            lines, delimiter=delimiter, usecols=columns.xyz, comments=None, ndmin=2, dtype=np.float64
        )
    except (ValueError, IndexError):
        return None
    return found if len(found) == len(lines) else None


def _values(fields: Iterable[bytes]) -> list[float] | None:
    """Numbers of fields; None if one is none. An empty one is not measured."""
    try:
        values = [float(field) if field else math.nan for field in fields]
    except ValueError:
        return None
    return values or None


def is_of_degrees(line: bytes) -> bool:
    """Whether a line names columns of latitude and longitude, which are no places in metres."""
    names = set(re.findall(rb"[a-z]+", line.lower()))
    return bool(names & {b"lat", b"latitude"}) and bool(names & {b"lon", b"lng", b"long", b"longitude"})


def _header(fields: list[bytes], is_comment: bool) -> _Header | None:
    """What a line names, if its fields are the names of columns, among them x, y and z."""
    names, units = [], []
    for field in fields:
        text = field.decode("utf-8", "replace")
        text = text.strip(" \"'/#\t").lower()
        unit = _UNIT.search(text)
        units.append((unit[1] or unit[2]) if unit else "")
        name = re.sub(r"[\[(].*$", "", text[: unit.start()] if unit else text).strip()
        names.append(re.sub(r"^(?:pos|position|point|points|coord|cartesian)?[_.: ]?(?=[xyz]$)", "", name))
    for axes in _AXES:
        if all(names.count(axis) == 1 for axis in axes):
            x, y, z = (names.index(axis) for axis in axes)
            return _Header((x, y, z), len(names), _METRES.get(units[x], 1.0), is_comment)
    return None


def ends_as_points(name: str) -> bool:
    """Whether a file's name says that it holds points in text."""
    return os.path.splitext(name)[1].lower() in ENDINGS
