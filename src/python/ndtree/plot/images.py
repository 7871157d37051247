# SPDX-License-Identifier: BSD-3-Clause
"""Leaves in the plane: their borders as lines, their occupancy as an image without lost cells."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.image import AxesImage
from numpy.typing import NDArray

from ndtree.cells.lattice import Cells, Floats, Integers
from ndtree.cells.raster import pixel_parts
from ndtree.cells.regions import picture_region
from ndtree.plot.figures import BORDER_COLOR, STATE_COLORS, UNKNOWN, Region, framed

MAX_IMAGE_CELLS = 16_000_000
_GREYS = LinearSegmentedColormap.from_list(
    "states", [STATE_COLORS[state] for state in ("free", "unknown", "occupied")], N=257
)


def draw_borders(
    every: Cells, ax: Axes, region: Region | None, color: str = BORDER_COLOR, linewidth: float = 0.35
) -> Axes:
    region = tuple(region) if region is not None else picture_region(every)
    shown = every.inside(region)
    lines = []
    for along in (0, 1):
        for level in (shown.lower, shown.upper):
            across = 1 - along
            lines.append(np.stack([level[:, across], shown.lower[:, along], shown.upper[:, along]], axis=1))
        merged = _joined(np.concatenate(lines[-2:])) * every.unit
        points = np.empty((len(merged), 2, 2))
        points[:, :, 1 - along] = merged[:, :1]
        points[:, :, along] = merged[:, 1:]
        ax.add_collection(LineCollection(points, colors=color, linewidths=linewidth), autolim=False)
    return framed(ax, region)


def _joined(lines: Integers) -> Integers:
    """Segments (at, from, to), with those that touch or overlap on one line made one."""
    lines = lines[np.lexsort((lines[:, 1], lines[:, 0]))]
    at, start, stop = lines.T
    line = np.cumsum(np.diff(at, prepend=at[0]) != 0)
    span = int(stop.max() - start.min()) + 1
    # Shifted by more than any length, each line's ends rise above those of the line before.
    reach = np.maximum.accumulate(stop - start.min() + line * span)
    first = np.ones(len(at), dtype=np.bool_)
    first[1:] = (start[1:] - start.min() + line[1:] * span) > reach[:-1]
    first[1:] |= line[1:] != line[:-1]
    begins = np.flatnonzero(first)
    ends = np.append(begins[1:], len(at)) - 1
    return np.stack([at[begins], start[begins], reach[ends] - line[begins] * span + start.min()], axis=1)


def draw_occupancy(every: Cells, ax: Axes, region: Region | None, color: str = "state") -> Axes:
    """Occupied black, free white, unknown grey; with the color "probability", what is between in between."""
    if color not in ("state", "probability"):
        raise ValueError(f"color = {color!r}: must be state or probability")
    region = tuple(region) if region is not None else picture_region(every)
    seen = every.where(every.observed)
    if color == "probability":  # Unknown is the middle, and the extremes are: no clamp leaves black grey.
        low, high = min(seen.probability.min(), 0.499), max(seen.probability.max(), 0.501)
        level = np.interp(seen.probability, (low, UNKNOWN, high), (0.0, UNKNOWN, 1.0))
    else:
        level = np.where(seen.occupied, 1.0, np.where(seen.free, 0.0, 0.5))
    seen = replace(seen, probability=level)
    image, extent = image_of(seen.inside(region), region)
    ax.set_facecolor(STATE_COLORS["unknown"])
    drawn = PooledImage(ax, _most_occupied, cmap=_GREYS, norm=Normalize(0.0, 1.0), extent=extent)
    drawn.set_data(image)
    ax.add_image(drawn)
    return framed(ax, region)


class PooledImage(AxesImage):
    """An image drawn in pixels no smaller than those of the picture, each made of all that are in it."""

    def __init__(self, ax: Axes, pool: Callable[[Any], Any], *, extent: Sequence[float], **more: Any) -> None:
        super().__init__(ax, origin="lower", extent=extent, interpolation="nearest", **more)
        self._pool = pool
        self.set_clip_path(ax.patch)

    def draw(self, renderer: Any) -> None:
        if not self.get_visible():
            return
        whole = self.get_array()
        left, right, bottom, top = self.get_extent()
        ends = self.axes.transData.transform([(left, bottom), (right, top)])
        pixels = np.abs(ends[1] - ends[0]) * renderer.get_image_magnification()
        steps = [max(1, math.ceil(n / max(p, 1.0) - 1e-6)) for n, p in zip(whole.shape, pixels[::-1])]
        if steps == [1, 1]:
            super().draw(renderer)
            return
        rows, columns = (-(-n // step) for n, step in zip(whole.shape, steps))
        missing = [(0, n * step - old) for n, step, old in zip((rows, columns), steps, whole.shape)]
        padded = np.pad(np.ma.filled(whole, np.nan), missing, constant_values=np.nan)
        pooled = self._pool(padded.reshape(rows, steps[0], columns, steps[1]))
        wide = (right - left) * columns * steps[1] / whole.shape[1]
        high = (top - bottom) * rows * steps[0] / whole.shape[0]
        try:
            self.set_data(pooled)
            self.set_extent((left, left + wide, bottom, bottom + high))
            super().draw(renderer)
        finally:
            self.set_data(whole)
            self.set_extent((left, right, bottom, top))
            self.stale = False


def _most_occupied(blocks: Floats) -> Floats:
    """Of each block of pixels the most occupied, else the freest, else unknown; nan is beyond the map."""
    most, least = np.fmax.reduce(np.fmax.reduce(blocks, 3), 1), np.fmin.reduce(np.fmin.reduce(blocks, 3), 1)
    return np.where(most > UNKNOWN, most, least)


def smallest_of(blocks: Floats) -> Floats:
    return np.ma.masked_invalid(np.fmin.reduce(np.fmin.reduce(blocks, 3), 1))


def image_of(
    shown: Cells, region: Region, empty: float = UNKNOWN
) -> tuple[NDArray[np.float32], tuple[float, float, float, float]]:
    """Probabilities, a pixel for each smallest cell; for vast regions pixels are larger and show the largest.

    Returns the image, and where its borders are [m].
    """
    low = np.floor(np.asarray(region[0::2]) / shown.unit).astype(np.int64)
    high = np.ceil(np.asarray(region[1::2]) / shown.unit).astype(np.int64)
    step = max(1, math.ceil(math.sqrt(float(np.prod((high - low).astype(np.float64))) / MAX_IMAGE_CELLS)))
    while int(np.prod(-(-(high - low) // step).astype(np.float64))) > MAX_IMAGE_CELLS:
        step *= 2  # One row of cells is one of pixels, however long it is.
    width, height = (int(n) for n in -(-(high - low) // step))
    image = np.full((height, width), -1.0, dtype=np.float32)
    flat = image.reshape(-1)
    begin = np.clip((shown.lower - low) // step, 0, (width, height))
    end = np.clip(-(-(shown.upper - low) // step), 0, (width, height))
    for at, which in pixel_parts(begin, end, width):
        np.maximum.at(flat, at, shown.probability[which, None].astype(np.float32))
    image[image < 0] = empty
    left, bottom = low * shown.unit
    extent = (left, left + width * step * shown.unit, bottom, bottom + height * step * shown.unit)
    return image, extent
