# SPDX-License-Identifier: BSD-3-Clause
"""The ground of a 3-D map: how high it is, and what stands on it.

Strategy: below a column's ground nothing is known. So the ground of a column is no higher than the bottom of
its lowest free cell, nor than the top of its lowest occupied one. It rises from any other column within reach
by no more than a slope (an erosion by a pyramid, in steps of 1, 2, 4, ... pixels along each axis). A table,
whose floor is not seen below it, then stands on the floor beside it; at a cliff no more than its edge is an
obstacle. O(cells + pixels log reach).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ndtree.base.options import default_of
from ndtree.cells.raster import pixels_in

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Values as nav_msgs/OccupancyGrid has them.
UNKNOWN, FREE, OCCUPIED = -1, 0, 100
#: Occupied cells larger than the smallest alone, until it is known which are drawn.
LARGE = 99
#: The steepest ground [m/m]: 17 degrees, more than robots on wheels drive.
SLOPE: float = default_of("ground_slope")
#: How far a column may be from ground that is seen [m]: tables and cars are twice as wide, at most, or their
#: middle is taken as ground, with obstacles all around it.
REACH = 1.0


def ground_below(levels: Floats, pixel: float, slope: float = SLOPE) -> Floats:
    """The highest surface below some levels that rises from none within reach by more than a slope.

    `levels` (rows, columns): Inf where nothing is known [m].
    `pixel`: Edge of a pixel [m].
    `slope`: Along x or y [m/m].
    Returns (rows, columns): Inf where nothing is known within reach [m].
    """
    ground = levels.copy()
    for axis in (0, 1):
        ground = np.moveaxis(ground, axis, 0)
        left, step = min(math.ceil(REACH / pixel), len(ground) - 1), 1
        while left > 0:
            step = min(step, left)
            before, rise = ground.copy(), slope * pixel * step
            np.minimum(ground[step:], before[:-step] + rise, out=ground[step:])
            np.minimum(ground[:-step], before[step:] + rise, out=ground[:-step])
            left, step = left - step, 2 * step
        ground = np.moveaxis(ground, 0, axis)
    return ground


def seen_above_ground(
    pixels: tuple[Ints, Ints],
    bounds: tuple[Floats, Floats],
    state: NDArray[np.int8],
    shape: tuple[int, int],
    pixel: float,
    band: tuple[float, float, float],
) -> NDArray[np.int8]:
    """A grid of what is between two heights above the ground.

    `pixels` (first, last): First pixel (x, y) of each known cell, and those behind the last; inside the grid.
    `bounds` (bottom, top): Of each cell, (n,) each [m].
    `state` (n,): 0 free, 1 occupied, 2 in a large cell.
    `shape`: (rows, columns).
    `pixel`: Edge of a pixel [m].
    `band` (low, high, slope): Heights above the ground [m], and how steep that is, as for `ground_below`.
    Returns (rows, columns) int8: 100 where some occupied cell overlaps low <= height < high, else `LARGE`
    where a large one does, else 0 where a free one does, else -1.
    """
    bottom, top = bounds
    low, high, slope = band
    at, which = pixels_in(*pixels, shape[1])
    levels = np.full(shape[0] * shape[1], np.inf)
    np.minimum.at(levels, at, np.where(state > 0, top, bottom)[which])
    ground = ground_below(levels.reshape(shape), pixel, slope).ravel()[at]
    within = 1e-6 * pixel
    inside = (top[which] > ground + low + within) & (bottom[which] < ground + high - within)
    values = np.full(shape[0] * shape[1], UNKNOWN, dtype=np.int8)
    for one, value in ((0, FREE), (2, LARGE), (1, OCCUPIED)):
        values[at[inside & (state[which] == one)]] = value
    return values.reshape(shape)
