# SPDX-License-Identifier: BSD-3-Clause
"""A bound on what a map calls free although it is occupied, that holds for scans which were not mapped."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from ndtree._errors import WrongValue
from ndtree._native._checked import checked
from ndtree._native._core import OccupancyMap
from ndtree.base.certificate import Certificate
from ndtree.base.scan import Scan
from ndtree.evaluation.sampling import beam_points
from ndtree.tiles import TiledMap


@checked
def certify(
    target: OccupancyMap | TiledMap,
    scans: Iterable[Scan],
    *,
    confidence: float = 0.95,
    max_range: float = math.inf,
) -> Certificate:
    """What `OccupancyMap.certify` says, which describes it; of a folder of tiles, too."""
    if not 0.0 < confidence < 1.0:
        raise ValueError(f"confidence = {confidence}: must be in (0, 1)")
    if not max_range > 0.0:
        raise WrongValue.of("max_range", f"{max_range} m", "> 0")
    counts = [free_and_wrong(target, scan, max_range) for scan in scans]
    called = np.array([free for free, _ in counts if free > 0], dtype=np.int64)
    wrong = np.array([occupied for free, occupied in counts if free > 0], dtype=np.int64)
    shares = wrong / called
    return Certificate(
        at_most=conformal_bound(shares, confidence),
        confidence=confidence,
        scans=len(shares),
        worst=float(shares.max()) if len(shares) else math.nan,
        free=int(called.sum()),
        occupied=int(wrong.sum()),
    )


def free_and_wrong(target: OccupancyMap | TiledMap, scan: Scan, max_range: float) -> tuple[int, int]:
    """Points of a scan that a map calls free, and end points among them."""
    free, ends = beam_points(scan, max_range)
    called, wrong = (
        int(np.count_nonzero(np.asarray(target.state(points)) == 0)) if len(points) else 0
        for points in (free, ends)
    )
    return called + wrong, wrong


def conformal_bound(shares: NDArray[np.float64], confidence: float) -> float:
    """What one more share, exchangeable with these, exceeds with a probability of at most 1 - confidence.

    Returns: One of the shares, or 1, which no share exceeds, where they are too few.
    """
    k = math.ceil(confidence * (len(shares) + 1) - 1e-9)
    return float(np.sort(shares)[k - 1]) if k <= len(shares) else 1.0
