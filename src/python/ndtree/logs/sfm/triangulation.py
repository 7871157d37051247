# SPDX-License-Identifier: BSD-3-Clause
"""Structure from motion: each observation is a beam from a camera to a point, and how sure its range is."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ndtree._errors import WrongValue
from ndtree.base.scan import Scan
from ndtree.logs.core.arrays import Floats
from ndtree.logs.core.log import SizedLog, Skipped
from ndtree.logs.core.source import Source

DEFAULT_PIXEL_SIGMA = 1.0

#: Observations whose range is less sure than this share of it are left out: 3 sigma reach back to the camera.
LARGEST_RELATIVE_SIGMA = 1 / 3
#: How ``Log.skipped`` calls them.
UNSURE = "observations of unsure range"

Rows = NDArray[np.intp]


class Triangulation:
    """Points, and how much the rays that meet in each of them say about its place.

    An image of focal length f [px] sees a point at range r along the unit ray u. A feature's error of
    `pixel_sigma` moves it across that ray by s = r pixel_sigma / f, and says nothing along the ray. To first
    order, the information about the point is therefore, summed over the images i that see it,

        I = sum_i (1 - u_i u_i^T) / s_i^2,

    and along the ray u of an image the point's standard deviation is sqrt(u^T I^-1 u). For two images whose
    rays meet at the parallax a it is sqrt(s_2^2 / sin^2 a + s_1^2 / tan^2 a) for the first: it grows with the
    ranges, and as 1 / a where the parallax is small.

    It is never said to be below s of the image itself: what many images share, the errors of their poses,
    does not average out.

    `points`: (n, 3) float64.
    `pixel_sigma`: [px], > 0.
    """

    def __init__(self, points: Floats, pixel_sigma: float) -> None:
        self.points = points
        self._pixel_sigma = pixel_sigma
        self._information = np.zeros((len(points), 6))  # xx, yy, zz, xy, xz, yz

    def observe(self, rows: Rows, center: Floats, focal_length: float) -> None:
        """Count what one image sees: rows (m,) of points, each once; its place, and focal length [px]."""
        ray, across = self._rays(rows, center, focal_length)
        x, y, z = ray.T
        parts = np.stack([1 - x * x, 1 - y * y, 1 - z * z, -x * y, -x * z, -y * z], axis=1)
        seen = across > 0  # A point at the camera's centre lies nowhere.
        self._information[rows[seen]] += parts[seen] / across[seen, None] ** 2

    def range_sigma(self, rows: Rows, center: Floats, focal_length: float) -> Floats:
        """Standard deviations of the ranges from a camera, after all images were counted.

        (m,) float64 in the unit of the points; inf where not two images saw the point, or all from one
        direction.
        """
        ray, across = self._rays(rows, center, focal_length)
        xx, yy, zz, xy, xz, yz = self._information[rows].T
        # The inverse of a symmetric matrix by its cofactors.
        cxx, cyy, czz = yy * zz - yz * yz, xx * zz - xz * xz, xx * yy - xy * xy
        cxy, cxz, cyz = xz * yz - xy * zz, xy * yz - xz * yy, xy * xz - xx * yz
        determinant = xx * cxx + xy * cxy + xz * cxz
        x, y, z = ray.T
        along = x * x * cxx + y * y * cyy + z * z * czz + 2 * (x * y * cxy + x * z * cxz + y * z * cyz)
        # A determinant that rounding could have made of zero says that all rays are one.
        known = (determinant > 1e-12 * ((xx + yy + zz) / 2) ** 3) & (across > 0)
        variance = np.full(len(rows), np.inf)
        np.divide(along, determinant, out=variance, where=known)
        return np.maximum(np.sqrt(variance), across)

    def _rays(self, rows: Rows, center: Floats, focal_length: float) -> tuple[Floats, Floats]:
        """Unit rays to the points, and how far a feature's error moves them across it."""
        way = self.points[rows] - center
        ranges = np.linalg.norm(way, axis=1)
        with np.errstate(invalid="ignore"):
            return way / ranges[:, None], ranges * (self._pixel_sigma / focal_length)


@dataclass(frozen=True)
class Model:
    """What structure from motion found, held in memory.

    `points` (P, 3), `centers` (C, 3): Of points and cameras, float64.
    `focal_lengths` (C,): [px].
    `seen`: Of each camera rows of the points that it sees, each once.
    """

    points: Floats
    centers: Floats
    focal_lengths: Floats
    seen: list[Rows]


def rows_of(cameras: int, cameras_seeing: NDArray[np.int32], points_seen: NDArray[np.int32]) -> list[Rows]:
    """The rows that each camera sees, of pairs (O,) of a camera and a point in any order and any often."""
    order = np.lexsort((points_seen, cameras_seeing))
    bounds = np.searchsorted(cameras_seeing[order], np.arange(cameras + 1))
    return [np.unique(points_seen[order[start:end]]) for start, end in zip(bounds[:-1], bounds[1:])]


class SfmLog(SizedLog):
    """A scan each image, with a beam and its ``range_sigma`` for each observation.

    Observations whose range is not known, as of points that one image alone sees, are left out, and counted
    in ``skipped``. The model is read when the first scan or their number is asked for, and kept.
    """

    may_be_padded = False  # Models may have any unit of length.

    def __init__(self, source: Source, pixel_sigma: float = DEFAULT_PIXEL_SIGMA) -> None:
        if not (pixel_sigma > 0 and np.isfinite(pixel_sigma)):
            raise WrongValue.of("pixel_sigma", f"{pixel_sigma:g} px", "> 0 and finite")
        super().__init__(source.path, dim=3)
        self._pixel_sigma = pixel_sigma
        self._decided.append("distances are in the model's own unit, which is a metre only if it was scaled")

    def _scan(self, triangulation: Triangulation, rows: Rows, center: Floats, focal_length: float) -> Scan:
        """One image's observations whose range is known well enough."""
        points = triangulation.points[rows]
        sigma = triangulation.range_sigma(rows, center, focal_length)
        use = sigma < LARGEST_RELATIVE_SIGMA * np.linalg.norm(points - center, axis=1)
        left_out = len(rows) - int(np.count_nonzero(use))
        if left_out:
            where = f"{self.path}: image {self._done + 1}"
            first = f"{where}: {left_out} of {len(rows)} rays meet no others, or hardly"
            self.skipped.setdefault(UNSURE, Skipped(0, first)).count += left_out
        return Scan(points[use], center, range_sigma=sigma[use])

    def __len__(self) -> int:
        return len(self._model.centers)

    @abstractmethod
    def _read(self) -> Model: ...

    @cached_property
    def _model(self) -> Model:
        return self._read()

    @cached_property
    def _triangulated(self) -> Triangulation:
        model = self._model
        triangulation = Triangulation(model.points, self._pixel_sigma)
        for rows, center, focal_length in zip(model.seen, model.centers, model.focal_lengths):
            if rows.size:
                triangulation.observe(rows, center, focal_length)
        return triangulation

    def _scans(self) -> Iterator[Scan]:
        model, triangulation = self._model, self._triangulated
        for rows, center, focal_length in zip(model.seen, model.centers, model.focal_lengths):
            yield self._scan(triangulation, rows, center, focal_length)
