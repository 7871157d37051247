# SPDX-License-Identifier: BSD-3-Clause
"""Plain text, one beam a line: origin, end point, and optionally 0 where nothing was hit."""

from __future__ import annotations

import re
from collections.abc import Iterator

from ndtree import _core
from ndtree.readers.log import Log, parsed_lines
from ndtree.scan import Scan

EXPECTED = "expected 4 or 5 numbers a line in 2-D, 6 or 7 in 3-D"


class TextLog(Log):
    """Consecutive lines with the same origin are one scan."""

    format = "text"

    def __iter__(self) -> Iterator[Scan]:
        parser = _core.XyzParser2() if self.dim == 2 else _core.XyzParser3()

        def parse(line: str) -> Scan | None:
            try:
                record = parser.parse_line(line)
            except ValueError as error:
                raise ValueError(f"{self.path}: {error}") from None
            return None if record is None else Scan(*record)

        yield from parsed_lines(str(self.path), parse)
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
