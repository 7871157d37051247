# SPDX-License-Identifier: BSD-3-Clause
"""Scans of a planar laser's log that are near each other on the way, matched with each other.

A match says how the sensor moved, and so by how much the poses err from scan to scan. Scans are matched with
others of their run and with runs before, once for all who ask.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ndtree._errors import Text, key
from ndtree.alignment.planar import Floats, between, pose_of, turned, wrapped
from ndtree.alignment.sensor_scans import SensorScan, sensor_scan
from ndtree.base.scan import Scan
from ndtree.tuning.revisits import MOST_RANGE, fitted, is_of_one_place, moved_by

#: What is searched within a run and from one run to another [m, m, rad], with cells [m]; larger errors are
#: not found. With coarser cells, errors of good poses look large where a robot turns.
_IN_RUN, _ACROSS = ((0.6, 0.6, 0.2), 0.05), ((1.0, 1.0, 0.35), 0.1)
#: Between two scans of different runs, or of those beside each other in one, least and most way [m] and turn
#: [rad]: nearer ones tell no error, farther ones see others.
_NEAREST, _FARTHEST, _MOST_TURN = 0.03, 6.0, 1.0
#: A step of the pose is a jump if it is this many times a usual one, and the next scan comes no later than
#: this many times the usual time; of logs with this many scans that are looked at.
_USUAL, _FOLLOWS, _LEAST_SCANS = 4.0, 1.5, 8
#: Of scans that are not neighbours: so far that a small error of the setup shows [m, rad].
_BESIDE = (2.5, 0.95)
#: What a radian of turning counts as way [m]: half the distance of usual wheels, times two.
_OF_TURN = 0.5


@dataclass(frozen=True)
class Pair:
    """Two scans, and how the second lies to the first.

    `run`, `other`: Numbers of their runs.
    `is_whole_run`: First and last of one run, at any distance.
    `velocities` (2, 3): Of the sensor at both, in its own frame [m/s, m/s, rad/s]; 0 in a log without times.
    `told` (3,): By the poses: x, y [m] and yaw [rad] as seen from the first.
    `seen` (3,), `covariance` (3, 3): The same by the match, and its covariance; nan where none fits well.
    `shift`: How far the second has to be moved along directions that the surroundings tell [m]; 0 where it
        fits nearly as well as it is, None where nothing tells.
    """

    run: int
    other: int
    is_whole_run: bool
    velocities: Floats
    told: Floats
    seen: Floats
    covariance: Floats
    shift: float | None

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
    """The runs of a log that are each seen from one place, in their sensor's frame, and their pairs."""

    runs: list[list[SensorScan]]
    pairs: list[Pair]


def pairs_of(runs: Sequence[Sequence[Scan]]) -> Pairs:
    """Match scans of a 2-D log with each other.

    `runs`: Consecutive scans in each, as from `ndtree.evaluation.sampling.spread`.
    """
    seen = [[sensor_scan(scan, MOST_RANGE) for scan in run] for run in runs if run and is_of_one_place(run)]
    return matched(seen)


def matched(runs: list[list[SensorScan]]) -> Pairs:
    """Pairs of scans of runs."""
    pairs = []
    for i, run in enumerate(runs):
        last = len(run) - 1
        for k in sorted({1, last} if last else ()):
            pairs.append(
                _pair(run[:1], run[k], (i, i), k == last, (_velocity(run, 0), _velocity(run, k)), _IN_RUN)
            )
        for j in sorted({i + 1, _farthest(runs, i)} - {i, len(runs)}):
            following = runs[j]
            velocities = _velocity(run, 0), _velocity(following, 0)
            pairs.append(_pair(run, following[0], (i, j), False, velocities, _ACROSS))
    return Pairs(runs, [pair for pair in pairs if pair.is_near or pair.is_whole_run])


def _farthest(runs: Sequence[Sequence[SensorScan]], number: int) -> int:
    """The last of the runs behind one up to which the robot goes and turns by at most `_BESIDE`."""
    place = runs[number][0].pose
    way = turn = 0.0
    for j in range(number + 1, len(runs)):
        step = between(place, runs[j][0].pose)
        place, way, turn = runs[j][0].pose, way + float(np.hypot(*step[:2])), turn + abs(float(step[2]))
        if way > _BESIDE[0] or turn > _BESIDE[1]:
            return j - 1
    return len(runs) - 1


def _velocity(run: Sequence[SensorScan], number: int) -> Floats:
    """See `Pair`, from a scan of a run to the next, of the last one from the one before."""
    first, second = (run[k] for k in (max(0, min(number, len(run) - 2)), min(number + 1, len(run) - 1)))
    seconds = second.stamp - first.stamp
    return between(first.pose, second.pose) / seconds if seconds > 0 else np.zeros(3)


def _pair(
    seen: Sequence[SensorScan],
    scan: SensorScan,
    numbers: tuple[int, int],
    is_whole_run: bool,
    velocities: tuple[Floats, Floats],
    search: tuple[tuple[float, float, float], float],
) -> Pair:
    first = seen[0].pose
    told = between(first, scan.pose)
    pair = Pair(
        *numbers, is_whole_run, np.array(velocities), told, np.full(3, np.nan), np.full((3, 3), np.nan), None
    )
    found = fitted(seen, scan, *search) if is_whole_run or pair.is_near else None
    if found is None:
        return pair
    match = found[2]
    covariance = turned(np.asarray(match.covariance, dtype=np.float64), -float(first[2]))
    at = between(first, pose_of(np.asarray(match.pose)))
    return replace(pair, seen=at, covariance=covariance, shift=moved_by(scan, *found))


@dataclass(frozen=True)
class Jump:
    """A pose that jumps while the laser sees the same, from `false_jump`.

    `after`: Time of the scan behind it, from the log's first scan on [s]; nan where scans have no times.
    `length`: [m]
    """

    after: float
    length: float

    def __str__(self) -> str:
        """What was found and what helps, in one line."""
        when = f"{self.after:.1f} s after the first scan" if math.isfinite(self.after) else "at some scan"
        return Text(
            f"poses do not fit the scans: {when} the pose jumps by {self.length:.2f} m while the laser sees "
            f"the same as before; leave out what is before or behind it with {key('start')} or {key('stop')}"
        )


def false_jump(log: Pairs) -> Jump | None:
    """Find a pose that jumps far beyond the usual steps, while the scans fit each other as if it had not.

    Only scans that follow each other are asked: of a long log those within runs.
    """
    scans = [scan for run in log.runs for scan in run]
    if len(scans) < _LEAST_SCANS:
        return None
    poses = np.array([scan.pose for scan in scans])
    stamps = np.array([scan.stamp for scan in scans])
    lengths, times = np.hypot(*np.diff(poses[:, :2], axis=0).T), np.diff(stamps)
    run = np.repeat(np.arange(len(log.runs)), [len(one) for one in log.runs])
    follows = (np.diff(run) == 0) | ((times > 0) & (times <= _FOLLOWS * np.median(times)))
    usual = max(float(np.median(lengths[follows])), _IN_RUN[0][0] / _USUAL)
    for i in np.flatnonzero(follows & (lengths > _USUAL * usual)):
        first, second = scans[i], scans[i + 1]
        found = fitted([first], replace(second, pose=first.pose), *_IN_RUN)
        if found is not None and moved_by(second, *found) not in (None, 0.0):
            after = float(stamps[i + 1] - stamps[0])
            return Jump(after if stamps[-1] > stamps[0] else math.nan, float(lengths[i]))
    return None
