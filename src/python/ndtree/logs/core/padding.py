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

    `points` (ndarray of float, (n, dim)): End points, in any frame [m].
    `origin` (array_like, (dim,) or (n, dim)): The sensor, in the same frame [m]; left out, the points are in
        the sensor's own.
    Returns ndarray of float, (n, dim): `points` itself where there is no padding.
    """
    own = np.broadcast_to(np.asarray(origin, dtype=points.dtype), points.shape)
    with np.errstate(invalid="ignore", over="ignore"):
        # Hardly any point is so near along one axis, and only these are looked at.
        near = np.flatnonzero(np.abs(points[:, 0] - own[:, 0]) < 2 * NEAREST)
        way = points[near] - own[near]
        near = near[(way * way).sum(axis=1) < NEAREST**2]
    if not len(near):
        return points
    points = points.copy()
    points[near] = np.nan
    return points


def without_zeros(points: Points) -> Points:
    """The points of a scan in a fixed frame with NaN for (0, 0, 0), where it is there more than once.

    A program that moves points to a fixed frame may leave padding as it was. What is measured does not come
    twice to the last bit.
    """
    zero: NDArray[np.bool_] = (points == 0).all(axis=1)
    if np.count_nonzero(zero) < 2:
        return points
    points = points.copy()
    points[zero] = np.nan
    return points
