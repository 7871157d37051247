# SPDX-License-Identifier: BSD-3-Clause
"""Many faces as an image: what a collection of polygons shows, in a fraction of its time and memory."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.image import AxesImage
from numpy.typing import NDArray

from ndtree.cells.lattice import Integers

OUTLINE = 0.8  # Brightness of a face's border, of that of the face.
_OUTLINED = 3.0  # Faces less wide have no border [pixels].
_BORDER = 0.35  # Its width [pixels].
_AT_ONCE = 200_000  # Pixels that are asked whether they are in a face.


class FacesImage(AxesImage):
    """Parallelograms, those in front behind the others in the list, in pixels of the picture."""

    def __init__(self, ax: Axes, quads: NDArray[Any], colors: NDArray[Any]) -> None:
        """Quads (n, 4, 2) have neighbouring corners beside each other, colors (n, 3) are from 0 to 1."""
        super().__init__(ax, origin="lower", interpolation="nearest")
        self._quads, self._colors = quads, np.rint(255 * colors).astype(np.uint8)
        self._painted: tuple[Any, NDArray[np.uint8]] | None = None
        self.set_data(np.zeros((1, 1, 4), dtype=np.uint8))
        self.set_clip_path(ax.patch)

    def draw(self, renderer: Any) -> None:
        """Paints anew where the limits of the axes, or their size in the picture, have changed."""
        if not self.get_visible():
            return
        limits = (*self.axes.get_xlim(), *self.axes.get_ylim())
        zoom = renderer.get_image_magnification()
        shape = tuple(max(1, round(zoom * n)) for n in (self.axes.bbox.height, self.axes.bbox.width))
        if self._painted is None or self._painted[0] != (limits, shape):
            self._painted = ((limits, shape), painted(self._quads, self._colors, limits, shape))
        self.set_data(self._painted[1])
        self.set_extent(limits)
        super().draw(renderer)


def painted(
    quads: NDArray[Any], colors: NDArray[np.uint8], limits: tuple[float, ...], shape: tuple[int, ...]
) -> NDArray[np.uint8]:
    """An image (rows, columns, 4) of faces within limits, lowest row first: the last at each pixel's middle.

    A face so small that it has no pixel's middle in it is drawn as one pixel.
    """
    rows, columns = shape
    scale = np.array([columns / (limits[1] - limits[0]), rows / (limits[3] - limits[2])], dtype=np.float32)
    corners = (quads - np.array(limits[0::2], dtype=np.float32)) * scale
    begin, extent, is_tiny = _pixels_of(corners, columns, rows)
    shown = np.full(rows * columns, -1, dtype=np.int32)  # Twice the face's number, and 1 more on its border.
    kind = extent[:, 0].astype(np.int64) * (rows + 1) + extent[:, 1]
    order = np.argsort(kind, kind="stable")
    for alike in np.split(order, np.flatnonzero(np.diff(kind[order])) + 1):
        width, height = extent[alike[0]] if len(alike) else (0, 0)
        if width * height == 0:
            continue
        offsets = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).reshape(-1, 2)
        for part in np.array_split(alike, -(-len(alike) * len(offsets) // _AT_ONCE)):
            pixels = begin[part, None] + offsets
            inside, on_border = _within(corners[part], pixels)
            inside |= is_tiny[part, None]
            number = np.where(on_border, 2 * part[:, None] + 1, 2 * part[:, None])[inside]
            at = (pixels[..., 1] * columns + pixels[..., 0])[inside]
            nearer = number > shown[at]
            shown[at[nearer]] = number[nearer]  # In order: of those at one pixel, the last is the nearest.
    return _colored(shown, colors).reshape(rows, columns, 4)


def _pixels_of(corners: NDArray[Any], columns: int, rows: int) -> tuple[NDArray[np.int32], ...]:
    """First pixel and number of pixels along each axis of each face, and whether no middle is in it."""
    begin, extent = np.empty((2, len(corners), 2), dtype=np.int32)
    is_tiny = np.zeros(len(corners), dtype=np.bool_)
    for k, count in enumerate((columns, rows)):
        along = corners[:, :, k]
        least = np.minimum(np.minimum(along[:, 0], along[:, 1]), np.minimum(along[:, 2], along[:, 3]))
        most = np.maximum(np.maximum(along[:, 0], along[:, 1]), np.maximum(along[:, 2], along[:, 3]))
        first, last = np.ceil(np.clip([least, most], -1, count + 1) - 0.5).astype(np.int32)
        is_tiny |= last <= first
        begin[:, k], extent[:, k] = first, last
    begin[is_tiny] = np.floor(np.clip(corners[is_tiny].mean(axis=1), -1, (columns, rows))).astype(np.int32)
    extent[is_tiny] = begin[is_tiny] + 1
    for k, count in enumerate((columns, rows)):
        np.clip(begin[:, k], 0, count, out=begin[:, k])
        np.clip(extent[:, k], 0, count, out=extent[:, k])
    extent -= begin
    return begin, extent, is_tiny


def _within(corners: NDArray[Any], pixels: Integers) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which pixels' middles are in a face, and which are on the border of one that is wide enough."""
    one, two = corners[:, 1] - corners[:, 0], corners[:, 3] - corners[:, 0]
    area = one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]
    area = np.where(area == 0, np.float32(1e-30), area)[:, None]
    x, y = np.moveaxis(pixels + np.float32(0.5) - corners[:, None, 0], 2, 0).astype(np.float32)
    s = (x * two[:, None, 1] - y * two[:, None, 0]) / area
    t = (y * one[:, None, 0] - x * one[:, None, 1]) / area
    inside = (s >= 0) & (s < 1) & (t >= 0) & (t < 1)
    wide = [np.abs(area) / np.maximum(np.hypot(*edge.T), 1e-30)[:, None] for edge in (two, one)]
    near = np.minimum(np.minimum(s, 1 - s) * wide[0], np.minimum(t, 1 - t) * wide[1])
    return inside, (near < _BORDER) & (np.minimum(*wide) > _OUTLINED)


def _colored(shown: NDArray[np.int32], colors: NDArray[np.uint8]) -> NDArray[np.uint8]:
    image = np.zeros((len(shown), 4), dtype=np.uint8)
    is_face = shown >= 0
    image[is_face, 3] = 255
    image[is_face, :3] = colors[shown[is_face] >> 1]
    is_border = is_face & (shown & 1 == 1)
    image[is_border, :3] = np.rint(OUTLINE * image[is_border, :3])
    return image
