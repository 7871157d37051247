# SPDX-License-Identifier: BSD-3-Clause
"""CARMEN logs: laser scans in 2-D with the laser's pose, plain or packed by gzip."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator

from ndtree._errors import WrongValue, key
from ndtree._native import _core
from ndtree.base.scan import Scan
from ndtree.base.words import listed, number_of
from ndtree.logs.core.log import LineLog
from ndtree.logs.core.rules import NO_ECHO, Rules
from ndtree.logs.core.source import Format, Source
from ndtree.logs.formats.text import first_fields

#: Records of the format.
KEYWORDS = frozenset(
    "PARAM SYNC ODOM RAWLASER1 RAWLASER2 RAWLASER3 RAWLASER4 ROBOTLASER1 ROBOTLASER2 FLASER RLASER "
    "LASER3 LASER4 LASER5 REMISSIONFLASER REMISSIONRLASER TRUEPOS GLOBALPOS NMEA-GGA NMEA-RMC "
    "NMEAGGA NMEARMC SONAR BUMPER IMU".split()
)
#: What makes a file one whose first lines are records of unknown names.
_LASER_RECORD = re.compile(
    rb"^(?:FLASER[ \t]+\d+(?:[ \t]+[-+0-9.einfa]+)+|ROBOTLASER1(?:[ \t]+[-+0-9.einfa]+){8,})", re.MULTILINE
)


#: Where the ranges of a record begin; their number stands before them.
_FIRST_RANGE = {"FLASER": 2, "ROBOTLASER1": 9}
#: Lasers beside the one that is read.
_OTHER_LASERS = frozenset("RLASER LASER3 LASER4 LASER5 ROBOTLASER2 REMISSIONRLASER".split())
_NAME = re.compile(r"[A-Za-z_]")
_ZERO = re.compile(r"(?<!\S)-?0+(\.0*)?(?!\S)")
#: As the parser takes it for a beam without return [m]: where records do not say how far their laser sees.
_NO_ECHO_RANGE = "80"


class CarmenLog(LineLog):
    """The FLASER and ROBOTLASER1 records of a CARMEN log.

    `fov`: Angle from the first to the last beam of FLASER records [deg], in (6.28, 360]; of an even number of
        beams, to where one more would be. Left out, it is what PARAM records declare, else that of the laser
        that is known for its number of beams, else 180, with a note.
    """

    format = "carmen"
    may_be_zero = True

    def __init__(self, source: Source, fov: float | None = None, zero_is: str | None = None) -> None:
        super().__init__(source.path, dim=2)
        if fov is not None and not math.tau < fov <= 360.0:  # Below, it is in radians.
            raise WrongValue.of("fov", f"{fov} degrees", "in (6.28, 360], in degrees")
        self._fov = fov
        self.rules = Rules(zero_is=zero_is)

    def _scans(self) -> Iterator[Scan]:
        parser = _core.CarmenParser(field_of_view=None if self._fov is None else math.radians(self._fov))

        others: Counter[str] = Counter()
        hosts: dict[str, None] = {}  # Computers that recorded scans, in their order.

        def parse(line: str) -> Scan | None:
            record = parser.parse_line(_with_no_echo(line) if self.rules.zero_is == NO_ECHO else line)
            if record is None:
                others.update(KEYWORDS.intersection(line.split(maxsplit=1)[:1]))
                return None
            fields = line.split()
            if _NAME.match(fields[-2]):
                hosts[fields[-2]] = None
            if _ZERO.search(line):  # Beams that end at their origin, unless they were replaced.
                self.zeros += sum(map(_is_zero, fields[_ranges_in(fields)]))
            return Scan(*record, heading=_heading_of(fields))

        found = False
        for scan in self._parsed(parse):
            if not found:
                self._say_field_of_view(len(scan), parser.field_of_view)
            found = True
            yield scan
        if not found:
            found_some = ", ".join(others) or "none of the format"
            raise ValueError(f"{self.path}: no FLASER or ROBOTLASER1, expected one; found {found_some}")
        if len(hosts) > 1:
            said = f"scans come from {len(hosts)} computers, {listed(list(hosts))}"
            self._seen.append(f"{said}: of several robots, map the lines of each alone")
        for name in sorted(_OTHER_LASERS & others.keys()):
            self._seen.append(f"{number_of(others[name], f'{name} record')} of another laser are not read")

    def _say_field_of_view(self, beams: int, found: tuple[float, str] | None) -> None:
        """Note what the first record is taken for, where neither the log nor the user said it."""
        if found is None or found[1] in ("option", "param"):
            return
        degrees = round(math.degrees(found[0]), 3)
        if found[1] == "none":
            said = f"field of view of {degrees:g} degrees is assumed: no PARAM says it, and no laser is known"
            self._seen.append(f"{said} for {beams} beams; {key('fov')} sets another")
        elif degrees != 180:
            self._seen.append(f"field of view of {degrees:g} degrees is that of lasers with {beams} beams")


def _recognises(source: Source) -> bool:
    fields = first_fields(source)
    if not fields:
        return False
    return fields[0] in KEYWORDS or _LASER_RECORD.search(source.head) is not None


def _ranges_in(fields: list[str]) -> slice:
    """Where a laser's record has its ranges; nowhere in other records."""
    begin = _FIRST_RANGE.get(fields[0], 0) if fields else 0
    if not begin or len(fields) < begin or not fields[begin - 1].isdigit():
        return slice(0, 0)
    return slice(begin, begin + int(fields[begin - 1]))


def _heading_of(fields: list[str]) -> float:
    """Yaw of the laser [rad] in a record that could be read; its pose stands behind ranges and remissions."""
    end = _ranges_in(fields).stop
    if fields[0] == "ROBOTLASER1":
        end += 1 + int(fields[end])
    return float(fields[end + 2])


def _with_no_echo(line: str) -> str:
    """A laser's record with a range that says "nothing was hit" where it is 0."""
    fields = line.split()
    ranges = _ranges_in(fields)
    if not ranges.stop:
        return line
    stated = fields[5] if fields[0] == "ROBOTLASER1" and not _is_zero(fields[5]) else _NO_ECHO_RANGE
    fields[ranges] = [stated if _is_zero(field) else field for field in fields[ranges]]
    return " ".join(fields)


def _is_zero(field: str) -> bool:
    return _ZERO.fullmatch(field) is not None


CARMEN = Format("carmen", "a CARMEN log", _recognises, CarmenLog, ("zero_is", "fov"), dim=2)
