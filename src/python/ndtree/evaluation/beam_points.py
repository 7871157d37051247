# SPDX-License-Identifier: BSD-3-Clause
"""Points whose state held-out beams measure."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ndtree.base.scan import Scan

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
