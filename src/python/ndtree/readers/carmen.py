# SPDX-License-Identifier: BSD-3-Clause
"""CARMEN logs: laser scans in 2-D with the laser's pose, plain or packed by gzip."""

from __future__ import annotations

from collections.abc import Iterator

from ndtree import _core
from ndtree.readers.log import Log, parsed_lines
from ndtree.scan import Scan

#: Records of the format; lines that start otherwise make a file something else.
KEYWORDS = frozenset(
    "PARAM SYNC ODOM RAWLASER1 RAWLASER2 RAWLASER3 RAWLASER4 ROBOTLASER1 ROBOTLASER2 FLASER RLASER "
    "LASER3 LASER4 LASER5 REMISSIONFLASER REMISSIONRLASER TRUEPOS GLOBALPOS NMEA-GGA NMEA-RMC "
    "NMEAGGA NMEARMC SONAR BUMPER IMU".split()
)


class CarmenLog(Log):
    """The FLASER and ROBOTLASER1 records of a CARMEN log."""

    format = "carmen"

    def __init__(self, path: str) -> None:
        super().__init__(path, dim=2)

    def __iter__(self) -> Iterator[Scan]:
        parser = _core.CarmenParser()

        def parse(line: str) -> Scan | None:
            try:
                record = parser.parse_line(line)
            except ValueError as error:
                raise ValueError(f"{self.path}: {error}") from None
            return None if record is None else Scan(*record)

        found = False
        for scan in parsed_lines(str(self.path), parse):
            found = True
            yield scan
        if not found:
            raise ValueError(
                f"{self.path}: no FLASER or ROBOTLASER1 record: expected at least one laser scan"
            )
