# SPDX-License-Identifier: BSD-3-Clause
"""Flat pieces of surface: points around a place, and a line or plane through them."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from ndtree.tuning.calibration.figures import Bools, Floats

CANDIDATES = 320  # Points around the middle of a piece, most.
LEAST_POINTS = {2: 15, 3: 25}  # By dimension: in a piece, ...
LEAST_SPREAD = {2: 0.2, 3: 0.15}  # ... and its standard deviation along each direction, in radii.
LEAST_SCANS = 3
CORE = 0.7  # Residuals count up to this distance along the surface, in radii: the ball cuts none off there.
THICKEST = (
    1 / 3
)  # Standard deviation of the residuals, in that along the surface: else it is a body, no surface.
LEAST_COSINE = 0.5  # Of the angle between beam and normal: at least 30 degrees between beam and surface.
TINY = 1e-6  # Thickness that is none [m].


class Grid:
    """Points by the cell of a grid that they are in; other cells may share a key, and distances tell."""

    _FACTORS = (73_856_093 * 2**20 + 1, 19_349_663 * 2**10 + 7, 1)

    def __init__(self, points: Floats, size: float) -> None:
        self._points = points
        self._size = size
        keys = self._keys(np.floor(points / size).astype(np.int64))
        self._order = np.argsort(keys, kind="stable")
        self._keys_sorted = keys[self._order]

    def _keys(self, cells: NDArray[np.int64]) -> NDArray[np.int64]:
        factors = np.array(self._FACTORS[-cells.shape[1] :], dtype=np.int64)
        return (cells * factors).sum(axis=1)  # Wraps around.

    def around(self, middles: Floats) -> tuple[NDArray[np.int64], Bools]:
        """Indices (m, k) of points near each middle, at most `CANDIDATES`, and which are within the size."""
        dim = middles.shape[1]
        cells = np.floor(middles / self._size).astype(np.int64)
        first, last = [], []
        for shift in product((-1, 0, 1), repeat=dim - 1):  # Cells along the last axis have keys in a row.
            keys = self._keys(cells + np.array([*shift, 0]))
            first.append(np.searchsorted(self._keys_sorted, keys - 1, side="left"))
            last.append(np.searchsorted(self._keys_sorted, keys + 1, side="right"))
        begin = np.stack(first, axis=1)
        count = np.stack(last, axis=1) - begin
        ends = np.cumsum(count, axis=1)
        total = ends[:, -1]
        width = min(int(total.max()), CANDIDATES)
        step = np.maximum(total / CANDIDATES, 1.0)
        wanted = (np.arange(width) * step[:, None]).astype(np.int64)
        use = wanted < total[:, None]
        wanted = np.where(use, wanted, 0)
        run = (wanted[:, :, None] >= ends[:, None, :]).sum(axis=2)
        before = np.take_along_axis(ends - count, run, axis=1)
        indices = self._order[np.take_along_axis(begin, run, axis=1) + wanted - before]
        off = self._points[indices] - middles[:, None]
        return indices, use & ((off**2).sum(axis=2) <= self._size**2)


@dataclass(frozen=True)
class _Flat:
    """Pieces of surface, a row each: which are flat, which deserve a larger radius, and their residuals."""

    accepted: Bools
    retry: Bools
    residual: Floats
    residual_use: Bools


def flat_pieces(
    off: Floats, direction: Floats, scan: NDArray[np.int64], noise: Floats, use: Bools, radius: float
) -> _Flat:
    """Fits a line or plane to each row of points, (m, k, dim) from their middle, robustly.

    `noise` (m, k) says how the points' standard deviations compare; what is tested is residuals over it.
    """
    dim = off.shape[2]
    inner = use
    few = np.zeros(len(use), dtype=bool)
    for _ in range(4):
        few |= inner.sum(axis=1) < LEAST_POINTS[dim]
        weight = inner / noise**2
        weight /= np.maximum(weight.sum(axis=1), 1e-300)[:, None]
        mean = np.matmul(weight[:, None], off)[:, 0]
        centred = off - mean[:, None]
        spread, axes = np.linalg.eigh(np.matmul((weight[:, :, None] * centred).transpose(0, 2, 1), centred))
        normal = axes[:, :, 0]
        distance = np.matmul(centred, normal[:, :, None])[:, :, 0]
        along = np.matmul(off, axes[:, :, 1:])
        core = use & ((along**2).sum(axis=2) <= (CORE * radius) ** 2)
        scaled = distance / noise
        scaled -= _row_median(scaled, core)[:, None]  # What stands before a surface is on one side of it.
        sigma = 1.4826 * _row_median(np.abs(scaled), core)
        tiny = TINY / noise
        inner = core & (np.abs(scaled) <= np.maximum(3 * sigma[:, None], tiny))
    n = inner.sum(axis=1)
    few |= n < LEAST_POINTS[dim]
    size = np.maximum(n, 1)
    width = np.sqrt(np.maximum(spread[:, 1], 0))
    thick = 1.4826 * _row_median(np.abs(distance), core) > THICKEST * width
    whole = n >= 0.9 * core.sum(axis=1)
    centred_on = np.abs((mean * normal).sum(axis=1)) <= 0.3 * radius
    populated = width >= LEAST_SPREAD[dim] * radius
    several = _distinct(scan, inner) >= LEAST_SCANS
    rms = np.sqrt((scaled**2 * inner).sum(axis=1) / size)
    middle_share = (inner & (np.abs(scaled) <= np.maximum(0.5 * rms[:, None], tiny))).sum(axis=1) / size
    one_mode = middle_share >= 0.2  # 0.38 of a normal distribution, 0.29 of a uniform one.
    relief, tiles = _relief(scaled, along / (CORE * radius), inner)
    straight = (_bend(scaled, along / radius, inner) <= 0.1 + 6 / size) & (
        relief <= 0.08 + 1.5 * tiles / size
    )
    straight |= np.sqrt((distance**2 * inner).sum(axis=1) / size) <= TINY
    accepted = ~few & ~thick & whole & centred_on & populated & several & one_mode & straight
    cosine = np.abs(np.matmul(direction, normal[:, :, None])[:, :, 0])
    # The fit follows each point a little, the more the better the point is, and takes that from its residual.
    left = np.sqrt(np.maximum(1 - dim * weight, 0.25))
    along_beam = np.abs(scaled * noise) / (np.maximum(cosine, LEAST_COSINE) * left)
    return _Flat(accepted, few | thick, along_beam, core & (cosine >= LEAST_COSINE))


def _row_median(values: Floats, use: Bools) -> Floats:
    """The median of each row's values that count; 0 where none does."""
    rising = np.sort(np.where(use, values, np.inf), axis=1)
    n = use.sum(axis=1)
    rows = np.arange(len(values))
    low, high = (rising[rows, np.maximum(at, 0)] for at in ((n - 1) // 2, np.minimum(n // 2, n - 1)))
    return np.where(n > 0, 0.5 * (np.where(n > 0, low, 0) + np.where(n > 0, high, 0)), 0.0)


def _distinct(values: NDArray[np.int64], use: Bools) -> NDArray[np.int64]:
    """How many different values each row has."""
    rising = np.sort(np.where(use, values, -1), axis=1)
    return (np.diff(rising, axis=1, prepend=-1) != 0).sum(axis=1)


def _bend(residual: Floats, along: Floats, use: Bools) -> Floats:
    """The share of the residuals' variance that a paraboloid explains."""
    n = np.maximum(use.sum(axis=1), 1)
    columns = [np.ones_like(residual), *np.moveaxis(along, 2, 0)]
    columns += [along[:, :, i] * along[:, :, j] for i in range(along.shape[2]) for j in range(i + 1)]
    design = np.stack(columns, axis=2) * use[:, :, None]
    values = np.where(use, residual, 0.0)
    values = np.where(use, values - (values.sum(axis=1) / n)[:, None], 0.0)
    square = np.matmul(design.transpose(0, 2, 1), design) + 1e-9 * n[:, None, None] * np.eye(len(columns))
    mixed = np.matmul(values[:, None], design)[:, 0]
    explained = (mixed * np.linalg.solve(square, mixed[:, :, None])[:, :, 0]).sum(axis=1)
    return explained / np.maximum((values**2).sum(axis=1), 1e-30)


def _relief(residual: Floats, along: Floats, use: Bools) -> tuple[Floats, int]:
    """The share of the residuals' variance between tiles of the surface, and the number of tiles."""
    each = {1: 6, 2: 4}[along.shape[2]]
    tiles = each ** along.shape[2]
    tile = np.zeros(use.shape, dtype=np.int64)
    for axis in range(along.shape[2]):
        at = np.floor((along[:, :, axis] + 1) * (each / 2)).astype(np.int64)
        tile = tile * each + np.clip(at, 0, each - 1)
    where = (tile + tiles * np.arange(len(use))[:, None])[use]
    count = np.bincount(where, minlength=tiles * len(use))
    sums = np.bincount(where, residual[use], minlength=tiles * len(use))
    between = (sums**2 / np.maximum(count, 1)).reshape(len(use), tiles).sum(axis=1)
    return between / np.maximum((residual**2 * use).sum(axis=1), 1e-30), tiles
