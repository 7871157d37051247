# SPDX-License-Identifier: BSD-3-Clause
"""Plain text, one beam a line: origin, end point, and optionally 0 where nothing was hit."""

from __future__ import annotations

import re
from collections.abc import Iterator

from ndtree import _core
from ndtree.readers.log import LineLog
from ndtree.readers.source import Format, Source
from ndtree.scan import Scan

EXPECTED = "expected 4 or 5 numbers a line in 2-D, 6 or 7 in 3-D"


class TextLog(LineLog):
    """Consecutive lines with the same origin are one scan."""

    format = "text"

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
    if dimension_of(first_fields(source)) is None:
        return False
    _require_beams(source)
    return True


def _require_beams(source: Source) -> None:
    """Refuse points with colours, normals or intensities, of which nearly all lines begin with another point.

    Beams of a scan share their origin. Who has beams with an origin each says so by the format.
    """
    starts = []
    for line in source.head.decode("utf-8", "replace").splitlines():
        fields = fields_of(line)
        dim = dimension_of(fields)
        if dim is not None:
            starts.append(tuple(float(field) for field in fields[:dim]))
    changes = sum(one != other for one, other in zip(starts, starts[1:]))
    few_changes = changes <= _MOST_CHANGES * (len(starts) - 1)
    if len(starts) < _MANY_LINES or few_changes or len(set(starts)) <= _MOST_DIFFERENT * len(starts):
        return
    count = len(first_fields(source))
    raise ValueError(
        f"{source.path}: {changes + 1} of the first {len(starts)} lines of {count} numbers begin with "
        "another point, as points with colours, normals or intensities do, expected beams, those of a scan "
        "with the same origin before their end points. Points are read from a folder of PCD, PLY, LAS or LAZ "
        "files with poses; beams that have an origin each by format text"
    )


#: So many lines are needed to tell. Of beams, such a part begins at another point than the line before, ...
_MANY_LINES, _MOST_CHANGES = 10, 0.75
#: ... or there are only so many points for a line; walls have many points above each other.
_MOST_DIFFERENT = 0.1


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
