# SPDX-License-Identifier: BSD-3-Clause
"""Noise of the ranges, from how far points are from flat surfaces."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ndtree.base.progress import Progress
from ndtree.tuning.calibration.beams import Points
from ndtree.tuning.calibration.figures import CONFIDENCE, LEAST_SIGMA, RESAMPLES, Estimate, Floats, estimated
from ndtree.tuning.calibration.flatness import TINY, Grid, flat_pieces

RADII = (0.25, 0.5, 1.0)  # Of a piece of surface [m]; the next one where points are few, or noise is thick.
PIECES = 1200  # Tried.
CHUNK = 256  # Pieces at once.
LEAST_PIECES = 8  # Below which there is no estimate, ...
LEAST_RESIDUALS = 30  # ... and residuals, below which a bin of ranges, or a place, says nothing.
PLACE = 2.0  # Edge of a place, in which pieces overlap [m], ...
LEAST_PLACES = 3  # ... of which noise needs some, and its growth some that are far: few may be no surfaces.
RANGE_BINS = 12
STEEPEST = 0.01  # Growth [1/m], of a stereo camera of 4 cm and 600 pixels: beyond it are bodies.
WIDE = 2.0  # Far ranges over the smallest with an estimate.
LARGEST_MISFIT = 2.0  # Ratio of bins and fit, in the median: beyond it, pieces were not of surfaces.


@dataclass(frozen=True)
class Noise:
    sigma: Estimate
    quadratic: Estimate
    pieces: int
    bins: tuple[tuple[float, float, int], ...]


@dataclass(frozen=True)
class _Residuals:
    """Distances from flat pieces of surface along the beams [m], all positive."""

    value: Floats
    length: Floats
    piece: NDArray[np.int64]
    middle: Floats  # Of each piece.


def noise_of(
    points: Points, max_range: float, generator: np.random.Generator, progress: Progress
) -> Noise | None:
    pieces = _Pieces(points, max_range, generator, progress)
    noise = _fitted_noise(pieces.residuals(None), generator)
    if noise is None or noise.quadratic.value == 0:
        return noise
    # Near points are better than far ones in the same piece: once more, and each counts as it deserves.
    return _fitted_noise(pieces.residuals((noise.sigma.value, noise.quadratic.value)), generator) or noise


def _fitted_noise(residuals: _Residuals, generator: np.random.Generator) -> Noise | None:
    if len(residuals.middle) < LEAST_PIECES or not len(residuals.length):
        return None
    low, high = np.quantile(residuals.length, (0.005, 0.995))
    edges = np.geomspace(low, max(high, low * 1.0001), RANGE_BINS + 1)
    inner = np.searchsorted(edges, residuals.length) - 1
    # In each bin from the smallest on, so that a weighted median is one look at the sums of the weights.
    order = np.lexsort((residuals.value, inner))
    value, length, piece, inner = (
        array[order] for array in (residuals.value, residuals.length, residuals.piece, inner)
    )
    # Pieces overlap; places do not, and are what the bootstrap draws.
    place = np.unique(np.floor(residuals.middle / PLACE), axis=0, return_inverse=True)[1].ravel()
    place_of = place[piece]
    n = int(place.max()) + 1

    # Not where the origin of coordinates would have them, which says nothing.
    corner = residuals.middle.min(axis=0)
    apart = np.unique(np.floor((residuals.middle - corner) / PLACE), axis=0, return_inverse=True)[1].ravel()

    def places_beyond(least: float) -> int:
        return int(np.count_nonzero(np.bincount(apart[piece[length >= least]]) >= LEAST_RESIDUALS))

    if places_beyond(0.0) < LEAST_PLACES:
        return None
    parts, spots = [], []
    for i in range(RANGE_BINS):
        part = slice(*np.searchsorted(inner, (i, i + 1)))
        pieces = len(np.unique(piece[part]))
        if len(value[part]) >= LEAST_RESIDUALS and pieces >= 3:
            parts.append(part)
            spots.append((float(np.sqrt(np.mean(length[part] ** 2))), pieces))
    if not parts:
        return None
    where, pieces = np.array(spots).T

    def sigmas(weight: Floats) -> Floats:
        return np.array([1.4826 * _weighted_median(value[part], weight[part]) for part in parts])

    measured = sigmas(np.ones(len(value)))
    drawn = [
        sigmas(generator.multinomial(n, np.full(n, 1 / n))[place_of].astype(float)) for _ in range(RESAMPLES)
    ]
    both = _fitted(where, measured, pieces)
    spread = np.array([_fitted(where, one, pieces) for one in drawn])
    is_wide = len(parts) >= 3 and places_beyond(WIDE * where[0]) >= LEAST_PLACES
    if not is_wide or np.nanquantile(spread[:, 1], (1 - CONFIDENCE) / 2) <= 0:
        # A constant explains the data as well; where all ranges are alike, growth is a guess elsewhere.
        both = (_fitted_constant(measured, pieces), 0.0)
        spread[:, 0] = [_fitted_constant(one, pieces) for one in drawn]
    if both[1] > STEEPEST or _misfit(where, measured, both) > LARGEST_MISFIT:
        return None
    count = sum(part.stop - part.start for part in parts)
    sigma, quadratic = (
        estimated(best, one[np.isfinite(one)], int(count)) for best, one in zip(both, spread.T)
    )
    bins = tuple(
        (float(r), float(s), int(part.stop - part.start)) for r, s, part in zip(where, measured, parts)
    )
    return Noise(sigma, quadratic, len(residuals.middle), bins)


def _weighted_median(rising: Floats, weight: Floats) -> float:
    sums = np.cumsum(weight)
    if not sums[-1] > 0:
        return math.nan
    return float(rising[np.searchsorted(sums, 0.5 * sums[-1])])


def _fitted(where: Floats, sigma: Floats, pieces: Floats) -> tuple[float, float]:
    """a >= 0 and b >= 0 of sigma = a + b r², by least squares of the relative errors."""
    known = np.isfinite(sigma)
    where, sigma, pieces = where[known], sigma[known], pieces[known]
    if not known.any():
        return math.nan, math.nan
    weight = np.sqrt(pieces) / (sigma + TINY)
    columns = np.column_stack([weight, weight * where**2])
    wanted = weight * sigma
    if len(sigma) > 1:
        both = np.linalg.lstsq(columns, wanted, rcond=None)[0]
        if (both >= 0).all():
            return float(both[0]), float(both[1])
    # Only one of them is not 0 then: the one that leaves less.
    alone = np.maximum((columns * wanted[:, None]).sum(axis=0) / (columns**2).sum(axis=0), 0.0)
    left = ((columns * alone - wanted[:, None]) ** 2).sum(axis=0)
    return (float(alone[0]), 0.0) if left[0] <= left[1] else (0.0, float(alone[1]))


def _misfit(where: Floats, sigma: Floats, both: tuple[float, float]) -> float:
    """By which factor the bins are off a fit, in the median."""
    ratio = np.maximum(sigma, LEAST_SIGMA) / np.maximum(both[0] + both[1] * where**2, LEAST_SIGMA)
    return float(np.median(np.maximum(ratio, 1 / ratio)))


def _fitted_constant(sigma: Floats, pieces: Floats) -> float:
    known = np.isfinite(sigma)
    if not known.any():
        return math.nan
    weight = pieces[known] / (sigma[known] + TINY) ** 2
    return float((weight * sigma[known]).sum() / weight.sum())


class _Pieces:
    """Flat pieces of surface: where they are is searched once, what they measure can be asked again."""

    def __init__(
        self, points: Points, max_range: float, generator: np.random.Generator, progress: Progress
    ) -> None:
        use = generator.permutation(np.flatnonzero(points.length <= max_range))
        self._end, self._direction = points.end[use], points.direction[use]
        self._length, self._scan = points.length[use], points.scan[use]
        self._progress = progress
        self._waiting = {RADII[0]: _middles(self._length)}
        self._is_search = True
        self._grids: dict[float, Grid] = {}

    def residuals(self, model: tuple[float, float] | None) -> _Residuals:
        """Of all flat pieces, where ranges are as noisy as a model says, or all alike."""
        dim = self._end.shape[1]
        sigma = np.ones(len(self._length))
        if model is not None:
            sigma = np.maximum(model[0] + model[1] * self._length**2, LEAST_SIGMA)
        rows: list[tuple[Floats, Floats, NDArray[np.int64]]] = []
        accepted = {radius: np.empty(0, dtype=np.int64) for radius in RADII}
        pieces = 0
        for radius, larger in zip(RADII, (*RADII[1:], None)):
            waiting = self._waiting.get(radius, accepted[radius])
            if not len(waiting):
                continue
            if radius not in self._grids:
                self._grids[radius] = Grid(self._end, radius)
            grid = self._grids[radius]
            for start in range(0, len(waiting), CHUNK):
                seeds = waiting[start : start + CHUNK]
                near_by, use = grid.around(self._end[seeds])
                flat = flat_pieces(
                    self._end[near_by] - self._end[seeds][:, None],
                    self._direction[near_by],
                    self._scan[near_by],
                    sigma[near_by],
                    use,
                    radius,
                )
                row, column = np.nonzero(flat.residual_use & flat.accepted[:, None])
                number = np.cumsum(flat.accepted) - 1 + pieces
                rows.append((flat.residual[row, column], self._length[near_by[row, column]], number[row]))
                accepted[radius] = np.append(accepted[radius], seeds[flat.accepted])
                pieces += int(np.count_nonzero(flat.accepted))
                if self._is_search and larger is not None:
                    others = self._waiting.get(larger, seeds[:0])
                    self._waiting[larger] = np.append(others, seeds[flat.retry])
                self._progress(f"surfaces of {radius:g} m", start + len(seeds), len(waiting))
        self._waiting, self._is_search = accepted, False
        if not rows:
            return _Residuals(np.empty(0), np.empty(0), np.empty(0, dtype=np.int64), np.empty((0, dim)))
        value, length, piece = (np.concatenate(part) for part in zip(*rows))
        middle = self._end[np.concatenate([accepted[radius] for radius in RADII])]
        return _Residuals(value, length, piece, middle)


def _middles(length: Floats) -> NDArray[np.int64]:
    """Points to look around, as many of each range; the points themselves come in random order."""
    if not len(length):
        return np.empty(0, dtype=np.int64)
    low, high = np.quantile(length, (0.005, 0.995))
    edges = np.geomspace(low, max(high, low * 1.0001), RANGE_BINS + 1)
    inner = np.clip(np.searchsorted(edges, length) - 1, 0, RANGE_BINS - 1)
    share = PIECES // RANGE_BINS
    return np.concatenate([np.flatnonzero(inner == i)[:share] for i in range(RANGE_BINS)])
