# SPDX-License-Identifier: BSD-3-Clause
"""What of a map a picture shows: where something was found, below the ceiling."""

from __future__ import annotations

import numpy as np

from ndtree.lattice import Cells, Floats, Integers


def found_region(every: Cells) -> tuple[float, ...]:
    """Bounds [m] of what was found: nearly all occupied cells, and some more; few strays are left out."""
    hit = every.where(every.occupied & (every.hits > 0))
    if not len(hit.size):
        hit = every.where(every.occupied)
    if not len(hit.size):
        hit = every.where(every.observed)
    weight = np.maximum(hit.hits, 1).astype(np.float64)
    seen = every.where(every.observed)
    bounds: list[float] = []
    for a in range(every.lower.shape[1]):
        # Half a cell is enough: what was hit is in it, and large cells reach far behind it.
        middle = hit.lower[:, a] + hit.size // 2
        low, high = (quantile(middle, weight, share) for share in (0.002, 0.998))
        margin = 0.03 * (high - low) + 2.0
        bounds.append(max(low - margin, float(seen.lower[:, a].min())) * every.unit)
        bounds.append(min(high + margin, float(seen.upper[:, a].max())) * every.unit)
    return tuple(bounds)


def ceiling(cubes: Cells) -> float | None:
    """Height [m] just below a ceiling: a layer much wider than what is around it, with little above.

    Only small cells are looked at: large ones stand for whole regions behind surfaces.
    """
    small = cubes.where(cubes.size <= 4 * cubes.size.min())
    area = small.size.astype(np.float64) ** 2
    bottom = int(quantile(small.lower[:, 2], area, 0.001))
    layers = int(quantile(small.upper[:, 2], area, 0.999)) - bottom
    if not 4 <= layers <= 1_000_000:
        return None
    begin = np.clip(small.lower[:, 2] - bottom, 0, layers)
    end = np.clip(small.upper[:, 2] - bottom, 0, layers)
    width = np.bincount(begin, area, layers + 1) - np.bincount(end, area, layers + 1)
    lower, upper = np.split(np.cumsum(width)[:layers], [layers // 2])
    peak = int(upper.argmax())
    is_wide = upper[peak] >= 0.25 * lower.max() and upper[peak] >= 2.0 * np.median(upper)
    is_top = upper[peak + 4 :].sum() <= 0.05 * (lower.sum() + upper.sum())
    if not (is_wide and is_top):
        return None
    rise = np.flatnonzero(upper[: peak + 1] < 0.3 * upper[peak])
    first = int(rise[-1]) + 1 if len(rise) else 0
    noise = 2 * int(small.size.min())  # Of the ceiling, below it.
    return float((bottom + max(layers // 2 + first - noise, 1)) * cubes.unit)


def quantile(values: Integers, weights: Floats, share: float) -> float:
    """The value below which so much of the weight is."""
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, share * total[-1])])
