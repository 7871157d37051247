# SPDX-License-Identifier: BSD-3-Clause
"""Plain text, one beam a line: origin, end point, and optionally 0 where nothing was hit."""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np

from ndtree._errors import WrongValue, key
from ndtree._native import _core
from ndtree.base.scan import Scan
from ndtree.logs.core.log import LineLog
from ndtree.logs.core.plain_file import are_numbers
from ndtree.logs.core.source import Format, Source

EXPECTED = "expected 4 or 5 numbers a line in 2-D, 6 or 7 in 3-D"


class TextLog(LineLog):
    """Consecutive lines with the same origin are one scan."""

    format = "text"

    def __init__(self, source: Source, *, dim: int | None = None) -> None:
        line = first_line(source)
        if line is None:
            raise ValueError(f"{source.path}: only comments, {EXPECTED}")
        found = dimension_of(fields_of(line[1]))
        if found is None:
            raise ValueError(f"{source.path}: line {line[0]}: {EXPECTED}, found {line[1].strip()[:40]!r}")
        if dim not in (None, found):
            raise WrongValue(f"{source.path}: the first beam is {found}-D, expected {key('dim')}={found}")
        super().__init__(source.path, found)

    def _scans(self) -> Iterator[Scan]:
        parser = _core.XyzParser2() if self.dim == 2 else _core.XyzParser3()

        def parse(line: str) -> Scan | None:
            record = parser.parse_line(line)
            return None if record is None else Scan(*record)

        yield from self._parsed(parse)
        last = parser.finish()
        if last is not None:
            yield Scan(*last)


def fields_of(line: str) -> list[str]:
    """Fields of one line without its comment; none of a blank one."""
    content = line.lstrip("\ufeff").split("#", 1)[0].strip()
    return re.split(r"\s*[,;]\s*|\s+", content) if content else []


def dimension_of(fields: list[str]) -> int | None:
    """2 or 3 by the number of fields of a beam; None if it fits neither, or if not all are numbers."""
    if not are_numbers(fields):
        return None
    return {4: 2, 5: 2, 6: 3, 7: 3}.get(len(fields))


def first_line(source: Source) -> tuple[int, str] | None:
    """Number and content of the first line of text that is more than a comment; None for binary data, too."""
    if b"\0" in source.head:
        return None
    for number, line in enumerate(source.head.decode("utf-8", "replace").splitlines(), start=1):
        if fields_of(line):
            return number, line
    return None


def first_fields(source: Source) -> list[str]:
    """Fields of that line; none if there is no such line."""
    line = first_line(source)
    return fields_of(line[1]) if line else []


def _recognises(source: Source) -> bool:
    return dimension_of(first_fields(source)) is not None


def looks_like_points(source: Source) -> str | None:
    """What makes the first lines look like points; None if nothing does.

    Beams of a scan share their origin, and points do not share their first coordinates. Where they do, on
    plumb walls and in grids, and in short files, what is behind them may tell.
    """
    lines = [fields_of(line) for line in source.head.decode("utf-8", "replace").splitlines()]
    dim = dimension_of(first_fields(source))
    if dim is None:
        return None
    fields = [found for found in lines if dimension_of(found) == dim]
    rows = np.array([[float(field) for field in found[: 2 * dim]] for found in fields])
    origins, ends = rows[:, :dim], rows[:, dim:]
    changes = int((origins[1:] != origins[:-1]).any(axis=1).sum())
    different = len(np.unique(origins, axis=0))
    is_long = len(rows) >= _MANY_LINES
    most = max(_SENSORS, _MOST_DIFFERENT * len(rows))
    if is_long and changes > _MOST_CHANGES * (len(rows) - 1) and different > most:
        of = f"the first {len(rows)} lines of {len(first_fields(source))} numbers"
        return f"{changes + 1} of {of} begin with another point"
    whole = (rows == np.round(rows)).all(axis=0)
    all_differ = len(rows) >= _FEW_LINES and changes + 1 == different == len(rows)
    last_alone = whole.tolist() == [False, False, False, True]
    if dim == 2 and last_alone and (all_differ or (is_long and different >= _FEW_LINES)):
        return "of the first four columns, only the last has whole numbers"
    if dim == 3 and all_differ:
        if whole[dim:].all() and ends.min() >= 0 and _BRIGHT <= ends.max() <= 255:
            return "columns 4 to 6 have whole numbers from 0 to 255"
        if np.allclose(np.linalg.norm(ends, axis=1), 1.0, atol=1e-2):
            return "columns 4 to 6 are vectors of length 1"
    return None


#: At least _MANY_LINES lines are needed to decide. In a file of beams, at most _MOST_CHANGES of the lines
#: begin at another point than the line before,
_MANY_LINES, _MOST_CHANGES = 10, 0.75
#: or there are at most _MOST_DIFFERENT points per line, as of sensors that take turns, or _SENSORS in all;
#: walls have many points above each other.
_MOST_DIFFERENT, _SENSORS = 0.1, 8
#: At least _FEW_LINES lines are needed where the values behind the coordinates decide. Colours reach _BRIGHT.
_FEW_LINES, _BRIGHT = 3, 64


TEXT = Format("text", "text with one beam a line", _recognises, TextLog, dim=None)
