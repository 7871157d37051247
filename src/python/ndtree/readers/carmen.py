# SPDX-License-Identifier: BSD-3-Clause
"""CARMEN logs: laser scans in 2-D with the laser's pose, plain or packed by gzip."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator

from ndtree import _core
from ndtree.readers.log import LineLog
from ndtree.readers.source import Format, ReaderOption, Source, require_dim
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


FOV = ReaderOption("fov", float, "Field of view of FLASER records [deg]; else as PARAM or the beams say.")


class CarmenLog(LineLog):
    """The FLASER and ROBOTLASER1 records of a CARMEN log.

    Parameters
    ----------
    path : str
    fov : float, optional
        Angle from the first to the last beam of FLASER records [deg], in (0, 360]; of an even number of
        beams, to where one more would be. Left out, it is what PARAM records declare, else that of the
        laser that is known for its number of beams, else 180, with a note.
    """

    format = "carmen"

    def __init__(self, path: str, fov: float | None = None) -> None:
        super().__init__(path, dim=2)
        if fov is not None and not 0.0 < fov <= 360.0:
            raise ValueError(f"fov = {fov} degrees: must be in (0, 360]")
        self._fov = fov

    def _scans(self) -> Iterator[Scan]:
        parser = _core.CarmenParser(field_of_view=None if self._fov is None else math.radians(self._fov))

        def parse(line: str) -> Scan | None:
            record = parser.parse_line(line)
            return None if record is None else Scan(*record)

        found = False
        for scan in self._parsed(parse):
            if not found:
                self._say_field_of_view(len(scan), parser.field_of_view)
            found = True
            yield scan
        if not found:
            raise ValueError(
                f"{self.path}: no FLASER or ROBOTLASER1 record: expected at least one laser scan"
            )

    def _say_field_of_view(self, beams: int, found: tuple[float, str] | None) -> None:
        """Note what the first record is taken for, where neither the log nor the user said it."""
        self.notes[:] = [note for note in self.notes if not note.startswith(_NOTE)]
        if found is None or found[1] in ("option", "param"):
            return
        degrees = round(math.degrees(found[0]), 3)
        if found[1] == "none":
            self.notes.append(
                f"{_NOTE} {degrees:g} degrees is assumed: no PARAM says it, and no laser is known for "
                f"{beams} beams; --fov says another"
            )
        elif degrees != 180:
            self.notes.append(f"{_NOTE} {degrees:g} degrees is that of lasers with {beams} beams")


_NOTE = "field of view of"


def _recognises(source: Source) -> bool:
    fields = first_fields(source)
    if not fields:
        return False
    return fields[0] in KEYWORDS or _LASER_RECORD.search(source.head) is not None


def _open(source: Source, *, dim: int | None = None, fov: float | None = None) -> CarmenLog:
    require_dim(source, CARMEN, 2, dim)
    return CarmenLog(source.path, fov)


CARMEN = Format("carmen", "a CARMEN log", _recognises, _open, (FOV,))
