# SPDX-License-Identifier: BSD-3-Clause
"""What beams without return say in a log: that space is free, or nothing."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ndtree import _core
from ndtree.readers.log import Log
from ndtree.sampling import skipping_unmappable, spread
from ndtree.scan import Scan

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
#: Beams of each kind that are looked at.
MOST_BEAMS = 100_000


@dataclass(frozen=True)
class NoReturns:
    """What beams without return say, from `judge`.

    Parameters
    ----------
    choice : {"free", "ignore"}
    beams : int
        Without return, that were looked at.
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
        if not self.beams:
            return "every beam returned"
        begin = f"beams without return ({100 * self.share:.1f} %)"
        if self.beams < LEAST_BEAMS:
            return f"{begin} are taken for free space: {self.beams} are too few to tell otherwise"
        found = (
            f"{100 * self.crossing:.0f} % of {self.beams} cross surfaces that others found, "
            f"{100 * self.expected:.0f} % would by errors alone"
        )
        if self.choice == "ignore":
            return f"{begin} say nothing: {found}"
        return f"{begin} are taken for free space: {found}"


def judge(scans: Sequence[Scan]) -> NoReturns:
    """Decide from a sample of a log what its beams without return say.

    Every second scan's returned beams make a map with cells of one size, and the beams of the others are held
    against it. A beam without return that crosses an occupied cell, more than three cells before its end,
    claims free space where others found a surface. Beams that returned do so, too, where poses are wrong or
    things moved: from how often they do a metre follows how many of the others would if each of them were
    right. What is more than that is wrong. If at least a fifth of them is, the sensor says "no return" of
    surfaces as well, as for glass and dark ones, and its no-returns say nothing.

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
    dim = scans[0].dim
    surfaces = _core.FixedMap(dim=dim, cell_size=CELL[dim], range_sigma=CELL[dim] / 4)
    for scan in scans[::2]:
        found = scan.returned_only()
        if len(found):
            with skipping_unmappable():
                surfaces.insert(found.endpoints, found.origin)
    stride = max(1, math.ceil(sum(len(scan) for scan in scans[1::2]) / MOST_BEAMS))
    counts = {True: [0, 0, 0.0], False: [0, 0, 0.0]}
    for scan in scans[1::2]:
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
                _count(counts[kind], surfaces, origin[use], way[use], length[use])
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
    """What "auto" stands for with the scans of a log: "free" or "ignore".

    Of logs from files `judge` decides on a sample. Scans that were simulated, or that a program has made,
    mean what they say.
    """
    is_from_file = isinstance(log, Log) and log.path is not None
    if not (is_from_file and log.knows_no_returns):
        return "free"
    runs, _, _ = spread(scans)
    return judge([scan for run in runs for scan in run]).choice


def _count(
    counts: list[float], surfaces: _core.FixedMap, origin: Floats, way: Floats, length: Floats
) -> None:
    """Add beams, those that cross a surface, and the metres that they claim to be free up to it."""
    margin = MARGIN * CELL[origin.shape[1]]
    first = np.asarray(surfaces.cast_rays(origin, way / length[:, None]))
    crosses = np.isfinite(first) & (first < length - margin)
    claimed = np.where(crosses, first, np.maximum(length - margin, 0.0))
    counts[0] += len(length)
    counts[1] += int(np.count_nonzero(crosses))
    counts[2] += float(claimed.sum())


def _silent_share(scans: Sequence[Scan]) -> float:
    beams = silent = 0
    for scan in scans:
        beams += len(scan)
        if scan.returned is not None:
            valid = np.isfinite(scan.endpoints).all(axis=1)
            silent += int(np.count_nonzero(valid & ~scan.returned))
    return silent / beams if beams else 0.0
