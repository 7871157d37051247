# SPDX-License-Identifier: BSD-3-Clause
"""Points that only fill an array, as drivers write them for beams without a measurement: one rule for all."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

#: No sensor measures a surface that is nearer than this [m].
NEAREST = 1e-3

Points = NDArray[np.floating[Any]]


def without_padding(points: Points, origin: ArrayLike = 0.0) -> Points:
    """The points with NaN instead of padding: what is nearer than 1 mm to its sensor measured nothing.

    Drivers fill their arrays with (0, 0, 0) where a beam did not return, often with a time of its own: from
    a sensor that moved meanwhile it would be a beam of some millimetres.

    Parameters
    ----------
    points : ndarray of float, (n, dim)
        End points, in any frame [m].
    origin : array_like, (dim,) or (n, dim)
        The sensor, in the same frame [m]; left out, the points are in the sensor's own.

    Returns
    -------
    ndarray of float, (n, dim)
        `points` itself where there is no padding.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        way = points - np.asarray(origin, dtype=points.dtype)
        return _without(points, np.einsum("ij,ij->i", way, way) < NEAREST**2)


def without_zeros(points: Points) -> Points:
    """The points of a scan in a fixed frame with NaN for (0, 0, 0), where it is there more than once.

    A program that moves points to a fixed frame may leave padding as it was. What is measured does not come
    twice to the last bit.
    """
    zero: NDArray[np.bool_] = (points == 0).all(axis=1)
    return _without(points, zero) if np.count_nonzero(zero) > 1 else points


def _without(points: Points, which: NDArray[np.bool_]) -> Points:
    if not which.any():
        return points
    points = points.copy()
    points[which] = np.nan
    return points
