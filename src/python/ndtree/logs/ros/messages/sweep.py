# SPDX-License-Identifier: BSD-3-Clause
"""When the beams of a sweep were measured: as messages say, or as the log shows that drivers mean it."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ndtree.logs.core.arrays import Floats, Points
from ndtree.logs.poses.transforms import TransformTree
from ndtree.logs.ros.messages.beams import Beams

#: Points that are moved together, so that what is written between stays in the processor's cache.
BLOCK = 16384
#: Between poses so far apart [s], points are interpolated along lines.
STEP = 0.004
#: A sensor that moves no further than this during a scan [m] has one origin, that of the scan's middle.
ONE_ORIGIN = 0.05


def in_map(
    tree: TransformTree, fixed_frame: str, frame: str, beams: Beams, stamp: float
) -> tuple[Floats, Floats]:
    """End points (n, 3) and origins, (3,) or (n, 3), of beams in the map [m].

    End points always have the pose of their own time. Origins are one for all where the sensor moves less
    than the edge of a small cell, so that maps still know them for one scan.

    Raises ValueError: a `NoPose`, if the pose is not known at one of the times.
    """
    if beams.times is None or not len(beams.times):
        pose = tree.pose_at(fixed_frame, frame, stamp)
        return pose.apply(beams.points), pose.position
    first, last = float(beams.times.min()), float(beams.times.max())
    steps = max(int(np.ceil((last - first) / STEP)), 1)
    rotations, positions = tree.poses_at(fixed_frame, frame, stamp + np.linspace(first, last, steps + 1))
    at = (beams.times - first) * (steps / max(last - first, 1e-12))
    before = np.minimum(at.astype(np.int64), steps - 1)
    share = at - before
    ends = _between(rotations, positions, before, share, beams.points)
    way = np.linalg.norm(positions - positions[len(positions) // 2], axis=1).max()
    if way <= ONE_ORIGIN / 2:
        return ends, positions[len(positions) // 2]
    share = share[:, None]
    return ends, (1 - share) * positions[before] + share * positions[before + 1]


def _between(
    rotations: Floats,
    positions: Floats,
    before: NDArray[np.int64],
    share: Floats,
    points: Points,
) -> Floats:
    """Points (n, 3) moved by the pose before each and by the one after, and interpolated.

    The sums are those of `Pose.apply`, block by block and axis by axis.

    `rotations` (k, 3, 3), `positions` (k, 3): The poses.
    `before`, `share` (n,): Which pose is before a point's time, and of the time to the next, 0 to 1.
    """
    turns, moves = np.ascontiguousarray(np.moveaxis(rotations, 0, -1)), np.ascontiguousarray(positions.T)
    ends = np.empty(points.shape)
    with np.errstate(invalid="ignore", over="ignore"):
        for first in range(0, len(points), BLOCK):
            block = slice(first, first + BLOCK)
            own = np.ascontiguousarray(points[block].T, dtype=np.float64)
            part, i = share[block], before[block]
            for axis in range(3):
                now, later = (
                    turns[axis, 0].take(at) * own[0]
                    + turns[axis, 1].take(at) * own[1]
                    + turns[axis, 2].take(at) * own[2]
                    + moves[axis].take(at)
                    for at in (i, i + 1)
                )
                ends[block, axis] = (1 - part) * now + part * later
    return ends


#: Scans that overlap well, looked at together, and the GROUPS such groups in which the sensor turns most.
GROUP, GROUPS = 8, 12
#: Below this turn within a sweep [rad] it hardly matters when a beam was measured.
LEAST_TURN = 0.005
#: What the log shows must make the picture so much sharper than what the messages say, or they are believed.
LEAST_GAIN = 0.05
#: Beams of a scan that are looked at, their lengths [m], and the cells in which they are counted [m].
MOST_BEAMS, RANGES, CELL = 2000, (0.4, 12.0), 0.05
#: Angles of the grids of cells [rad], and factors that make one number of a cell's three.
GRIDS, KEY = (0.2, 0.6, 1.0, 1.4), (1, 1 << 20, 1 << 40)


@dataclass(frozen=True)
class Sweep:
    """How to read the times of beams."""

    name: str  # For reports.
    is_used: bool = True  # Else all beams count as measured at the stamp.
    is_reversed: bool = False  # The last beam of a message was the first.
    ends_at_stamp: bool = False  # The stamp is the time of the last beam, not of the first.

    def applied(self, beams: Beams) -> Beams:
        """The beams with their times so understood."""
        if beams.times is None or not len(beams.times):
            return beams
        if not self.is_used:
            return replace(beams, times=None)
        times = beams.times
        first, last = float(times.min()), float(times.max())
        if self.is_reversed:
            times = first + last - times
        if self.ends_at_stamp:
            times = times - last
        return beams if times is beams.times else replace(beams, times=times)


AS_SAID = Sweep("each beam at its own time")
OFF = Sweep("all beams at the stamp", is_used=False)
#: What drivers do, beside what messages say.
OTHERS = (
    OFF,
    Sweep("each beam at its own time, the last one at the stamp", ends_at_stamp=True),
    Sweep("each beam at its own time, the last one measured first", is_reversed=True),
    Sweep(
        "each beam at its own time, the last one measured first and the first one at the stamp",
        is_reversed=True,
        ends_at_stamp=True,
    ),
)

#: What a user may say of them.
BY_WORD = dict(zip(("stamp", "end", "reversed", "reversed-end", "said"), (*OTHERS, AS_SAID)))


def turning(tree: TransformTree, fixed_frame: str, frame: str, stamps: Floats, sweep: float) -> list[int]:
    """Numbers of the scans at which the groups begin in which the sensor turns most; none if it hardly does.

    `sweep` is how long one takes [s].
    """
    if len(stamps) < 2 * GROUP or not tree.moving(fixed_frame, frame):
        return []
    first, last = tree.span(fixed_frame, frame)
    at = np.flatnonzero((stamps - sweep >= first) & (stamps + sweep <= last))
    starts = [int(i) for i in at[: -GROUP + 1 or None : GROUP]]
    turns = []
    for start in starts:
        try:
            rotations, _ = tree.poses_at(fixed_frame, frame, stamps[start] + sweep * np.arange(GROUP))
        except ValueError:
            turns.append(0.0)
            continue
        step = np.swapaxes(rotations[:-1], 1, 2) @ rotations[1:]
        cosine = (np.trace(step, axis1=1, axis2=2) - 1) / 2
        turns.append(float(np.median(np.arccos(np.clip(cosine, -1, 1)))))
    order = sorted(range(len(starts)), key=lambda i: -turns[i])
    return sorted(starts[i] for i in order[:GROUPS] if turns[i] >= LEAST_TURN)


#: Scans that follow each other, with their stamps [s].
Group = Sequence[tuple[Beams, float]]
#: Places beams of a stamp in the map, as `in_map`.
Placed = Callable[[Beams, float], tuple[Floats, Floats]]


def sharpest(placed: Placed, groups: Sequence[Group], base: Sweep) -> tuple[Sweep, float]:
    """The understanding of the beams' times under which scans that follow each other agree best.

    Each group's end points are counted in cells; the entropy of the counts says over how many cells they
    spread. The times as the messages say them are believed unless another understanding, one that drivers
    are known for, spreads them over at least 5 % fewer cells.

    `base`: What counts as said.
    Returns Sweep; float: Cells that it needs, as a share of those under what the messages say.
    """
    said = _spread(placed, groups, base)
    best, least = base, said * (1 - LEAST_GAIN)
    for other in (AS_SAID, *OTHERS):
        if other is base:
            continue
        cells = _spread(placed, groups, other)
        if cells < least:
            best, least = other, cells
    return best, least / said if best is not base and said > 0 else 1.0


def _spread(placed: Placed, groups: Sequence[Group], sweep: Sweep) -> float:
    """Over how many cells the end points of a group spread, in the geometric mean."""
    entropies = []
    for group in groups:
        parts = []
        for beams, stamp in group:
            with contextlib.suppress(ValueError):
                parts.append(placed(sweep.applied(thinned(beams)), stamp)[0])
        if parts:
            entropies.append(entropy(np.concatenate(parts)))
    return float(np.exp(np.mean(entropies))) if entropies else 0.0


def thinned(beams: Beams) -> Beams:
    """Some of the beams that returned, neither very short nor very long."""
    length = np.linalg.norm(beams.points, axis=1)
    use = (length >= RANGES[0]) & (length <= RANGES[1])
    if beams.returned is not None:
        use &= beams.returned
    which = np.flatnonzero(use)
    which = which[:: max(1, -(-len(which) // MOST_BEAMS))]
    return Beams(beams.points[which], None, None if beams.times is None else beams.times[which])


def entropy(points: Floats, cell: float = CELL) -> float:
    """Of the numbers of points in cells of some edge [m], in nats: the mean of grids that lie askew.

    In one grid it would matter whether a wall runs along the cells, or between them.
    """
    if not len(points):
        return 0.0
    x, y, z = np.ascontiguousarray(points.T) / cell
    found = []
    for i, angle in enumerate(GRIDS):
        c, s = np.cos(angle), np.sin(angle)
        moved = (c * x - s * y, s * x + c * y, z)
        places = [np.floor(one + i / len(GRIDS)).astype(np.int64) for one in moved]
        _, counts = np.unique(sum(factor * place for factor, place in zip(KEY, places)), return_counts=True)
        share = counts / counts.sum()
        found.append(float(-(share * np.log(share)).sum()))
    return float(np.mean(found))
