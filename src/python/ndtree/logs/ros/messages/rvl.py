# SPDX-License-Identifier: BSD-3-Clause
"""Depth images packed by RVL: runs of pixels without depth, and differences from pixel to pixel.

A. D. Wilson, "Fast Lossless Depth Image Compression", ISS 2017.
"""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

_SIZE = struct.Struct("<ii")
#: No camera has more pixels: what says so is damaged.
MOST_PIXELS = 1 << 26
#: Groups of three bits that a number may have: those of a difference of 16 bits, of a run, have fewer.
_MOST_GROUPS = 10


def unpacked(data: bytes) -> NDArray[np.uint16]:
    """The image, (rows, columns), in some bytes: its width and height, and words of eight numbers of 4 bits.

    Three bits of each are of a value, the lowest first, and the fourth says that more follow. The values are,
    over and over: how many pixels have no depth, how many then have one, and for each of these the difference
    to the one before, with its sign as the lowest bit.

    Raises ValueError if they are too few, or say something impossible.
    """
    if len(data) < _SIZE.size:
        raise ValueError(f"the image has {len(data)} bytes, expected its size and RVL")
    width, height = _SIZE.unpack_from(data)
    pixels = width * height
    if width < 0 or height < 0 or pixels > MOST_PIXELS:
        raise ValueError(f"the image has {width} x {height} pixels, expected at most {MOST_PIXELS}")
    values = _values(data[_SIZE.size :])
    places: list[NDArray[np.intp]] = []
    steps: list[NDArray[np.int64]] = []
    at = done = 0
    while done < pixels:
        if at + 1 >= len(values):
            raise ValueError(f"the image ends after {done} pixels, expected {width} x {height}")
        empty, full = int(values[at]), int(values[at + 1])
        at += 2
        if empty + full == 0 or done + empty + full > pixels or at + full > len(values):
            raise ValueError(
                f"the image has a run of {empty} and {full} pixels after {done}, expected {width} x {height}"
            )
        places.append(np.arange(done + empty, done + empty + full))
        steps.append(values[at : at + full])
        at += full
        done += empty + full
    image = np.zeros(pixels, dtype=np.uint16)
    if places:
        every = np.concatenate(steps)
        signed = (every >> 1) ^ -(every & 1)
        image[np.concatenate(places)] = np.cumsum(signed).astype(np.uint16)  # Overflows as 16 bits do.
    return image.reshape(height, width)


def _values(data: bytes) -> NDArray[np.int64]:
    """The numbers that are spread over groups of three bits."""
    words = np.frombuffer(data, dtype="<u4", count=len(data) // 4)
    shifts = np.arange(28, -1, -4, dtype=np.uint32)
    groups = ((words[:, None] >> shifts) & 15).ravel().astype(np.int64)
    ends = np.flatnonzero(groups < 8)
    if not len(ends):
        return np.zeros(0, dtype=np.int64)
    starts = np.concatenate([[0], ends[:-1] + 1])
    groups = groups[: ends[-1] + 1]
    lengths = ends - starts + 1
    if lengths.max() > _MOST_GROUPS:
        raise ValueError(f"the image has a number of {3 * int(lengths.max())} bits, expected at most 30")
    place = np.arange(len(groups)) - np.repeat(starts, lengths)
    return np.add.reduceat((groups & 7) << (3 * place), starts)
