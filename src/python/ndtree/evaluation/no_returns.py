# SPDX-License-Identifier: BSD-3-Clause
"""What beams without return say in a log: that space is free, or nothing."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from ndtree._native import _core
from ndtree._native.results import NoReturns as NoReturns
from ndtree.base.scan import Scan
from ndtree.evaluation.sampling import spread
from ndtree.logs.core.log import Log

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
