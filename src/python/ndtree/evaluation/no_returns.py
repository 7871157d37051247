# SPDX-License-Identifier: BSD-3-Clause
"""What beams without return say in a log: that space is free, or nothing."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndtree._native import _core
from ndtree.base.scan import Scan
from ndtree.evaluation.sampling import skipping_unmappable, spread
from ndtree.logs.core.log import Log

Floats = NDArray[np.float64]

#: The log decides.
AUTO = "auto"
#: Edge of the cells in which surfaces are noted, by dimension [m], and how far before its own end a beam may
#: touch one, in cells.
CELL, MARGIN = {2: 0.1, 3: 0.2}, 3.0
#: Fewer beams without return tell nothing.
LEAST_BEAMS = 30
#: With a larger share of wrong ones, beams without return say nothing.
MOST_WRONG = 0.2
#: How far inside a cell it is asked which one it is, in cells.
_INSIDE = 1e-3
#: Cells on an axis, around the first scan, that are told apart.
_FARTHEST = 2**20
#: Beams of each kind that are looked at.
MOST_BEAMS = 100_000


@dataclass(frozen=True)
class NoReturns:
    """What beams without return say, from `judge`.

    Parameters
    ----------
    choice : {"free", "ignore"}
    beams : int
        Without return, that tell whether they are right.
    crossing : float
        The share of them that crosses surfaces which other scans found.
    expected : float
        The share that would if they were right: beams that returned, too, cross surfaces, by errors of poses
        and by what moves, so and so often a metre.
    share : float
        Of beams without return among all.
    """

    choice: str
    beams: int
    crossing: float
    expected: float
    share: float

    @property
    def wrong(self) -> float:
        """The least share of them that is wrong, 0 to 1."""
        return max(0.0, (self.crossing - self.expected) / max(1 - self.expected, 1e-9))

    def __str__(self) -> str:
        """What was chosen and why, in one line."""
        if not self.share:
            return "every beam returned"
        begin = f"beams without return ({100 * self.share:.1f} %)"
        if self.beams < LEAST_BEAMS:
            return f"{begin} mean free space: only {self.beams} of them could be checked"
        found = (
            f"{100 * self.crossing:.0f} % of {self.beams} go through walls that other scans saw, "
            f"{100 * self.expected:.0f} % would by pose errors"
        )
        if self.choice == "ignore":
            return f"{begin} are left out: {found}"
        return f"{begin} mean free space: {found}"


def judge(scans: Sequence[Scan]) -> NoReturns:
    """Decide from a sample of a log what its beams without return say.

    Every second scan's returned beams make a map with cells of one size, and the beams of the others are held
    against it. A beam without return that crosses an occupied cell, more than three cells before its end,
    claims free space where others found a surface, if that was there: hit both before the beam and after it.
    Where the first surface on its way came later or had left, a beam is not judged.

    Beams that returned cross surfaces, too, where poses are wrong or things moved: from how often they do a
    metre follows how many of the others would if each of them were right. What is more than that is wrong. If
    at least a fifth of them is, the sensor says "no return" of surfaces as well, as for glass and dark ones,
    and its no-returns say nothing.

    Parameters
    ----------
    scans : sequence of Scan
        In the order of the log.

    Returns
    -------
    NoReturns
        "free" where there is nothing to tell by.
    """
    silent_share = _silent_share(scans)
    if silent_share == 0:
        return NoReturns("free", 0, 0.0, 0.0, 0.0)
    surfaces = _Surfaces(scans[::2])
    stride = max(1, math.ceil(sum(len(scan) for scan in scans[1::2]) / MOST_BEAMS))
    counts = {True: [0, 0, 0.0], False: [0, 0, 0.0]}
    for number, scan in enumerate(scans[1::2]):
        if scan.returned is None:
            returned = np.ones(len(scan), dtype=bool)
        else:
            returned = scan.returned
        origin = np.broadcast_to(scan.origin, scan.endpoints.shape).astype(np.float64)
        way = scan.endpoints - origin
        length = np.linalg.norm(way, axis=1)
        for kind in (True, False):
            use = np.flatnonzero(np.isfinite(length) & (length > 0) & (returned == kind))[::stride]
            if len(use):
                _count(counts[kind], surfaces, number, origin[use], way[use], length[use])
    (beams, crossing, metres), (others, wrong, clear) = counts[False], counts[True]
    if not beams:
        return NoReturns("free", 0, 0.0, 0.0, silent_share)
    rate = wrong / clear if others and clear > 0 else 0.0
    expected = 1 - math.exp(-rate * metres / beams)
    found = NoReturns("free", int(beams), crossing / beams, expected, silent_share)
    if beams >= LEAST_BEAMS and found.wrong >= MOST_WRONG:
        return NoReturns("ignore", int(beams), crossing / beams, expected, silent_share)
    return found


def believed(log: object, scans: Iterable[Scan]) -> str:
    """What "auto" stands for with the scans of a log: what `judge` finds on a sample, "free" or "ignore"."""
    if isinstance(log, Log) and not log.knows_no_returns:
        return "free"
    runs, _, _ = spread(scans)
    return judge([scan for run in runs for scan in run]).choice


class _Surfaces:
    """Cells of one size that some scans hit, each with the first and the last scan that did."""

    def __init__(self, scans: Sequence[Scan]) -> None:
        dim = scans[0].dim
        self.cell = CELL[dim]
        self._map = _core.FixedMap(dim=dim, cell_size=self.cell, range_sigma=self.cell / 4)
        self._start = _first_cell(scans, self.cell)
        keys, numbers = [np.empty(0, np.int64)], [np.empty(0, np.int64)]
        for number, scan in enumerate(scans):
            found = scan.returned_only()
            if len(found):
                with skipping_unmappable():
                    self._map.insert(found.endpoints, found.origin)
                    hit = found.endpoints[np.isfinite(found.endpoints).all(axis=1)]
                    keys.append(np.unique(self._keys(hit)))
                    numbers.append(np.full(len(keys[-1]), number))
        key, number_of = np.concatenate(keys), np.concatenate(numbers)
        self._known, inverse = np.unique(key, return_inverse=True)
        self._first = np.full(len(self._known), len(scans))
        self._last = np.full(len(self._known), -1)
        np.minimum.at(self._first, inverse, number_of)
        np.maximum.at(self._last, inverse, number_of)

    def first_on(self, number: int, origin: Floats, direction: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Distances [m] to the first of them on each ray, inf without one, and whether it was there.

        The scan is taken between those with this number and the next: there is what was hit both before, or
        by the first of these two, and after.
        """
        at = np.asarray(self._map.cast_rays(origin, direction))
        at = np.where(np.isfinite(at), at, np.inf)
        hit = np.flatnonzero(np.isfinite(at))
        there = np.zeros(len(at), dtype=np.bool_)
        inside = at[hit, None] + _INSIDE * self.cell
        there[hit] = self._were_there(number, origin[hit] + inside * direction[hit])
        return at, there

    def _were_there(self, number: int, points: Floats) -> NDArray[np.bool_]:
        if not len(self._known):
            return np.zeros(len(points), dtype=np.bool_)
        key = self._keys(points)
        place = np.minimum(np.searchsorted(self._known, key), len(self._known) - 1)
        there = (self._first[place] <= number) & (self._last[place] > number)
        return (self._known[place] == key) & there

    def _keys(self, points: NDArray[np.floating[Any]]) -> NDArray[np.int64]:
        """One number for each cell near the first scan."""
        cells = np.floor(points.astype(np.float64) / self.cell)
        steps = np.clip(cells - self._start, -_FARTHEST, _FARTHEST - 1)
        key = np.zeros(len(points), dtype=np.int64)
        for column in steps.T:
            key = 2 * _FARTHEST * key + column.astype(np.int64) + _FARTHEST
        return key


def _first_cell(scans: Sequence[Scan], cell: float) -> Floats:
    """The first origin that is finite, in cells, rounded; zero without one."""
    for scan in scans:
        origins = np.atleast_2d(scan.origin).astype(np.float64)
        finite = np.flatnonzero(np.isfinite(origins).all(axis=1))
        if len(finite):
            return np.round(origins[finite[0]] / cell)
    return np.zeros(scans[0].dim)


def _count(
    counts: list[float], surfaces: _Surfaces, number: int, origin: Floats, way: Floats, length: Floats
) -> None:
    """Add beams, those that cross a surface, and the metres that they claim to be free up to it.

    Beams whose first surface had left by then, or came later, or was not looked at again, are left out.
    """
    end = np.maximum(length - MARGIN * surfaces.cell, 0.0)
    first, there = surfaces.first_on(number, origin, way / length[:, None])
    crosses = first < end
    tells = there | ~crosses
    counts[0] += int(np.count_nonzero(tells))
    counts[1] += int(np.count_nonzero(crosses & tells))
    counts[2] += float(np.minimum(first, end)[tells].sum())


def _silent_share(scans: Sequence[Scan]) -> float:
    beams = silent = 0
    for scan in scans:
        beams += len(scan)
        if scan.returned is not None:
            valid = np.isfinite(scan.endpoints).all(axis=1)
            silent += int(np.count_nonzero(valid & ~scan.returned))
    return silent / beams if beams else 0.0
