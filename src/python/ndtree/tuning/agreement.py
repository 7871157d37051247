# SPDX-License-Identifier: BSD-3-Clause
"""Whether the poses of a planar laser fit what it saw from one scan to the next.

Strategy: of each run of consecutive scans, the last is laid onto the first by a few steps of point-to-line
matching, held back where the surroundings do not tell (along a corridor). What it has to be moved is the
error of the poses over the run. Good poses err by centimetres and now and then; where wheels slip or poses
jump, the errors are large run after run, and from some run on much larger than before.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ndtree._errors import Text, key
from ndtree.base.scan import Scan

Floats = NDArray[np.float64]

#: An error [m] below which a run agrees, whatever the way, and the share of the way from which it does not:
#: wheels spin. SPIN_RUNS of SPIN_AMONG runs in a row must not agree, or it is by chance.
SPIN_ERROR, SPIN_SHARE, SPIN_RUNS, SPIN_AMONG = 0.03, 0.4, 3, 4
#: Thresholds for wheels that slip a little, or poses that jump about.
SLIP_ERROR, SLIP_SHARE, SLIP_RUNS, SLIP_AMONG = 0.1, 0.04, 5, 6
#: From some run on to the end errors are above WORSE_ERROR [m], and TIMES_WORSE times those before, with
#: WORSE_RUNS runs on either side; WORSE_SHARE of them are above half of that.
WORSE_ERROR, TIMES_WORSE, WORSE_RUNS, WORSE_SHARE = 0.04, 4.0, 8, 0.75
#: Points of the two scans that are compared; more cost time and tell little more.
_POINTS, _SURFACES = 80, 240
#: Largest distance of a point from its surface at the beginning and at the end of matching [m].
_FAR, _NEAR = 0.6, 0.15
_STEPS = 6
#: Of the points, how many must lie on surfaces in the end, or the scans do not show the same.
_SHARE_FOUND = 0.6
#: Holds back motion in directions that fewer points than this share tell of.
_DAMPING = 0.04


@dataclass(frozen=True)
class Disagreement:
    """From when on poses do not fit the scans, from `disagreement`.

    `since`: Time of the first run that disagrees, from the log's first scan on [s]; nan where scans have no
        times.
    """

    since: float
    error: float  # Median of what scans of a run have to be moved [m], over the runs that disagree.
    moved: float  # Median way of the robot over these runs by its poses [m].

    def __str__(self) -> str:
        """What was found and what helps, in one line."""
        when = f"from {self.since:.1f} s on" if math.isfinite(self.since) else "from some scan on"
        return Text(
            f"{when}, consecutive scans disagree by {self.error:.2f} m while the poses move "
            f"{self.moved:.2f} m: wheels slip or poses drift; use {key('align')} or the poses of a SLAM "
            f"system, or stop before it with {key('stop')}"
        )


def disagreement(runs: Sequence[Sequence[Scan]]) -> Disagreement | None:
    """Find from when on the poses of a 2-D log do not fit its scans.

    `runs`: Consecutive scans in each, as from `ndtree.evaluation.sampling.spread`.
    Returns: None where they fit, or nothing can be told.
    """
    found: list[tuple[float, float, float]] = []
    for run in runs:
        measured = _error(run[0], run[-1]) if len(run) > 1 else None
        if measured is not None:
            found.append((run[0].stamp, *measured))
    if not found:
        return None
    errors, moved = np.array(found)[:, 1:].T
    spins = errors > np.maximum(SPIN_ERROR, SPIN_SHARE * moved)
    slips = errors > np.maximum(SLIP_ERROR, SLIP_SHARE * moved)
    begins = [
        _first(spins, SPIN_RUNS, SPIN_AMONG), _first(slips, SLIP_RUNS, SLIP_AMONG), _worse_from(errors)
    ]  # fmt: skip
    known = [begin for begin in begins if begin is not None]
    if not known:
        return None
    begin = min(known)
    wrong = (spins | slips)[begin:]
    if not wrong.any() or begin == begins[2]:
        wrong[:] = True
    has_times = found[-1][0] != found[0][0]
    since = found[begin][0] - runs[0][0].stamp if has_times else math.nan
    return Disagreement(
        since, float(np.median(errors[begin:][wrong])), float(np.median(moved[begin:][wrong]))
    )


def _first(wrong: NDArray[np.bool_], least: int, among: int) -> int | None:
    """The first from which at least that many are wrong."""
    for i in np.flatnonzero(wrong):
        if np.count_nonzero(wrong[i : i + among]) >= least:
            return int(i)
    return None


def _worse_from(errors: Floats) -> int | None:
    """From where on errors are much larger than before, up to the end."""
    best: tuple[int, int] | None = None
    for i in range(WORSE_RUNS, len(errors) - WORSE_RUNS + 1):
        limit = max(WORSE_ERROR, TIMES_WORSE * float(np.median(errors[:i])))
        large = errors > limit / 2
        if large[i] and np.median(errors[i:]) > limit and np.mean(large[i:]) >= WORSE_SHARE:
            on_wrong_side = int(np.count_nonzero(large[:i]) + np.count_nonzero(~large[i:]))
            best = min(best or (on_wrong_side, i), (on_wrong_side, i))
    return None if best is None else best[1]


def _error(first: Scan, last: Scan) -> tuple[float, float] | None:
    """How far the last scan has to be moved to fit the first, and how far the sensor went [m]."""
    if first.dim != 2 or first.origin.ndim != 1 or last.origin.ndim != 1:
        return None
    surfaces, normals = _surfaces(first)
    points = last.returned_only().endpoints.astype(np.float64)
    points = points[np.isfinite(points).all(axis=1)]
    points = points[:: max(1, math.ceil(len(points) / _POINTS))]
    if min(len(surfaces), len(points)) < _POINTS // 4:
        return None
    centre = last.origin.astype(np.float64)
    points, surfaces = points - centre, surfaces - centre
    size = float(np.median(np.linalg.norm(points, axis=1)))
    surface_squares = (surfaces**2).sum(axis=1)
    turn, shift = 0.0, np.zeros(2)
    near = np.zeros(len(points), dtype=np.bool_)
    for step in range(_STEPS):
        far = _FAR * (_NEAR / _FAR) ** (step / (_STEPS - 1))
        c, s = math.cos(turn), math.sin(turn)
        moved = points @ np.array([[c, s], [-s, c]]) + shift
        nearest = (surface_squares - 2 * moved @ surfaces.T).argmin(axis=1)
        near = ((moved - surfaces[nearest]) ** 2).sum(axis=1) < far**2
        if np.count_nonzero(near) < _SHARE_FOUND * len(points):
            return None
        normal = normals[nearest[near]]
        apart = ((surfaces[nearest[near]] - moved[near]) * normal).sum(axis=1)
        lever = (normal[:, 1] * moved[near, 0] - normal[:, 0] * moved[near, 1]) / size
        rows = np.column_stack([normal, lever])
        system = rows.T @ rows + _DAMPING * len(rows) * np.eye(3)
        change = np.linalg.solve(system, rows.T @ apart)
        shift, turn = shift + change[:2], turn + change[2] / size
    way = float(np.linalg.norm(last.origin.astype(np.float64) - first.origin))
    return float(np.linalg.norm(shift)), way


def _surfaces(scan: Scan) -> tuple[Floats, Floats]:
    """End points of beams whose neighbours lie on the same surface, and its normals there."""
    ends = scan.returned_only().endpoints.astype(np.float64)
    ends = ends[np.isfinite(ends).all(axis=1)]
    if len(ends) < 3:
        return np.empty((0, 2)), np.empty((0, 2))
    middle, along = ends[1:-1], ends[2:] - ends[:-2]
    length = np.linalg.norm(along, axis=1)
    bend = np.abs(along[:, 0] * (middle - ends[:-2])[:, 1] - along[:, 1] * (middle - ends[:-2])[:, 0])
    use = np.flatnonzero((length > 1e-6) & (length < 1.0) & (bend < 0.1 * length))
    use = use[:: max(1, math.ceil(len(use) / _SURFACES))]
    return middle[use], np.stack([-along[use, 1], along[use, 0]], axis=1) / length[use, None]
