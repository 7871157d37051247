# SPDX-License-Identifier: BSD-3-Clause
"""Many parallelograms as one image, at the resolution of whatever it is drawn on."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.image import AxesImage
from numpy.typing import NDArray

_SAMPLES = 2  # Rows and columns of samples in a pixel.
_AT_ONCE = 1 << 18  # Samples that are looked at in one go.


class FacesImage(AxesImage):
    """Parallelograms in the coordinates of axes, each over those before it, with a darker border.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
        That they are drawn in, linear along both.
    corners : (n, 3, 2) float32
        Of each a corner, and the two beside it.
    fills : (n, 3) float32
        Red, green and blue of each, from 0 to 1.
    border : float
        Brightness of the borders, of that of a face.
    linewidth : float
        Of the borders, of which half lies beyond the edge [points].
    """

    def __init__(
        self,
        ax: Axes,
        corners: NDArray[np.float32],
        fills: NDArray[np.float32],
        border: float,
        linewidth: float,
    ) -> None:
        super().__init__(ax)
        self._corners, self._fills, self._border, self._linewidth = corners, fills, border, linewidth
        self.set_data(np.zeros((1, 1, 4), dtype=np.uint8))  # Something, or nothing is drawn.

    def get_window_extent(self, renderer: Any = None) -> Any:
        """All of the axes."""
        return self.axes.bbox

    def make_image(self, renderer: Any, magnification: float = 1.0, unsampled: bool = False) -> Any:
        """As of `AxesImage`: pixels (rows from below, columns, 4), and where the lower left one is."""
        box = self.axes.bbox
        left, bottom = np.floor(box.p0)
        width, height = np.ceil((box.p1 - (left, bottom)) * magnification).astype(int)
        scale = _SAMPLES * magnification
        to_pixels = self.axes.transData.get_matrix()
        pixels_a_metre = to_pixels.diagonal()[:2]
        corners = self._corners - (((left, bottom) - to_pixels[:2, 2]) / pixels_a_metre).astype(np.float32)
        corners *= (scale * pixels_a_metre).astype(np.float32)
        line = 0.5 * renderer.points_to_pixels(self._linewidth) * scale
        seen = _front(corners, _SAMPLES * width, _SAMPLES * height, line)
        return _colored(seen, self._fills, self._border), left, bottom, None


def _front(corners: NDArray[np.float32], width: int, height: int, line: float) -> NDArray[np.int32]:
    """Twice the number of the last face over each pixel, from 1; less 1 on its border; 0 without any."""
    seen = np.zeros(height * width, dtype=np.int32)
    low = corners.min(axis=1)
    fourth = corners[:, 1] + corners[:, 2] - corners[:, 0]
    np.minimum(low, fourth, out=low)
    high = np.maximum(corners.max(axis=1), fourth)
    # Pixels whose middle is in the box around a face: these are tried.
    first = np.clip(np.ceil(low - 0.5 - line), 0, (width, height)).astype(np.int32)
    count = np.clip(np.floor(high - 0.5 + line) + 1, 0, (width, height)).astype(np.int32) - first
    there = np.flatnonzero((count > 0).all(axis=1))
    edge = np.ceil(np.log2(count[there])).astype(np.uint16)  # Of the boxes, rounded up: alike ones in one go.
    kind = 32 * edge[:, 0] + edge[:, 1]
    by_kind = np.argsort(kind, kind="stable")
    for same in np.split(by_kind, np.flatnonzero(np.diff(kind[by_kind])) + 1) if len(there) else ():
        step = max(1, _AT_ONCE >> int(edge[same[0]].sum()))
        for begin in range(0, len(same), step):
            some = there[same[begin : begin + step]]
            _paint(seen.reshape(height, width), some, corners[some], first[some], count[some], line)
    return seen.reshape(height, width)


def _paint(
    seen: NDArray[np.int32],
    number: NDArray[np.intp],
    corners: NDArray[np.float32],
    first: NDArray[np.int32],
    count: NDArray[np.int32],
    line: float,
) -> None:
    """Faces, the last on top, and half of their borders, `line` wide, into pixels from the `first` on."""
    width, height = count.max(axis=0)
    x = np.arange(width, dtype=np.float32) + (first[:, :1] + np.float32(0.5) - corners[:, 0, :1])
    y = np.arange(height, dtype=np.float32) + (first[:, 1:] + np.float32(0.5) - corners[:, 0, 1:])
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]
    area[area == 0] = np.nan  # Seen from its side: nothing is inside.

    def across(edge: NDArray[np.float32]) -> NDArray[np.float32]:
        """How far from an edge to the opposite one: 0 to 1, or to -1."""
        weight = edge / area[:, None]
        return (x * weight[:, 1:])[:, None, :] - (y * weight[:, :1])[:, :, None]

    u, v = np.abs(across(two) - 0.5), np.abs(across(one) + 0.5)
    # Half of a border, across each pair of edges.
    line_u, line_v = (line * np.hypot(*edge.T) / np.abs(area) for edge in (two, one))
    face, row, column = inside = np.nonzero(
        (u <= (0.5 + line_u)[:, None, None]) & (v <= (0.5 + line_v)[:, None, None])
    )
    is_inner = (u[inside] < 0.5 - line_u[face]) & (v[inside] < 0.5 - line_v[face])
    kept = (row < count[face, 1]) & (column < count[face, 0])  # Others have larger boxes.
    value = (2 * number[face] + 1 + is_inner).astype(np.int32)[kept]
    pixel = ((row + first[face, 1]) * seen.shape[1] + column + first[face, 0])[kept]
    flat = seen.reshape(-1)
    nearer = value > flat[pixel]
    flat[pixel[nearer]] = value[nearer]  # Of several the last: numbers ascend.


def _colored(seen: NDArray[np.int32], fills: NDArray[Any], border: float) -> NDArray[np.uint8]:
    """Pixels (rows, columns, 4) in the mean color of their samples."""
    height, width = (edge // _SAMPLES for edge in seen.shape)
    total = np.zeros((height, width, 3), dtype=np.float32)
    covered = np.zeros((height, width), dtype=np.float32)
    colors = np.concatenate([border * fills, fills], axis=1).astype(np.float32).reshape(-1, 3)
    colors = np.concatenate([np.zeros((1, 3), dtype=np.float32), colors])
    for i in range(_SAMPLES):
        for j in range(_SAMPLES):
            some = seen[i::_SAMPLES, j::_SAMPLES]
            total += colors[some]
            covered += some > 0
    pixels = np.empty((height, width, 4), dtype=np.uint8)
    pixels[..., :3] = np.rint(255 * total / np.maximum(covered, 1)[..., None])
    pixels[..., 3] = np.rint(255 * covered / _SAMPLES**2)
    return pixels
