# SPDX-License-Identifier: BSD-3-Clause
"""What a picture shows: what was observed, or found below the ceiling; and where the sensor was."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ndtree.base.scan import Scan
from ndtree.cells.lattice import Cells, Floats, Integers

#: Around what is shown, of its longest side.
MARGIN = 0.03
#: Of the observed volume, what may be left out at each end of an axis, where showing it would make the
#: picture this many times as long.
STRAYS, MOST_LONGER = 0.005, 1.5
#: Parts at the ends of an axis that are thinner than this share of the map's width are single beams'.
THIN = 0.05
#: No frame is longer than this many times its width.
MOST_LONG = 4.0

#: Points of a trajectory.
MAX_TRACK = 4096


class Track:
    """Where the sensor was, in a bounded number of points: where there are too many, every second goes."""

    def __init__(self) -> None:
        self.points: list[Floats] = []
        self._step, self._seen = 1, 0

    def add(self, scan: Scan) -> None:
        """The mean origin of a scan's beams."""
        if self._seen % self._step == 0:
            origin = np.asarray(scan.origin, dtype=np.float64)
            self.points.append(origin if origin.ndim == 1 else origin.mean(axis=0))
            if len(self.points) > MAX_TRACK:
                self.points = self.points[::2]
                self._step *= 2
        self._seen += 1

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Floats:
        points = np.zeros((len(self.points), 3))
        if self.points:
            points[:, : len(self.points[0])] = self.points
        return points


def picture_region(every: Cells, track: ArrayLike | None = None) -> tuple[float, ...]:
    """`observed_region` with a margin, and no side shorter than a quarter of the longest."""
    low, high = np.array(observed_region(every, track)).reshape(-1, 2).T
    longest = float(np.max(high - low))
    half = np.maximum(0.5 * (high - low) + MARGIN * longest, 0.5 * (1 + 2 * MARGIN) * longest / MOST_LONG)
    middle = 0.5 * (low + high)
    return tuple(np.stack([middle - half, middle + half], axis=1).ravel().tolist())


def observed_region(every: Cells, track: ArrayLike | None = None) -> tuple[float, ...]:
    """Bounds [m] of what was observed and of where the robot drove.

    What was observed is in it whole. Only where single beams went so far that it would be 1.5 times as long,
    what they alone observed is left out, and the last 0.5 % of the other observed volume at each end, but
    neither what was hit (0.2 % excepted) nor the track.

    `every`: Of which at least one was observed.
    `track` (array_like, (n, dim)): Where the robot drove [m].
    """
    seen = every.where(every.observed)
    if not len(seen.size):
        raise ValueError("nothing was observed that could be drawn")
    volume = seen.size.astype(np.float64) ** every.dim
    low, high = _bounds_of_hits(every)
    for a in range(every.dim):
        begin, end = _bounds_of_wide_parts(seen, a)
        among = (seen.upper[:, a] > begin) & (seen.lower[:, a] < end)
        first, last = np.maximum(seen.lower[among, a], begin), np.minimum(seen.upper[among, a], end)
        low[a] = min(low[a], quantile(first, volume[among], STRAYS))
        high[a] = max(high[a], quantile(last, volume[among], 1 - STRAYS))
        first, last = float(seen.lower[:, a].min()), float(seen.upper[:, a].max())
        if last - first <= MOST_LONGER * (high[a] - low[a]):
            low[a], high[a] = first, last
    low, high = low * every.unit, high * every.unit
    if track is not None:
        points = np.asarray(track, dtype=np.float64).reshape(-1, every.dim)
        points = points[np.isfinite(points).all(axis=1)]
        if len(points):
            low, high = np.minimum(low, points.min(axis=0)), np.maximum(high, points.max(axis=0))
    return tuple(np.stack([low, high], axis=1).ravel().tolist())


def found_region(some: Cells, observed: tuple[Floats, Floats] | None = None) -> tuple[float, ...]:
    """Bounds [m] of what was found: nearly all occupied cells, and some more; few strays are left out.

    `some`: All of a map, or the occupied ones.
    `observed` (lower, upper): Corners of what was observed [m], which bound what is shown: of `some`, if left
        out.
    """
    if observed is None:
        seen = some.where(some.observed)
        observed = seen.lower.min(axis=0) * some.unit, seen.upper.max(axis=0) * some.unit
    if not len(some):
        return tuple(np.stack(observed, axis=1).ravel().tolist())
    low, high = _bounds_of_hits(some)
    margin = max(MARGIN * float(np.max(high - low)), 2.0)
    low = np.maximum((low - margin) * some.unit, observed[0])
    high = np.minimum((high + margin) * some.unit, observed[1])
    return tuple(np.stack([low, high], axis=1).ravel().tolist())


def _bounds_of_hits(every: Cells) -> tuple[Floats, Floats]:
    """In units, where nearly all beams ended; without any, where something was observed."""
    hit = every.where(every.occupied & (every.hits > 0))
    if not len(hit.size):
        hit = every.where(every.occupied)
    if not len(hit.size):
        hit = every.where(every.observed)
    weight = np.maximum(hit.hits, 1).astype(np.float64)
    # Half a cell is enough: what was hit is in it, and large cells reach far behind it.
    middles = (hit.lower + (hit.size // 2)[:, None]).T
    low, high = (np.array([quantile(row, weight, share) for row in middles]) for share in (0.002, 0.998))
    return low, high


def _bounds_of_wide_parts(seen: Cells, axis: int) -> tuple[int, int]:
    """In units, from the first to the last place along an axis where cells are not those of single beams.

    Widths there, edges of squares of the same area in 3-D, are compared with the largest width that the map
    has along at least as long a way: single beams are long or wide, but never both. O(n log n) of n cells.
    """
    area = seen.size.astype(np.float64) ** (seen.dim - 1)
    places, index = np.unique(np.concatenate([seen.lower[:, axis], seen.upper[:, axis]]), return_inverse=True)
    change = np.bincount(index.ravel(), np.concatenate([area, -area]))
    width = np.maximum(np.cumsum(change)[:-1], 0.0) ** (1 / (seen.dim - 1))
    widest = np.argsort(-width, kind="stable")
    reference = np.minimum(width[widest], np.cumsum(np.diff(places)[widest])).max()
    wide = np.flatnonzero(width >= THIN * reference)
    return int(places[wide[0]]), int(places[wide[-1] + 1])


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
