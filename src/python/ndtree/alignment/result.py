# SPDX-License-Identifier: BSD-3-Clause
"""What an alignment found: poses, how sure they are, and how to go on."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from ndtree.alignment.planar import Floats, between, composed, in_space, placed, wrapped
from ndtree.alignment.sensor_scans import AlignedLog, SensorScan, Step
from ndtree.alignment.writing import compared, draw_before_and_after, verdict, write_trajectory
from ndtree.base.words import number_of
from ndtree.logs.core.log import Log

_CELL = 0.05  # Of the grid on which walls are counted [m].
_MOST_LOST = (3, 0.01)  # Scans that may have no match, a few or this fraction,
MOST_CONTRADICTED = 0.1  # and of loops that others may contradict.
_MOST_UNFIXED = 1.0  # Way without anything that tells it: of 10 % of it, the error is two cells [m].
_STANDS = 0.5  # Poses within this may be those of a corridor that looks the same everywhere [m].
_SCALES = (0.7, 1.4)  # Of odometry.
_TURN, _LEAST_TURNS = 0.1, 5  # Of a turn between key scans that tells [rad], and how many must.
_MOST_THROUGH = 0.15  # Fraction of a scan's points.
_FAR = 20.0  # End points that are drawn [m].


@dataclass(frozen=True, repr=False)
class FoundPoses:
    """Poses of a log's scans that fit what they saw, in the plane or in space.

    Of its kinds, `poses` and `odometry` have shapes of their own.
    """

    source: Log | None
    poses: Floats
    odometry: Floats
    stamps: Floats
    key_scans: Any
    loops: list[Any]
    tested: int
    contradicted: int
    lost: int
    has_odometry: bool
    against: list[Step]
    unfixed: Floats
    odometry_scale: float
    seconds: float

    @property
    def moved(self) -> Floats:
        """(n,) float64: how far each scan is from where the log has it [m]."""
        result: Floats = np.linalg.norm(self.places - self._told_places, axis=1)
        return result

    @property
    def places(self) -> Floats:
        """(n, dim) float64: where the sensor was [m]."""
        raise NotImplementedError

    @property
    def _told_places(self) -> Floats:
        """(n, dim) float64: where the log has it [m]."""
        raise NotImplementedError

    @property
    def cells(self) -> tuple[int, int]:
        """Cells with end points, by the log's poses and by these: double walls take more."""
        raise NotImplementedError

    #: Cells with walls for what there were before, from which on they are double.
    _most_cells: ClassVar[float] = math.inf
    #: Of the way, that only odometry may tell: of a tenth of that the poses are wrong.
    _unfixed_share: ClassVar[float] = 0.05

    def _broken(self) -> list[str]:
        """What else speaks against the poses."""
        return []

    @property
    def _telling_loops(self) -> Sequence[Any]:
        """Loops that tell how the sensor moved inside."""
        return self.loops

    @property
    def unconfirmed(self) -> list[int]:
        """Scans matched against odometry that fit elsewhere nearly as well, and that no loop confirms."""
        is_in_loop = self._is_in_loop
        return [step.scan for step in self.against if not step.is_sure and not is_in_loop[step.scan]]

    @property
    def _is_in_loop(self) -> Any:
        """(n,) bool: whether a loop goes around the motion to each scan."""
        inside = np.zeros(len(self.poses), bool)
        for loop in self._telling_loops:
            inside[self.key_scans[loop.older] + 1 : self.key_scans[loop.newer] + 1] = True
        return inside

    @cached_property
    def doubts(self) -> list[str]:
        """Why not to trust the poses; empty if no reason to doubt them."""
        doubts = []
        if self.lost > max(_MOST_LOST[0], _MOST_LOST[1] * len(self.poses)):
            doubts.append(f"{number_of(self.lost, 'scan')} matched nothing")
        unfixed = np.where(self._is_in_loop, 0.0, self.unfixed)
        way = float(np.linalg.norm(np.diff(self.places, axis=0), axis=1).sum())
        if unfixed.sum() > max(_MOST_UNFIXED, self._unfixed_share * way):
            first = self.stamps[int(np.argmax(np.cumsum(unfixed) > 0.5 * _MOST_UNFIXED))]
            by = "only odometry says" if self.has_odometry else "nothing says"
            doubts.append(
                f"{by} how far the sensor moved for {unfixed.sum():.1f} m, as along a corridor, "
                f"the first at {first:.1f} s"
            )
        if not self.has_odometry and np.ptp(self.places, axis=0).max() < _STANDS:
            doubts.append("no odometry says that the sensor stood, and it is found to have stood")
        low, high = _SCALES
        if not low < abs(self.odometry_scale) < high:
            doubts.append(f"scans say {self.odometry_scale:.2f} times the distance that odometry says")
        doubts += self._broken()
        unsure = self.unconfirmed
        if unsure:
            steps = number_of(len(unsure), "step")
            doubts.append(
                f"{steps} against odometry could be another, the first at {self.stamps[unsure[0]]:.1f} s"
            )
        if self.contradicted > MOST_CONTRADICTED * max(1, len(self.loops)):
            doubts.append(
                f"{self.contradicted} of {number_of(len(self.loops), 'loop')} contradict the others"
            )
        before, after = self.cells
        if after > self._most_cells * before:
            doubts.append(f"walls take more cells than before ({after} instead of {before})")
        return doubts

    def __str__(self) -> str:
        before, after = self.cells
        moved = self.moved
        loops = f"{len(self.loops)} of {number_of(self.tested, 'possible loop')} closed"
        return (
            f"poses moved by {np.median(moved):.2f} m in the median, {moved.max():.2f} m at most; "
            f"{loops if self.tested else 'no loops found'}; "
            f"end points fill {compared(after, before)} cells; {verdict(self.doubts)}"
        )

    __repr__ = __str__

    def figures(self) -> dict[str, Any]:
        """For a script."""
        before, after = self.cells
        return {
            "scans": len(self.poses),
            "key_scans": len(self.key_scans),
            "moved": {"median": float(np.median(self.moved)), "most": float(self.moved.max())},
            "loops": len(self.loops),
            "tested": self.tested,
            "contradicted": self.contradicted,
            "lost": self.lost,
            "has_odometry": self.has_odometry,
            "against_odometry": [[step.scan, step.is_sure] for step in self.against],
            "unfixed_way": float(self.unfixed.sum()),
            "odometry_scale": self.odometry_scale,
            "cells": {"before": before, "after": after},
            "doubts": self.doubts,
            "seconds": self.seconds,
        }


@dataclass(frozen=True, repr=False)
class Alignment(FoundPoses):
    """Poses of a log's scans that fit what they saw.

    Attributes
    ----------
    source : Log or None
        The log; None of scans that were given one by one.
    poses : (n, 3) float64
        x, y [m] and yaw [rad] of each scan's sensor; the first is the log's.
    odometry : (n, 3) float64
        The same as the log has them. Where it does not say yaw, both are of a frame turned as the log's map.
    stamps : (n,) float64
        Of the scans [s].
    key_scans : (k,) int64
        Scans that the graph is of.
    loops : list of Loop
        Places that were seen again, by numbers of key scans.
    tested : int
        Pairs of places that were looked at.
    contradicted : int
        Loops that others contradict.
    lost : int
        Scans that matched nothing, and are where odometry puts them.
    has_odometry : bool
        Whether the log's poses said how the sensor moved.
    against : list of Step
        Scans that were matched where odometry does not have them.
    unfixed : (n,) float64
        How far each scan moved in directions in which it does not tell where it is [m].
    through : (k,) float64
        Fraction of each key scan's points that lie where the key scans before saw through.
    odometry_scale : float
        How far a step went for what odometry says, in the median; -1 where that counts backwards.
    seconds : float
        What it took.
    """

    through: Floats
    _scans: list[SensorScan] = field(default_factory=list)
    _most_cells: ClassVar[float] = 1.1  # By chance, some more.
    _unfixed_share: ClassVar[float] = 0.0  # In buildings, a metre.

    @property
    def turn_scale(self) -> float:
        """How far a turn went for what odometry says, in the median; 1 where it says of few."""
        told, seen = (wrapped(np.diff(poses[self.key_scans, 2])) for poses in (self.odometry, self.poses))
        tells = np.abs(told) > _TURN
        return float(np.median(seen[tells] / told[tells])) if np.sum(tells) >= _LEAST_TURNS else 1.0

    @property
    def log(self) -> AlignedLog:
        """AlignedLog: the log with these poses, as any other; ValueError if there is none."""
        if self.source is None:
            raise ValueError("the alignment of scans that were given one by one: there is no log")
        return AlignedLog(self.source, self.poses)

    @property
    def places(self) -> Floats:
        return self.poses[:, :2]

    @property
    def _told_places(self) -> Floats:
        return self.odometry[:, :2]

    @cached_property
    def cells(self) -> tuple[int, int]:
        """Cells of 0.05 m with end points, by the log's poses and by these: double walls take more."""
        return _cells_of(self._points(self.odometry)), _cells_of(self._points(self.poses))

    def _broken(self) -> list[str]:
        doubts = []
        low, high = _SCALES
        if self.has_odometry and not low < self.turn_scale < high:
            why = " (beams in the other order, as of a laser upside down?)" if self.turn_scale < 0 else ""
            doubts.append(f"scans say {self.turn_scale:.2f} times the turns that odometry says{why}")
        broken = np.flatnonzero((self.through > _MOST_THROUGH) & ~self._is_in_loop[self.key_scans])
        if len(broken):
            doubts.append(
                f"points of {number_of(len(broken), 'scan')} lie where earlier scans saw free space, "
                f"the first at {self.stamps[self.key_scans[broken[0]]]:.1f} s"
            )
        return doubts

    def figures(self) -> dict[str, Any]:
        """For a script."""
        more = {"seen_through": float(self.through.max()), "turn_scale": self.turn_scale}
        return {**super().figures(), **more}

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the trajectory as TUM's: a time, a place and a quaternion a line.

        Parameters
        ----------
        path : str or path
            It appears whole or not at all.
        """
        write_trajectory(path, self.stamps, *in_space(self.poses))

    def draw(self, path: str | os.PathLike[str]) -> None:
        """Draw what the key scans saw, with the log's poses and with these.

        Parameters
        ----------
        path : str or path
            Its ending says the kind of picture.
        """
        before, after = ((self._points(poses), poses) for poses in (self.odometry, self.poses))
        draw_before_and_after(path, before, after)

    def _points(self, poses: Floats) -> Floats:
        """Near end points of the key scans where some poses put them."""
        placed_points = [
            placed(poses[key], scan.points[np.hypot(scan.points[:, 0], scan.points[:, 1]) < _FAR])
            for key, scan in zip(self.key_scans, self._scans)
        ]
        return np.concatenate(placed_points) if placed_points else np.zeros((0, 2))


def _cells_of(points: Floats) -> int:
    x, y = np.floor(points / _CELL).astype(np.int64).T
    return len(np.unique((x << 32) + y))


def between_keys(poses: Floats, keys: Any, corrected: Floats) -> Floats:
    """Poses of all scans from those of key scans: in between they move as before, and errors are spread."""
    first = np.asarray(keys)
    key = np.searchsorted(first, np.arange(len(poses)), side="right") - 1
    result = composed(corrected[key], between(poses[first][key], poses))
    expected = composed(corrected[:-1], between(poses[first[:-1]], poses[first[1:]]))
    off = np.concatenate((between(expected, corrected[1:]) / np.diff(first)[:, None], np.zeros((1, 3))))
    return composed(result, (np.arange(len(poses)) - first[key])[:, None] * off[key])
