# SPDX-License-Identifier: BSD-3-Clause
"""What became of measurements that came, and how long that took."""

from __future__ import annotations

from collections import deque
from copy import copy
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from ndtree._native._core import InsertReport
from ndtree.base.words import number_of

#: Delays of the last measurements that are kept.
DELAYS = 4096


@dataclass
class LiveFigures:
    """Counts since the mapper began. Every measurement that came is in one of them, or still waits.

    Attributes
    ----------
    received : int
        Measurements.
    mapped : int
        Of these, in the map.
    dropped : int
        Pushed out of the queue by newer ones.
    left_out : dict of str to int
        Not mapped for another reason, by its name.
    waiting : int
        In the queue.
    poses : int
        Messages with poses, or transforms.
    late_poses : int
        Poses that came after a scan of their time was mapped, or left out: with them it would be another one.
    unsure : int
        Scans that were mapped by a pose a little before their time, because none came for it in time.
    again : int
        Scans that were mapped a second time, as later messages told more of how. Else they count as once.
    beams : dict of str to int
        As the maps count them.
    insert_seconds : float
        Spent in the map.
    corrections, moved, frozen : int
        Of a mapper that follows corrections: how often scans were moved, how many, each time counted, and how
        many move no more because of the limit on memory.
    lost : int
        Of a mapper that finds scans in a map: those that came while it was lost; they count as mapped, too.
    correction_seconds : float
        Spent on that; scans wait meanwhile, and their delays tell it.
    """

    received: int = 0
    mapped: int = 0
    dropped: int = 0
    left_out: dict[str, int] = field(default_factory=dict)
    waiting: int = 0
    poses: int = 0
    late_poses: int = 0
    unsure: int = 0
    again: int = 0
    beams: dict[str, int] = field(default_factory=dict)
    insert_seconds: float = 0.0
    corrections: int = 0
    moved: int = 0
    frozen: int = 0
    lost: int = 0
    correction_seconds: float = 0.0
    mapped_delays: deque[float] = field(default_factory=lambda: deque(maxlen=DELAYS), repr=False)
    published_delays: deque[float] = field(default_factory=lambda: deque(maxlen=DELAYS), repr=False)

    def leave_out(self, kind: str) -> None:
        """Count one that is not mapped."""
        self.left_out[kind] = self.left_out.get(kind, 0) + 1

    def count(self, report: InsertReport, ignored: int) -> None:
        """Count the beams of a scan that was inserted, and those that say nothing."""
        names = ("beams", "returned", "not_returned", "beyond_max_range", "invalid")
        counts = {name: getattr(report, name) for name in names}
        if ignored:
            counts |= {"beams": counts["beams"] + ignored, "ignored": ignored}
        for name, count in counts.items():
            self.beams[name] = self.beams.get(name, 0) + count
        self.insert_seconds += report.seconds

    def begin_again(self) -> None:
        """What was mapped or left out will be mapped again, or left out."""
        self.again += self.mapped
        self.mapped = self.unsure = self.late_poses = self.lost = 0
        self.left_out, self.beams = {}, {}

    @property
    def is_complete(self) -> bool:
        """Whether the map is that of all measurements that came, as if read from a recording of them."""
        return self.dropped == self.late_poses == self.unsure == 0

    def delay(self, quantile: float, *, of: str = "mapped") -> float:
        """From the arrival of a measurement until it is in the map, or ``of="published"`` [s]; nan if none.

        Of the last 4096.
        """
        delays = list(self.mapped_delays if of == "mapped" else self.published_delays)
        return float(np.quantile(delays, quantile)) if delays else float("nan")

    def as_dict(self) -> dict[str, Any]:
        """All of them as plain numbers, ready for JSON."""
        delays = {}
        for name in ("mapped", "published"):
            values = [self.delay(q, of=name) for q in (0.5, 0.99)]
            delays[name] = None if np.isnan(values[0]) else {"median": values[0], "p99": values[1]}
        values = {one.name: copy(getattr(self, one.name)) for one in fields(self) if one.repr}
        of_corrections = {name: values.pop(name) for name in ("moved", "frozen")}
        of_corrections |= {"seconds": values.pop("correction_seconds")}
        return {**values, "corrections": {"applied": self.corrections, **of_corrections}, "delays": delays}

    def summary(self) -> str:
        """In one line, for people."""
        left = "".join(f", {count:,} left out ({kind})" for kind, count in self.left_out.items())
        unsure = f" ({self.unsure:,} with an older pose)" if self.unsure else ""
        more = {
            f"{number_of(self.late_poses, 'pose')} came too late": self.late_poses,
            f"{self.moved:,} moved by {number_of(self.corrections, 'correction')}": self.corrections,
            f"{self.frozen} frozen": self.frozen,
            f"without a place in the map: {self.lost}": self.lost,
            f"{self.again} mapped again": self.again,
        }
        counts = f"{self.mapped:,} mapped{unsure}, {self.dropped:,} dropped{left}"
        said = ", ".join([counts, *(text for text, count in more.items() if count)])
        return f"{number_of(self.received, 'scan')} received: {said}"
