# SPDX-License-Identifier: BSD-3-Clause
"""Points of which nothing says where their sensor was: one place for all, or none."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndtree._errors import WrongValue, key
from ndtree.base.scan import Scan
from ndtree.logs.core.failures import NotALog
from ndtree.logs.core.source import ReaderOption, WrongOption

ORIGIN_OF_SCAN = ReaderOption(
    "origin_of_scan", str, "Of points without poses: X,Y,Z that all were measured from [m]."
)
POINTS_ONLY = ReaderOption(
    "points_only", bool, "Of points without poses: cells that hold one are occupied, none is free."
)


@dataclass(frozen=True)
class Unplaced:
    """What a user said of points without poses.

    `origin` (3,) float64 or None: Where all were measured from [m], in the frame of the points.
    `points_only`: There was no sensor. If not, and without an origin, poses have to be found.
    """

    origin: NDArray[np.float64] | None = None
    points_only: bool = False

    def __bool__(self) -> bool:
        """Whether anything was said, so that no poses are looked for."""
        return self.points_only or self.origin is not None

    @staticmethod
    def of(
        path: str, origin_of_scan: str | Sequence[float] | None, points_only: bool | None, **others: Any
    ) -> Unplaced:
        """From the options of a reader; `others` that are given say the poses in another way.

        Raises WrongOption if more than one way is given; ValueError if the origin is no point.
        """
        ways = {"origin_of_scan": origin_of_scan, "points_only": points_only or None, **others}
        given = [name for name, value in ways.items() if value is not None]
        if len(given) > 1 and ("origin_of_scan" in given or "points_only" in given):
            raise WrongOption(f"{path}: {' and '.join(given)}: expected one of them")
        if origin_of_scan is None:
            return Unplaced(None, bool(points_only))
        return Unplaced(_point(origin_of_scan), False)

    def scan(self, points: NDArray[np.floating[Any]], stamp: float = 0.0) -> Scan:
        """Points in the map frame (n, 3), as a scan."""
        if self.points_only:
            return Scan(points, points, stamp=stamp, points_only=True)
        assert self.origin is not None
        return Scan(points, self.origin, stamp=stamp)


def _point(value: str | Sequence[float]) -> NDArray[np.float64]:
    try:
        fields = value.split(",") if isinstance(value, str) else list(value)
        point = np.array([float(field) for field in fields])
    except (TypeError, ValueError):
        point = np.zeros(0)
    if point.shape != (3,) or not np.isfinite(point).all():
        raise WrongValue(
            f"{key('origin_of_scan')} = {value!r}: expected three numbers with commas between them, X,Y,Z [m]"
        )
    return point


def without_sensor(path: str, what: str, more: Sequence[str] = ()) -> NotALog:
    """The error of points without any pose; `what` they are, as in "a LAS of points without a pose"."""
    ways = [
        f"ndtree map {shlex.quote(path)} --points-only (occupied cells alone)",
        "--origin-of-scan X,Y,Z (all measured from one place)",
        *more,
    ]
    return NotALog(path, what, ways, has_points=True)
