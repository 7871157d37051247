# SPDX-License-Identifier: BSD-3-Clause
"""Files of bare float32 numbers, as KITTI, nuScenes and others have them: 3 to 8 a point, x y z first."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ndtree.logs.core.plain_file import open_regular


def bin_points(path: str, width: int) -> NDArray[np.float32]:
    """(n, 3) points of a file of `width` numbers a point; ValueError where these are not whole points."""
    with open_regular(path) as file:
        size = os.fstat(file.fileno()).st_size
        if size % (4 * width):
            raise ValueError(
                f"{path}: {size} bytes, expected a multiple of {4 * width} (float32 {WIDTHS[width]})"
            )
        return np.fromfile(file, dtype="<f4").reshape(-1, width)[:, :3]


def may_be_points(path: str) -> bool:
    """Whether a file holds numbers as coordinates are: finite but for few, and none absurdly large."""
    with open_regular(path) as file:
        size = os.fstat(file.fileno()).st_size
        if size % 4:
            return False
        part = np.fromfile(file, dtype="<f4", count=_SAMPLE)
    with np.errstate(invalid="ignore"):
        usual = (np.abs(part) < _FAR) & ((part == 0) | (np.abs(part) > _TINY))
    return len(part) >= 3 and bool(np.mean(usual) > _MOST) and bool(np.any(part[usual] != 0))


#: Bounds of what may be a coordinate or an intensity, but for a share of the numbers.
_FAR, _TINY, _MOST = 1e6, 1e-9, 0.99


def floats_a_point(files: Sequence[str]) -> int:
    """How many float32 a point has, told from files of one kind: 4 where nothing speaks against it.

    With the right number, each column is one quantity; with another one, columns mix coordinates, intensity
    and rings, and spread more. Compared is the mean logarithm of the columns' standard deviations. Where all
    files hold whole points of 4, a number of which most files do not is none.

    Raises ValueError if another number than 4 fits better, though not clearly.
    """
    samples, sizes, path = [], [], files[0]
    for path in _spread_out(files):
        with open_regular(path) as file:
            sizes.append(os.fstat(file.fileno()).st_size)
            part = np.fromfile(file, dtype="<f4", count=_SAMPLE)
        if len(part) >= _FEWEST:
            samples.append(np.clip(np.nan_to_num(part.astype(np.float64), posinf=0.0, neginf=0.0), -1e4, 1e4))
    if not samples:
        return 4
    spreads = {width: float(np.mean([_spread(one, width) for one in samples])) for width in WIDTHS}
    noise = max(_CLEARLY / 4, _SURE / math.sqrt(2 * sum(map(len, samples))))
    clearly = max(_CLEARLY, 1.5 * noise)
    misfits = {width: sum(size % (4 * width) != 0 for size in sizes) for width in WIDTHS}
    possible = [width for width in WIDTHS if 2 * misfits[width] <= len(sizes) or misfits[4]]
    best = min(possible, key=lambda width: spreads[width])
    if best in (6, 8) and spreads[best // 2] - spreads[best] <= clearly:
        best //= 2  # Every second point of the same is as good.
    gain = spreads[4] - spreads[best]
    if gain <= 0.0:
        return 4
    if gain > clearly:
        return best
    fitting = [width for width in WIDTHS if not misfits[width]]
    if 4 in fitting and (gain < noise or best not in fitting):
        return 4
    if fitting == [best]:
        return best
    raise ValueError(
        f"{path}: cannot tell whether points have 4 or {best} numbers, expected float32 {WIDTHS[4]}"
    )


#: What the numbers of a point are.
WIDTHS = {
    3: "x y z",
    4: "x y z intensity",
    5: "x y z intensity and one more",
    6: "x y z intensity and two more",
    7: "x y z and four more",
    8: "x y z and five more",
}
#: Numbers that are looked at in a file, and how many there must be.
_SAMPLE, _FEWEST = 60_000, 60
#: Mean logarithm by which columns spread less with the right number.
_CLEARLY = 0.1
#: Standard errors of that mean that are no chance; one is 1 / sqrt(2 n) of n numbers.
_SURE = 2.5


def _spread_out(files: Sequence[str], count: int = 5) -> list[str]:
    """Up to `count` files, from the first to the last."""
    return [files[i] for i in sorted({round(i * (len(files) - 1) / (count - 1)) for i in range(count)})]


def _spread(sample: NDArray[np.float64], width: int) -> float:
    """Mean logarithm of the columns' standard deviations; that of a constant one is 0.001 of the sample's."""
    table = sample[: len(sample) // width * width].reshape(-1, width)
    floor = max(1e-3 * float(sample.std()), 1e-12)
    return float(np.log(np.maximum(table.std(axis=0), floor)).mean())
