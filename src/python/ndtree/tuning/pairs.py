# SPDX-License-Identifier: BSD-3-Clause
"""Scans of a planar laser's log that are near each other on the way, matched with each other.

A match says how the sensor moved, and so by how much the poses err from scan to scan. Scans are matched with
others of their run and with runs before.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ndtree.alignment.planar import Floats, between, pose_of, wrapped
from ndtree.alignment.sensor_scans import SensorScan, sensor_scan
from ndtree.base.scan import Scan
from ndtree.tuning.revisits import MOST_RANGE, fitted, is_of_one_place

#: What is searched within a run and from one run to another [m, m, rad], with cells [m]; larger errors are
#: not found. With coarser cells, errors of good poses look large where a robot turns.
_IN_RUN, _ACROSS = ((0.6, 0.6, 0.2), 0.05), ((1.0, 1.0, 0.35), 0.1)
#: Between two scans of different runs, or of those beside each other in one, least and most way [m] and turn
#: [rad]: nearer ones tell no error, farther ones see others.
_NEAREST, _FARTHEST, _MOST_TURN = 0.03, 6.0, 1.0
#: What a radian of turning counts as way [m]: half the distance of usual wheels, times two.
_OF_TURN = 0.5


@dataclass(frozen=True)
class Pair:
    """Two scans, and how the second lies to the first.

    `told` (3,): By the poses: x, y [m] and yaw [rad] as seen from the first.
    `seen` (3,): The same by the match; nan where none fits well.
    """

    told: Floats
    seen: Floats

    @property
    def is_matched(self) -> bool:
        """Whether they fit each other well somewhere."""
        return bool(np.isfinite(self.seen[0]))

    @property
    def error(self) -> Floats:
        """(3,) what is seen minus what is told."""
        return np.append(self.seen[:2] - self.told[:2], wrapped(self.seen[2:] - self.told[2:]))

    @property
    def way(self) -> float:
        """Of the sensor by its poses, turns with it [m]."""
        return float(np.hypot(*self.told[:2])) + _OF_TURN * abs(float(self.told[2]))

    @property
    def is_near(self) -> bool:
        """Whether the second is near the first, but not at the same place."""
        return _NEAREST < self.way < _FARTHEST and abs(float(self.told[2])) <= _MOST_TURN


@dataclass(frozen=True)
class Pairs:
    """The runs of a log that are each seen from one place, in their sensor's frame, and their pairs.

    `near`: Within runs, and of neighbouring ones.
    """

    runs: list[list[SensorScan]]
    near: list[Pair]


def pairs_of(runs: Sequence[Sequence[Scan]]) -> Pairs:
    """Match scans of a 2-D log with each other.

    `runs`: Consecutive scans in each, as from `ndtree.evaluation.sampling.spread`.
    """
    seen = [[_seen(scan) for scan in run] for run in runs if run and is_of_one_place(run)]
    return Pairs(seen, _near(seen))


def _seen(scan: Scan) -> SensorScan:
    seen = sensor_scan(scan, MOST_RANGE)
    return replace(seen, pose=np.append(seen.pose[:2], wrapped(seen.pose[2:])))


def _near(runs: list[list[SensorScan]]) -> list[Pair]:
    pairs = []
    for i, run in enumerate(runs):
        last = len(run) - 1
        pairs += [_pair(run[:1], run[k], _IN_RUN) for k in sorted({1, last} if last else ())]
        if i + 1 < len(runs):
            pairs.append(_pair(run, runs[i + 1][0], _ACROSS))
    return [pair for pair in pairs if pair.is_near]


def _pair(
    seen: Sequence[SensorScan], scan: SensorScan, search: tuple[tuple[float, float, float], float]
) -> Pair:
    first = seen[0].pose
    pair = Pair(between(first, scan.pose), np.full(3, np.nan))
    found = fitted(seen, scan, *search) if pair.is_near else None
    return pair if found is None else replace(pair, seen=between(first, pose_of(np.asarray(found[2].pose))))
