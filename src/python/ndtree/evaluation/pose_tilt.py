# SPDX-License-Identifier: BSD-3-Clause
"""By how much poses in space tilt and rise by mistake, from the ground that neighbouring scans share."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndtree.base.scan import Scan

_COLUMN = 0.5  # Edge of the columns whose lowest points are compared [m].
_LEAST_COLUMNS = 20  # That two scans share.
_LEAST_SPREAD = 0.7  # Of these around the sensor, on each axis [m]: else a tilt and a rise look alike.
_STEP = 0.5  # Of heights of one column, from which on it is not the ground [m].
_OUTLIER = 0.02  # Of heights, from which on they count less [m].
_MOST_POINTS = 20_000  # Of a scan that are looked at.
_LEAST_PAIRS = 5
Columns = tuple[NDArray[np.int64], NDArray[np.float64]]  # Keys, ascending, and the lowest point in each.
#: Tilts below this are within the error of the measurement [rad].
NOTABLE = np.radians(0.1)


@dataclass(frozen=True)
class PoseTilt:
    """How wrong the poses of a log are, beside the noise of its ranges."""

    tilt: float = 0.0  # Standard deviation of roll and pitch together [rad].
    height: float = 0.0  # Standard deviation of z [m].

    @property
    def is_notable(self) -> bool:
        return bool(self.tilt > NOTABLE)

    def sigma(self, length: NDArray[np.float64]) -> NDArray[np.float64]:
        """By how much the ends of beams are displaced [m]; 0 unless it is notable."""
        return self.tilt * length + self.height if self.is_notable else np.zeros(len(length))

    def figures(self) -> dict[str, float]:
        return {"tilt_degrees": float(np.degrees(self.tilt)), "height": self.height}

    def __str__(self) -> str:
        return f"poses pitch by about {np.degrees(self.tilt):.1f} degrees: points that this explains are kept"

    @classmethod
    def of(cls, scans: Iterable[Scan]) -> PoseTilt:
        """Measure it: a plane through the differences in height of the columns that two scans in a row share.

        Poses are wrong independently, so that the variance of one is half of that of a difference, and a
        sixth of that between two differences in a row. What changes slowly as the sensor moves, as where its
        lowest beams meet walls and ramps, is in the first alone: the smaller one counts. Medians, so that a
        step of the ground or a sharp turn does not count.

        `scans`: In space, in the order of their times. With too little ground in a row: no tilt.
        """
        planes = np.array(list(_differences(scans))).reshape(-1, 3)
        spreads = []
        for wrong, poses in ((planes, 2), (np.diff(planes, axis=0), 6)):
            known = wrong[~np.isnan(wrong[:, 0])]
            if len(known) < _LEAST_PAIRS:
                return cls()
            spreads.append(1.4826 * np.median(np.abs(known), axis=0) / np.sqrt(poses))
        x, y, z = np.min(spreads, axis=0)
        return cls(float(np.hypot(x, y)), float(z))


def _differences(scans: Iterable[Scan]) -> Iterator[NDArray[np.float64]]:
    """Of scans in a row, slopes along x and y and the rise between their grounds; nan where they share too
    little."""
    before: Columns | None = None
    for scan in scans:
        ground = ground_of(scan.endpoints[scan.did_return])
        if before is not None:
            plane = plane_between(before, ground, np.atleast_2d(scan.origin)[0, :2])
            yield np.full(3, np.nan) if plane is None else plane
        before = ground


def plane_between(
    before: Columns, ground: Columns, at: NDArray[np.floating[Any]]
) -> NDArray[np.float64] | None:
    """Slopes along x and y by which ground rises over what was seen before, and how much at a place.

    None if they share too little.
    """
    _, one, two = np.intersect1d(ground[0], before[0], assume_unique=True, return_indices=True)
    here = ground[1][one, :2] - at
    rise = ground[1][one, 2] - before[1][two, 2]
    same = np.abs(rise) < _STEP
    here, rise = here[same], rise[same]
    if len(rise) < _LEAST_COLUMNS or (here.std(axis=0) <= _LEAST_SPREAD).any():
        return None
    return plane_of(here, rise)


def ground_of(ends: NDArray[np.floating[Any]]) -> Columns:
    """The lowest of end points (n, 3) in each column of the map."""
    ends = np.asarray(ends, np.float64)[:: max(1, len(ends) // _MOST_POINTS)]
    ends = ends[np.isfinite(ends).all(axis=1)]
    cells = np.floor(ends[:, :2] / _COLUMN).astype(np.int64)
    keys = cells[:, 0] * (1 << 32) + cells[:, 1]
    order = np.lexsort((ends[:, 2], keys))
    first = np.ones(len(order), dtype=bool)
    first[1:] = np.diff(keys[order]) != 0
    return keys[order][first], ends[order][first]


def plane_of(here: NDArray[np.float64], rise: NDArray[np.float64]) -> NDArray[np.float64]:
    """Slopes and rise at the sensor, by least squares that are reweighted: posts and edges count little."""
    rows = np.c_[here, np.ones(len(here))]
    weight = np.ones(len(here))
    for _ in range(8):
        plane = np.linalg.lstsq(rows * weight[:, None], rise * weight, rcond=None)[0]
        weight = 1 / np.sqrt(1 + ((rise - rows @ plane) / _OUTLIER) ** 2)
    return np.asarray(plane)
