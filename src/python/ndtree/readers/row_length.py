# SPDX-License-Identifier: BSD-3-Clause
"""How many numbers a point has in a file of bare floats, told from the numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Lengths of a point that are looked for: x y z, then intensity, ring, time and the like.
LENGTHS = (3, 4, 5, 6, 7, 8)
#: A mean difference counts as smaller if it is so by more than this many standard errors; of rows in a random
#: order, which do not depend on each other, fewer do.
_SURE, _SURE_OF_RANDOM = 6.0, 3.0


def row_lengths(streams: list[NDArray[Any]]) -> list[int]:
    """Lengths of a point that the numbers allow, the likeliest first; one if the numbers decide it.

    Numbers of one column are closer to each other than to those of other columns: E|X - Y| is smallest for X
    and Y of one distribution. So the mean difference of numbers that are a length apart is smallest at the
    true one. Twice the true length compares equal columns, too; it counts only if the two halves of such a
    row differ in distribution, which pairs of rows far apart show. O(numbers).

    Parameters
    ----------
    streams : list of (n,) float
        All numbers of some files of one layout, point by point.
    """
    values = [np.clip(np.nan_to_num(stream, nan=0.0), -1e6, 1e6) for stream in streams]
    near = {length: _difference(values, length) for length in LENGTHS}
    for length in (3, 4):
        if not _is_smaller(_far(values, 2 * length), _far(values, length), _SURE_OF_RANDOM):
            near.pop(2 * length)
        elif near[2 * length][0] <= near[length][0]:
            near.pop(length)
    best = min(near, key=lambda length: near[length][0])
    return sorted(
        (length for length in near if not _is_smaller(near[best], near[length])), key=lambda n: near[n][0]
    )


def _is_smaller(one: tuple[float, float], other: tuple[float, float], sure: float = _SURE) -> bool:
    return other[0] - one[0] > sure * float(np.hypot(one[1], other[1]))


def _difference(values: list[NDArray[Any]], apart: int) -> tuple[float, float]:
    """Mean absolute difference of numbers so far apart, and its standard error."""
    return _mean([np.abs(stream[apart:] - stream[:-apart]) for stream in values])


def _far(values: list[NDArray[Any]], length: int) -> tuple[float, float]:
    """The same of rows in a random order, beside each other."""
    random = np.random.default_rng(0)
    found = []
    for stream in values:
        rows = stream[: len(stream) // length * length].reshape(-1, length)
        found.append(np.abs(rows - rows[random.permutation(len(rows))]).ravel())
    return _mean(found)


def _mean(parts: list[NDArray[Any]]) -> tuple[float, float]:
    found = np.concatenate(parts).astype(np.float64)
    if len(found) < 2:
        return 0.0, float("inf")
    return float(found.mean()), float(found.std() / np.sqrt(len(found)))
