# SPDX-License-Identifier: BSD-3-Clause
"""Boxes of pixels in an image."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

Ints = NDArray[np.int64]

_AT_ONCE = 4_000_000  # Pixels.


def pixels_in(first: Ints, last: Ints, width: int) -> tuple[Ints, Ints]:
    """Numbers of all pixels of boxes, row by row in an image of a width, and which box each is of.

    `first`, `last` (ndarray, (n, 2)): Column and row of a box's first pixel, and of the one behind its last.
    """
    found = [np.zeros((2, 0), dtype=np.int64)]
    for at, which in pixel_parts(first, last, width):
        found.append(np.stack([at.ravel(), np.repeat(which, at.shape[1])]))
    at, which = np.concatenate(found, axis=1)
    return at, which


def pixel_parts(first: Ints, last: Ints, width: int) -> Iterator[tuple[Ints, Ints]]:
    """The same, bit by bit: pixels (m, k) of boxes of one shape, and these boxes (m,)."""
    if not len(first):
        return
    extent = last - first
    most = int(extent.max()) + 1
    shape = extent[:, 1] * most + extent[:, 0]
    order = np.argsort(shape, kind="stable")
    for alike in np.split(order, np.flatnonzero(np.diff(shape[order])) + 1):
        rows, columns = divmod(int(shape[alike[0]]), most)
        inside = (np.arange(rows)[:, None] * width + np.arange(columns)).ravel()
        for use in np.array_split(alike, max(1, len(alike) * len(inside) // _AT_ONCE)):
            yield (first[use, 1] * width + first[use, 0])[:, None] + inside, use
