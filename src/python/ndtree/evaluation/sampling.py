# SPDX-License-Identifier: BSD-3-Clause
"""A few scans from all over a log, in one pass and without knowing how many there are; and what these say of
beams without return: that space is free, or nothing.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterable, Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ndtree._native import _core
from ndtree._native.results import NoReturns as NoReturns
from ndtree.base.scan import Scan
from ndtree.logs.core.log import Log

#: Scans in a row, so that some of them see the same, and at least RUNS of these runs.
RUN, RUNS = _core.sample_run, _core.sample_runs


def skipping_unmappable() -> contextlib.AbstractContextManager[None]:
    """Around a scan on its way into a map that is only tried: one that no map takes is left out.

    Mapping itself refuses it by name, or passes over it where it is told to keep going.
    """
    return contextlib.suppress(ValueError)


Kept = TypeVar("Kept")


def some_of(scan: Scan) -> Scan:
    """Every second, third, ... beam of a long scan, and none that ends too far away."""
    stride = _core.sample_stride(len(scan))
    if stride > 1:
        scan = scan.only(slice(None, None, stride))
    near = _core.may_be_sampled(scan)
    return scan if near.all() else scan.only(near)


def spread(
    scans: Iterable[Scan],
    progress: Callable[[int], None] | None = None,
    keep: Callable[[Scan], Kept] = some_of,
    sensors: int = 1,
) -> tuple[list[list[Kept]], int, int]:
    """Runs of scans, evenly over a log.

    Of each run the scans follow each other. Where there are twice as many runs as wanted, every second is
    dropped, and from then on half as many are taken: the result depends on nothing but the log. The rule
    stands in ``evaluation/log_sample.hpp``.

    `progress`: Called with the number of scans so far.
    `keep`: Makes what is kept of a scan.
    `sensors`: Of how many the scans are; each has its part of a run.
    Returns runs list of list of that: 40 to 80 runs of four scans of each sensor; fewer only of a short log.
    Of long scans every second, third, ... beam, and none that ends farther than 1e9 m from the map's origin;
    scans, beams int: How many the log has.
    """
    runs: list[list[Kept]] = []
    step = 1
    number = beams = 0
    for scan in scans:
        beams += len(scan)
        run, place = divmod(number, RUN * sensors)
        number += 1
        if progress is not None:
            progress(number)
        if place == 0 and (wider := _core.sample_step(-(-number // sensors))) != step:
            runs, step = runs[:: wider // step], wider
        if run % step:
            continue
        if place == 0:
            runs.append([])
        runs[-1].append(keep(scan))
    return runs, number, beams


SPACING = 0.1
MARGIN = 0.1


def beam_points(scan: Scan, max_range: float = math.inf) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Free space and surfaces along the returned beams of a scan, as `HeldOutTruth` asks about them.

    `max_range`: Longer beams are left out [m].
    Returns free (k, dim) float64: Every 0.1 m along the beams up to 0.1 m before their ends [m]; ends (n,
    dim) float64: Their end points [m].
    """
    start, way, far = scan.returned_beams(max_range)
    count = np.floor(np.maximum(far - MARGIN, 0.0) / SPACING * (1 + 1e-12)).astype(np.int64)
    beam = np.repeat(np.arange(len(far)), count)
    number = np.arange(len(beam)) - np.repeat(np.cumsum(count) - count, count) + 1
    free = start[beam] + (SPACING * number)[:, None] * way[beam]
    return free, start + far[:, None] * way


#: The log decides.
AUTO = "auto"


def judge(scans: Sequence[Scan]) -> NoReturns:
    """Decide from a sample of a log what its beams without return say.

    Every second scan's returned beams make a map with cells of one size, and the beams of the others are held
    against it: a beam without return is wrong where it crosses a surface that was hit both before it and
    after it. Where it is not sure that fewer than a fifth are, the sensor may say "no return" of surfaces as
    well, as for glass and dark ones, and its no-returns say nothing: nor where more than 2 % of the pieces of
    surface sent fewer beams back than none. The rule stands in ``evaluation/no_returns.hpp``.

    `scans`: In the order of the log, as from `spread`.
    Returns: "ignore" where too little tells.
    """
    return _core.judge_no_returns(scans)


def believed(log: object, scans: Iterable[Scan]) -> str:
    """What "auto" stands for with the scans of a log: what `judge` finds on a sample, "free" or "ignore"."""
    if isinstance(log, Log) and not log.knows_no_returns:
        return "free"
    runs, _, _ = spread(scans)
    return judge([scan for run in runs for scan in run]).choice
