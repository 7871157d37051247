# SPDX-License-Identifier: BSD-3-Clause
"""How a log is read: rules, decided before it is; and which of its scans, and what of them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ndtree._errors import WrongValue, key
from ndtree.base.scan import Scan
from ndtree.logs.core.arrays import Floats
from ndtree.logs.core.silence import CutOff

NO_ECHO, INVALID = "no-echo", "invalid"
#: Not known where the ranges of a log end: its first loop looks.
UNSEARCHED = CutOff(math.inf, 0.0)


@dataclass(frozen=True)
class Rules:
    """What readers obey; see `Log.ruled`.

    `keep_going`: Pass over what is damaged instead of raising.
    `strict`: Raise for scans whose pose is not known, and for files that end too early, instead of leaving
        out what cannot be used.
    `no_return_range`: Up to where a beam that met nothing is free [m] if the log does not say; None: it says
        nothing then.
    `zero_is` ({"no-echo", "invalid"} or None): What beams with a range of 0 mean: that nothing was hit, or
        nothing at all. None: not stated, and they mean nothing.
    `cut_off`: Where readings are a driver's way to say that nothing was hit.
    `poses_are_found`: Scans say where they were taken: no word of a sensor that moves, though by its poses it
        stands.
    """

    keep_going: bool = False
    strict: bool = False
    no_return_range: float | None = None
    zero_is: str | None = None
    cut_off: CutOff | None = UNSEARCHED
    poses_are_found: bool = False


GIVEN, MEASURED, USUAL = "given", "measured", "usual"


@dataclass(frozen=True)
class Decision:
    """A value of how a log is read or mapped: given by a user, measured on the log, or what is usual; why."""

    value: Any
    source: str = GIVEN
    why: str = ""


@dataclass(frozen=True, eq=False)
class Selection:
    """Which scans of a log of a dimension, and what of them; see `Log.select` for the parameters."""

    dim: int
    every: int = 1
    start: float | None = None
    stop: float | None = None
    min_range: float = 0.0
    stride: int = 1
    box: tuple[ArrayLike, ArrayLike] | None = None
    origin: ArrayLike | None = None

    def __post_init__(self) -> None:
        for name, value in (("every", self.every), ("stride", self.stride)):
            if value != int(value) or value < 1:
                raise WrongValue.of(name, value, "a whole number >= 1")
        if not 0 <= self.min_range < math.inf:
            raise WrongValue.of("min_range", f"{self.min_range:g} m", ">= 0 and finite")
        start, stop = self.times
        if not 0 <= start < stop:
            said = f"{key('start')} = {start:g} s, {key('stop')} = {stop:g} s"
            raise WrongValue(f"{said}: must be 0 <= {key('start')} < {key('stop')}")
        if self.box is not None:
            object.__setattr__(self, "box", _box(self.box, self.dim))
        if self.origin is not None:
            object.__setattr__(self, "origin", _point("origin", self.origin, self.dim))

    @property
    def times(self) -> tuple[float, float]:
        """Of the scans, [start, stop) since the first [s]."""
        start = 0.0 if self.start is None else float(self.start)
        return start, math.inf if self.stop is None else float(self.stop)

    def of(self, scans: Iterable[Scan], name: str) -> Iterator[Scan]:
        """The part of some scans, read as they are asked for; `name` is how errors call their log."""
        one_by_one = OneByOne(self, name)
        for scan in scans:
            part = one_by_one.part(scan)
            if one_by_one.is_over:
                return
            if part is not None:
                yield part

    def cut(self, scan: Scan) -> Scan:
        """What of one scan is used, wherever it stands among the others."""
        if self.origin is not None:
            # In double precision whatever the log has: far-away coordinates lose nothing more than they have.
            ends = scan.endpoints.astype(np.float64) - self.origin
            scan = replace(scan, endpoints=ends, origin=scan.origin.astype(np.float64) - self.origin)
        if self.stride > 1:
            scan = scan.only(slice(None, None, int(self.stride)))
        if self.min_range > 0 and not scan.points_only:
            length = np.linalg.norm(scan.endpoints - scan.origin, axis=1)
            scan = scan.only(~(length < self.min_range))
        return scan if self.box is None else _cropped(scan, *self.box)


class OneByOne:
    """A selection of scans that come one after the other.

    `name`: How errors call their log.
    Attributes:
    `is_over`: Whether no later scan belongs to it.
    """

    def __init__(self, selection: Selection, name: str) -> None:
        self._selection, self._name = selection, name
        self.is_over = False
        self._seen = self._number = 0
        self._first = math.nan

    def part(self, scan: Scan) -> Scan | None:
        """What of the next scan is used; None for nothing."""
        selection = self._selection
        start, stop = selection.times
        if self._seen == 0:
            self._first = scan.stamp
        elif self._seen == 1 and self._first == scan.stamp == 0.0:
            if (selection.start, selection.stop) != (None, None):
                said = f"no {key('start')} nor {key('stop')}"
                raise WrongValue(f"{self._name}: its scans have no times: {said}")
        self._seen += 1
        after = scan.stamp - self._first
        self.is_over = self.is_over or after >= stop
        if self.is_over or not after >= start:
            return None
        self._number += 1
        return selection.cut(scan) if (self._number - 1) % int(selection.every) == 0 else None


def _cropped(scan: Scan, lower: Floats, upper: Floats) -> Scan:
    """The beams that touch a box, cut off where they leave it."""
    start = np.broadcast_to(scan.origin, scan.endpoints.shape).astype(np.float64)
    end = scan.endpoints.astype(np.float64)
    way = end - start
    with np.errstate(divide="ignore", invalid="ignore"):
        at = np.stack([(lower - start) / way, (upper - start) / way])
    # Along an axis on which a beam does not move, it is inside all the way or nowhere.
    still, between = way == 0, (start >= lower) & (start < upper)
    enter = np.where(still, np.where(between, -np.inf, np.inf), at.min(axis=0)).max(axis=1)
    leave = np.where(still, np.where(between, np.inf, -np.inf), at.max(axis=0)).min(axis=1)
    ends_inside = ((end >= lower) & (end < upper)).all(axis=1)
    touches = np.isfinite(way).all(axis=1) & (enter < leave) & (enter < 1) & (leave > 0)
    keep = ends_inside | touches
    cut = keep & ~ends_inside & (leave < 1)
    end[cut] = start[cut] + leave[cut, None] * way[cut]
    cropped = replace(scan, endpoints=end, returned=scan.did_return & ends_inside)
    return cropped.only(keep)


def _box(box: tuple[ArrayLike, ArrayLike], dim: int) -> tuple[Floats, Floats]:
    if len(box) != 2:
        raise WrongValue(f"{key('box')} has {len(box)} corners: must be (lower, upper)")
    lower, upper = (_point("box", corner, dim) for corner in box)
    if not (lower < upper).all():
        raise WrongValue(f"{key('box')} from {lower.tolist()} to {upper.tolist()}: must be lower < upper")
    return lower, upper


def _point(name: str, values: ArrayLike, dim: int) -> Floats:
    point = np.asarray(values, dtype=np.float64)
    if point.shape != (dim,) or not np.isfinite(point).all():
        found = np.asarray(values).tolist()
        raise WrongValue(f"{key(name)} has a point {found}: must be {dim} finite numbers")
    return point
