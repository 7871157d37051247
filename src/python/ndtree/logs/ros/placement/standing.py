# SPDX-License-Identifier: BSD-3-Clause
"""Whether the scans of a sensor that is said to stand are those of one that stands."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ndtree._errors import key
from ndtree.logs.ros.messages.beams import Beams
from ndtree.logs.ros.placement.placement import STILL, Placement

#: Scans that are held against each other, at most, and points of each.
MOST_SCANS, MOST_POINTS = 120, 4000
#: Edge of a direction's cell [rad], for sensors that measure in one plane and for others.
PLANAR_STEP, STEP = math.radians(0.5), math.radians(2.0)
#: What is usual in a direction is the farthest but for this share of the scans: people who pass hide it.
HIDDEN = 0.3
#: A point reaches behind it if it is farther by this [m], and this share of the range.
BEHIND, BEHIND_SHARE = 0.1, 0.03
#: It is known if LEAST_SCANS scans saw something there, and LEAST_SHARE of all.
LEAST_SCANS, LEAST_SHARE = 4, 0.25
#: Directions that must be known.
LEAST_DIRECTIONS = 20
#: A scan in which this fraction of the directions reach behind the usual was taken elsewhere,
ELSEWHERE = 0.1
#: and a sensor of whose scans this fraction were taken elsewhere moves.
MOVES = 0.1


class Standing:
    """Scans of one sensor, in its own frame, and whether they were all taken from one place.

    A person who passes a sensor that stands shortens its ranges: hardly anything reaches behind what is
    usually seen in the same direction. Where the sensor itself moves, much does: of 12 sensors that moved
    through buildings, streets and rooms 22 to 100 % of the scans show it, of those that stood none. One that
    moves only for a small part of the log, or hardly, is not noticed.
    """

    def __init__(self, is_planar: bool) -> None:
        self._step = PLANAR_STEP if is_planar else STEP
        self._scans: list[tuple[NDArray[np.int64], NDArray[np.float32], NDArray[np.float32]]] = []
        self._number, self._every = 0, 1

    def add(self, beams: Beams) -> None:
        """Take note of a scan, in the order of the log; of many some are kept, evenly over the log."""
        if self._number % self._every == 0:
            if len(self._scans) == 2 * MOST_SCANS:
                self._scans, self._every = self._scans[::2], 2 * self._every
            if self._number % self._every == 0:
                self._scans.append(_seen(beams, self._step))
        self._number += 1

    def share_elsewhere(self) -> float:
        """The share of the scans that were taken elsewhere than most, 0 to 1; 0 where too little is known."""
        scans = self._scans[:: -(-len(self._scans) // MOST_SCANS) or 1]
        if len(scans) < LEAST_SCANS:
            return 0.0
        directions, counts = np.unique(np.concatenate([which for which, _, _ in scans]), return_counts=True)
        directions = directions[counts >= max(LEAST_SCANS, LEAST_SHARE * len(scans))]
        if len(directions) < LEAST_DIRECTIONS:
            return 0.0
        nearest = np.full((len(scans), len(directions)), np.nan, dtype=np.float32)
        farthest = nearest.copy()
        for row, (which, near, far) in enumerate(scans):
            _, ours, theirs = np.intersect1d(directions, which, assume_unique=True, return_indices=True)
            nearest[row, ours], farthest[row, ours] = near[theirs], far[theirs]
        usual = np.nanquantile(farthest, 1 - HIDDEN, axis=0)
        known = ~np.isnan(nearest)
        behind = known & (nearest > (1 + BEHIND_SHARE) * usual + BEHIND)
        of_each = behind.sum(axis=1) / np.maximum(known.sum(axis=1), 1)
        return float(np.mean(of_each >= ELSEWHERE))

    def warning(self, topic: str, place: Placement) -> str | None:
        """What to say if the sensor moves, though by its poses it stands; else None."""
        share = self.share_elsewhere()
        if share < MOVES:
            return None
        if place.origin == STILL:
            said, ask = "is taken as standing still", f"from {key('trajectory')} FILE"
        else:
            said = f"never moves in {place.fixed_frame} by {place.origin}"
            ask = f"in another {key('fixed_frame')}, or from {key('trajectory')} FILE"
        return (
            f"{topic}: {said}, but its scans show that it moves: {100 * share:.0f} % of them were taken "
            f"elsewhere than the others, and smear the map; it needs its poses, as {ask}"
        )


def _seen(beams: Beams, step: float) -> tuple[NDArray[np.int64], NDArray[np.float32], NDArray[np.float32]]:
    """Directions in which a scan met something, and the nearest and the farthest of it in each [m]."""
    points = np.asarray(beams.points, dtype=np.float64)
    ranges = np.linalg.norm(points, axis=1)
    use = np.isfinite(ranges) & (ranges > 0)
    if beams.returned is not None:
        use &= beams.returned
    which = np.flatnonzero(use)
    which = which[:: -(-len(which) // MOST_POINTS) or 1]
    points, ranges = points[which], ranges[which]
    around = np.floor(np.arctan2(points[:, 1], points[:, 0]) / step).astype(np.int64)
    up = np.floor(np.arcsin(np.clip(points[:, 2] / ranges, -1, 1)) / step).astype(np.int64)
    order = np.lexsort((ranges, up, around))
    keys = (around * 4096 + up)[order]
    first = np.flatnonzero(np.append(True, keys[1:] != keys[:-1])) if len(keys) else np.zeros(0, np.int64)
    last = np.append(first[1:], len(keys))[: len(first)] - 1
    ranges = ranges[order].astype(np.float32)
    return keys[first], ranges[first], ranges[last]
