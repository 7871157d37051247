# SPDX-License-Identifier: BSD-3-Clause
"""The byte order of a message's numbers where `is_bigendian` contradicts them.

In the wrong order floats have any exponent, and depths jump by many metres from one pixel to the next.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

SWAPPED = "is_bigendian contradicts the data, which are read in the other order"
#: Lengths that are not 0 are between these [m].
_SHORTEST, _LONGEST = 1e-6, 1e5
#: Of a message's numbers, fewer may be lengths where it is wrong, and more are in the other order.
_WRONG, _RIGHT = 0.5, 0.9
#: Values that are looked at; fewer pairs of pixels tell nothing.
LOOKED_AT, _FEWEST = 4096, 64
#: How many times rougher depths of the wrong order are from pixel to pixel.
_ROUGHER = 16.0


def is_swapped(values: NDArray[Any]) -> bool:
    """Whether numbers, as their message says they are to be read, make sense only in the other byte order.

    `values` (ndarray): Lengths as floats of any shape [m], or integers of a depth image (rows, columns); of a
        byte order.
    """
    other = values.view(values.dtype.newbyteorder())
    if values.dtype.kind == "f":
        with np.errstate(invalid="ignore"):
            some, swapped = (one.ravel()[: 3 * LOOKED_AT].astype(np.float64) for one in (values, other))
        return _sense(some) < _WRONG and _sense(swapped) > _RIGHT
    if values.dtype.itemsize < 2 or values.ndim != 2:
        return False
    rough = [_roughness(one[:: max(1, len(one) // 64)].astype(np.int64)) for one in (values, other)]
    return rough[0] > _ROUGHER * max(rough[1], 1.0)


def _sense(values: NDArray[np.float64]) -> float:
    """Share of what may be lengths, of finite values but 0, which is the same in both orders."""
    known = values[np.isfinite(values) & (values != 0)]
    return float(np.mean((np.abs(known) > _SHORTEST) & (np.abs(known) < _LONGEST))) if len(known) else 1.0


def _roughness(rows: NDArray[np.int64]) -> float:
    """Median difference of pixels beside each other that have a depth; 0 where there are few."""
    pairs = (rows[:, 1:] > 0) & (rows[:, :-1] > 0)
    steps = np.abs(np.diff(rows, axis=1))[pairs]
    return float(np.median(steps)) if len(steps) >= _FEWEST else 0.0
