# SPDX-License-Identifier: BSD-3-Clause
"""Plain text, one beam a line: origin, end point, and optionally 0 where nothing was hit."""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np

from ndtree import _core
from ndtree.readers.log import LineLog
from ndtree.readers.source import Format, Source
from ndtree.scan import Scan

#: Lines that tell points from beams, and how many there must be with and without further evidence.
_LINES_SEEN, _FEW, _MANY = 2000, 3, 10
#: As many sensors may take turns from line to line.
_SENSORS = 8
#: Whole numbers from 0 to 255 are colours if one is at least this.
_BRIGHT = 64

EXPECTED = "expected 4 or 5 numbers a line in 2-D, 6 or 7 in 3-D"


class TextLog(LineLog):
    """Consecutive lines with the same origin are one scan."""

    format = "text"
    marks_no_returns = True

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
    try:
        for field in fields:
            float(field)
    except ValueError:
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
    dim = dimension_of(first_fields(source))
    if dim is None:
        return False
    looks = _as_points(source, dim)
    if looks:
        raise ValueError(
            f"{source.path}: {looks}, as if they were points (x y z and more), which do not say where they "
            f"were measured from; expected beams, the same origin for all of a scan ({EXPECTED}). Beams in "
            "spite of that: format text. Points: a PCD, PLY, LAS or LAZ file with a pose"
        )
    return True


def _as_points(source: Source, dim: int) -> str | None:
    """What makes the first lines look like points with colours, normals and the like; None if nothing does.

    Beams of a scan share an origin, and points do not share their first coordinates.
    """
    lines = source.head.decode("utf-8", "replace").splitlines()[:_LINES_SEEN]
    fields = [found for found in map(fields_of, lines) if dimension_of(found) == dim]
    rows = np.array([[float(field) for field in found[: 2 * dim]] for found in fields])
    origins = rows[:, :dim]
    runs = 1 + int((origins[1:] != origins[:-1]).any(axis=1).sum())
    different = len(np.unique(origins, axis=0))
    if len(rows) >= _MANY and 2 * runs > len(rows) and different > _SENSORS:
        return f"{runs} of the first {len(rows)} lines have another origin than the line before"
    ends = rows[:, dim:]
    whole = (rows == np.round(rows)).all(axis=0)
    if dim == 2 and len(rows) >= _MANY and different >= _FEW and whole.tolist() == [False] * 3 + [True]:
        return "column 4 alone has whole numbers"
    if dim == 3 and len(rows) >= _FEW and runs == different == len(rows):
        if whole[dim:].all() and ends.min() >= 0 and _BRIGHT <= ends.max() <= 255:
            return "columns 4 to 6 look like colours"
        if np.allclose(np.linalg.norm(ends, axis=1), 1.0, atol=1e-2):
            return "columns 4 to 6 look like normals"
    return None


def _open(source: Source, *, dim: int | None = None) -> TextLog:
    line = first_line(source)
    if line is None:
        raise ValueError(f"{source.path}: only comments, {EXPECTED}")
    found = dimension_of(fields_of(line[1]))
    if found is None:
        raise ValueError(f"{source.path}: line {line[0]}: {EXPECTED}, found {line[1].strip()[:40]!r}")
    if dim not in (None, found):
        raise ValueError(f"{source.path}: the first beam is {found}-D, expected dim={found}")
    return TextLog(source.path, found)


TEXT = Format("text", "text with one beam a line", _recognises, _open)
