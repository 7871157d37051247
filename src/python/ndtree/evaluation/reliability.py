# SPDX-License-Identifier: BSD-3-Clause
"""Whether beams end in cells as often as a map says: reliability, and the expected calibration error."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndtree._native import _core
from ndtree._native._core import OccupancyMap
from ndtree.base.scan import Scan

BINS = 20
_STATES = {"free": 0, "occupied": 1}


def reliability_of(
    target: OccupancyMap,
    scans: Sequence[Scan],
    max_range: float,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> dict[str, Any]:
    """How often beams of scans that were held out end where the map says that they would.

    Returns: "beams", "ends_at_unknown"; "all", "free" and "occupied", by what cells are called, "by_size" and
    "by_beams", lists of those whose "size" [m] or "beams_from" is the same, each with "pairs", "ece" and
    "bins": of each twentieth of [0, 1] in which there are pairs, their number, mean "probability" and share
    of "ends".
    """
    counts = _core.Reliability()
    for done, scan in enumerate(scans, start=1):
        counts = target.reliability(
            scan.endpoints, scan.origin, returned=scan.returned, max_range=max_range, counts=counts
        )
        progress(done, len(scans))
    state, size, power = counts.state, counts.size, counts.power
    result: dict[str, Any] = {
        "beams": counts.beams,
        "ends_at_unknown": counts.ends_at_unknown,
        "all": _summary(counts, state >= 0),
    }
    result.update({name: _summary(counts, state == number) for name, number in _STATES.items()})
    result["by_size"] = [
        {"size": float(one), **_summary(counts, (state >= 0) & (size == one))}
        for one in np.unique(size)[::-1]
    ]
    result["by_beams"] = [
        {"beams_from": int(2**one - 1), **_summary(counts, (state >= 0) & (power == one))}
        for one in np.unique(power)
        if one >= 0
    ]
    return result


def _summary(counts: _core.Reliability, which: NDArray[np.bool_]) -> dict[str, Any]:
    pairs = counts.pairs[which].astype(np.float64)
    said = counts.probability[which] * pairs
    ends = counts.ends[which].astype(np.float64)
    number = np.minimum((counts.probability[which] * BINS).astype(np.int64), BINS - 1)
    sums = [np.bincount(number, weights=values, minlength=BINS) for values in (pairs, said, ends)]
    filled = np.flatnonzero(sums[0])
    bins = [
        {
            "pairs": int(sums[0][i]),
            "probability": float(sums[1][i] / sums[0][i]),
            "ends": float(sums[2][i] / sums[0][i]),
        }
        for i in filled
    ]
    return {"pairs": int(pairs.sum()), "ece": expected_calibration_error(bins), "bins": bins}


def expected_calibration_error(bins: Iterable[dict[str, Any]]) -> float | None:
    """Mean distance between the probability and the share of ends, weighted by pairs; None of none."""
    rows = list(bins)
    total = sum(row["pairs"] for row in rows)
    if not total:
        return None
    return math.fsum(row["pairs"] * abs(row["probability"] - row["ends"]) for row in rows) / total
