# SPDX-License-Identifier: BSD-3-Clause
"""CARMEN logs: laser scans in 2-D with the laser's pose, plain or packed by gzip."""

from __future__ import annotations

import re
from collections.abc import Iterator

from ndtree import _core
from ndtree.readers.log import LineLog
from ndtree.readers.source import Format, Source, require_dim
from ndtree.readers.text import first_fields
from ndtree.scan import Scan

#: Records of the format.
KEYWORDS = frozenset(
    "PARAM SYNC ODOM RAWLASER1 RAWLASER2 RAWLASER3 RAWLASER4 ROBOTLASER1 ROBOTLASER2 FLASER RLASER "
    "LASER3 LASER4 LASER5 REMISSIONFLASER REMISSIONRLASER TRUEPOS GLOBALPOS NMEA-GGA NMEA-RMC "
    "NMEAGGA NMEARMC SONAR BUMPER IMU".split()
)
#: What makes a file one whose first lines are records that nobody has heard of.
_LASER_RECORD = re.compile(
    rb"^(?:FLASER[ \t]+\d+(?:[ \t]+[-+0-9.einfa]+)+|ROBOTLASER1(?:[ \t]+[-+0-9.einfa]+){8,})", re.MULTILINE
)


class CarmenLog(LineLog):
    """The FLASER and ROBOTLASER1 records of a CARMEN log."""

    format = "carmen"

    def __init__(self, path: str) -> None:
        super().__init__(path, dim=2)

    def _scans(self) -> Iterator[Scan]:
        parser = _core.CarmenParser()

        def parse(line: str) -> Scan | None:
            record = parser.parse_line(line)
            return None if record is None else Scan(*record)

        found = False
        for scan in self._parsed(parse):
            found = True
            yield scan
        if not found:
            raise ValueError(
                f"{self.path}: no FLASER or ROBOTLASER1 record: expected at least one laser scan"
            )


def _recognises(source: Source) -> bool:
    fields = first_fields(source)
    if not fields:
        return False
    return fields[0] in KEYWORDS or _LASER_RECORD.search(source.head) is not None


def _open(source: Source, *, dim: int | None = None) -> CarmenLog:
    require_dim(source, CARMEN, 2, dim)
    return CarmenLog(source.path)


CARMEN = Format("carmen", "a CARMEN log", _recognises, _open)
