# SPDX-License-Identifier: BSD-3-Clause
"""Which points of a log returned from what moved, and scans without them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndtree._native import _core
from ndtree._native._core import OccupancyMap
from ndtree.base.progress import Progress, no_progress
from ndtree.base.scan import Scan
from ndtree.evaluation.pose_noise import PoseNoise
from ndtree.logs import Log
from ndtree.logs.core.joined import Again
from ndtree.logs.core.log import SizedLog

# Scans that find something in a cell: one may be an outlier.
_LEAST_FOUND = 2
_INSIDE = 1e-3  # Of a cell's edge: the box that stands for a point in it.
#: Points moved if that is more probable than not: 0.5 is said where no scan can tell.
THRESHOLD = 0.5


@dataclass
class MovedPoints:
    """What scans of a log say about each other's points, after two passes over its scans.

    `options`: Of a map: its smallest cells and its sensor. Left out options have the map's defaults.
    `no_return` ({"free", "ignore"}): Whether beams without return say that space is free.
    """

    log: Log
    options: dict[str, Any]
    max_range: float  # As for `Scan.insert_into` [m].
    no_return: str

    def __post_init__(self) -> None:
        settings = {**_core.default_options(), **self.options}
        #: Its scans, for each pass.
        self.again = Again(self.log)
        self._margin = settings["min_cell_size"]
        self._sigma = settings["range_sigma"], settings["range_sigma_quadratic"]
        #: Of the log's poses, from look() on.
        self.noise = PoseNoise()
        self._evidence = self._new_evidence()

    def _new_evidence(self) -> _core.MovedEvidence:
        return _core.MovedEvidence(
            dim=self.log.dim,
            cell_size=self._margin,
            range_sigma=self._sigma[0],
            range_sigma_quadratic=self._sigma[1],
            place_sigma=self.noise.place,
            turn_sigma=self.noise.turn,
        )

    def look(self, progress: Progress | None = None) -> MovedPoints:
        """Read the log, and go over its scans twice.

        `progress`: Called as ``progress(what, done, total)`` with numbers of scans.
        Raises ValueError if the log is damaged, or a scan cannot be used; it is named.
        """
        show = no_progress if progress is None else progress
        self.noise = PoseNoise.of(self.again)
        self._evidence = self._new_evidence()
        for what, use in (
            ("collecting points", self._evidence.add),
            ("looking through", self._evidence.look),
        ):
            total = len(self.log) if isinstance(self.log, SizedLog) else 0
            is_noted = not self.again.are_kept
            for number, scan in enumerate(self.again):
                self._give(scan, number, use, is_noted)
                show(what, number + 1, total)
        return self

    def _give(self, scan: Scan, number: int, use: Callable[..., None], is_noted: bool) -> None:
        if self.no_return == "ignore":
            scan = scan.returned_only()
        scan = self._with_sigma(scan)
        try:
            use(
                scan.endpoints,
                scan.origin,
                returned=scan.returned,
                max_range=self.max_range,
                range_sigma=scan.range_sigma,
            )
        except ValueError as error:
            if not is_noted:
                return
            self.log.skip("scans that cannot be used", ValueError(f"{self.log.name}: scan {number}: {error}"))

    def _with_sigma(self, scan: Scan) -> Scan:
        return scan.with_sigma(dict(zip(("range_sigma", "range_sigma_quadratic"), self._sigma)))

    def probability(self, scan: Scan) -> NDArray[np.float32]:
        """That each point of a scan moved; 0.5 for beams that returned from nowhere."""
        answer = np.asarray(self._evidence.probability(scan.endpoints))
        if scan.returned is not None or self.max_range < np.inf:  # Else what did not return is in no cell.
            answer[~scan.hits(self.max_range)] = 0.5
        return answer

    def without(self, scan: Scan) -> Scan:
        """The scan with beams to what moved cut where they surely were in free space, and without end point.

        Of what is at the end point nothing is said then: other beams do.
        """
        moved = np.asarray(self._evidence.probability(scan.endpoints)) > THRESHOLD
        if not moved.any():
            return scan
        origin = np.broadcast_to(scan.origin, scan.endpoints.shape)[moved]
        way = scan.endpoints[moved].astype(np.float64) - origin
        length = np.linalg.norm(way, axis=1)
        # Of the few alone: what did not return did not move, though it may end in a cell of what did.
        did_return = (length > 0) & (length <= self.max_range) & scan.did_return[moved]
        if not did_return.all():
            moved[moved] = did_return
            if not moved.any():
                return scan
            origin, way, length = origin[did_return], way[did_return], length[did_return]
        sigma = self._sigma[0] + self._sigma[1] * length**2
        own = self._with_sigma(scan).range_sigma
        if own is not None:
            sigma = own[moved].astype(np.float64)
        kept = 1 - (self._margin + 2 * (sigma + 0.5 * self.noise.place)) / length
        ends = scan.endpoints.copy()
        ends[moved] = np.where((kept > 0)[:, None], origin + kept[:, None] * way, np.nan)
        return replace(scan, endpoints=ends, returned=scan.did_return & ~moved)

    def keep_standing(self, target: OccupancyMap) -> int:
        """Mark the cells of what stands in a map of the scans without what moved; returns how many.

        A map weighs the beams that end in a cell against those that pass it, and so calls most cells with a
        rod in them free. Where two scans or more found something that did not move, and no cell within one
        edge is occupied, the cell becomes so.
        """
        points = self._evidence.cells()
        found = self._evidence.counts(points)[:, 1] >= _LEAST_FOUND
        points = points[found & (self._evidence.probability(points) <= THRESHOLD)]
        beside = target.nearest_occupied(points, max_distance=self._margin).distance
        lost = points[~(beside <= self._margin)]
        for point in lost:
            target.mark((point - _INSIDE * self._margin, point + _INSIDE * self._margin), "occupied")
        return len(lost)


@dataclass(frozen=True)
class MovedScores:
    """How right a cleaning is, as the field counts it.

    `static_points`, `moving_points`: How many there are.
    """

    static_accuracy: float  # Of points of what stands, the fraction that is kept (SA).
    dynamic_accuracy: float  # Of points of what moves, the fraction that is removed (DA).
    static_points: int
    moving_points: int

    @property
    def associated_accuracy(self) -> float:
        """The geometric mean of both (AA)."""
        return float(np.sqrt(self.static_accuracy * self.dynamic_accuracy))

    @property
    def harmonic_accuracy(self) -> float:
        """The harmonic mean of both (HA)."""
        total = self.static_accuracy + self.dynamic_accuracy
        return 2 * self.static_accuracy * self.dynamic_accuracy / total if total else 0.0

    def figures(self) -> dict[str, float]:
        return {
            "SA": self.static_accuracy,
            "DA": self.dynamic_accuracy,
            "AA": self.associated_accuracy,
            "HA": self.harmonic_accuracy,
            "static_points": self.static_points,
            "moving_points": self.moving_points,
        }

    def __str__(self) -> str:
        one = (self.static_accuracy, self.dynamic_accuracy, self.associated_accuracy, self.harmonic_accuracy)
        return "  ".join(f"{name} {100 * value:5.1f}" for name, value in zip(("SA", "DA", "AA", "HA"), one))


def moved_scores(
    removed: NDArray[np.bool_], truth: NDArray[np.bool_], counts: NDArray[np.bool_] | None = None
) -> MovedScores:
    """Compare which points were removed with which moved.

    `removed`, `truth`: ndarray of bool, (n,).
    `counts` (ndarray of bool, (n,)): Points that are counted; left out: all.
    Raises ValueError if the shapes differ.
    """
    counts = np.ones(len(truth), dtype=bool) if counts is None else counts
    if removed.shape != truth.shape or counts.shape != truth.shape:
        raise ValueError(
            f"removed has shape {removed.shape}, truth {truth.shape}, counts {counts.shape}: must be the same"
        )
    static, moving = counts & ~truth, counts & truth

    def share(which: NDArray[np.bool_], of: NDArray[np.bool_]) -> float:
        return float(np.count_nonzero(which & of) / max(np.count_nonzero(of), 1))

    return MovedScores(
        share(~removed, static),
        share(removed, moving),
        int(np.count_nonzero(static)),
        int(np.count_nonzero(moving)),
    )
