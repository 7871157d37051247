# SPDX-License-Identifier: BSD-3-Clause
"""What notebooks show of a map: its numbers and a small picture, made with NumPy alone."""

from __future__ import annotations

import base64
import html as escaping
import struct
import zlib
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ndtree.cells.lattice import Cells, Integers
from ndtree.cells.raster import pixels_in
from ndtree.cells.regions import ceiling, found_region, observed_region
from ndtree.maps.writers.mesh import height_colors

if TYPE_CHECKING:
    from ndtree._native._core import OccupancyMap

LONGER_SIDE = 320  # [pixels]
_GREY = np.array([205, 254, 0], dtype=np.uint8)  # Unknown, free, occupied.


def png(m: OccupancyMap) -> bytes | None:
    """A small picture as PNG; None of a map in which nothing is known, and of one in four dimensions.

    In the plane as map_server has it: occupied black, free white, unknown grey; what is smaller than a pixel
    is drawn as one, occupied before free. In space the occupied cells from above, in the colors of their
    height, without the ceiling.
    """
    if m.dim not in (2, 3) or not m.stats().observed_leaves:
        return None
    cells = Cells.of(m)
    region = observed_region(cells) if m.dim == 2 else found_region(cells)
    cells = cells.where(cells.known if m.dim == 2 else cells.occupied).inside(region)
    if m.dim == 3 and len(cells):
        cut = ceiling(cells)
        cells = cells if cut is None else cells.where(cells.upper[:, 2] * cells.unit <= cut)
    if not len(cells):
        return None
    if m.dim == 2:
        return encoded(_enlarged(_GREY[1 + _highest(cells, cells.state, region)]))
    heights = _highest(cells, cells.upper[:, 2] - cells.upper[:, 2].min(), region)
    image = np.full((*heights.shape, 3), 255, dtype=np.uint8)
    image[heights >= 0] = height_colors(heights[heights >= 0].astype(np.float64))[:, :3]
    return encoded(_enlarged(image))


def html(m: OccupancyMap) -> str:
    """A table of the map's numbers, with the picture."""
    stats = m.stats()
    rows = {"cells": f"{stats.observed_leaves:,} observed", "memory": f"{stats.memory_bytes / 1e6:,.2f} MB"}
    options = m.options
    low, high = options["min_cell_size"], options.get("max_cell_size")
    rows["cell size"] = f"{low:g} m" if high is None or high == low else f"{low:g} to {high:g} m"
    name = f"{type(m).__name__}, {m.dim}-D"
    lines = [f'<tr><th colspan="2" style="text-align:left">{escaping.escape(name)}</th></tr>']
    lines += [f"<tr><td>{key}</td><td>{escaping.escape(value)}</td></tr>" for key, value in rows.items()]
    drawn = png(m)
    image = ""
    if drawn is not None:
        data = base64.b64encode(drawn).decode("ascii")
        image = f'<img alt="{escaping.escape(name)}" src="data:image/png;base64,{data}">'
    return f'<div style="display:flex;gap:1em"><table>{"".join(lines)}</table>{image}</div>'


def encoded(image: NDArray[np.uint8]) -> bytes:
    """PNG of an image (rows, columns), grey, or (rows, columns, 3); the first row is the upper one."""
    rows, columns = image.shape[:2]
    color = 2 if image.ndim == 3 else 0
    lines = np.zeros((rows, 1 + image[0].size), dtype=np.uint8)  # Each begins with its filter, none.
    lines[:, 1:] = image.reshape(rows, -1)
    head = struct.pack(">IIBBBBB", columns, rows, 8, color, 0, 0, 0)
    chunks = ((b"IHDR", head), (b"IDAT", zlib.compress(lines.tobytes(), 6)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in chunks
    )


def _enlarged(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Small ones by a whole factor."""
    factor = max(1, LONGER_SIDE // max(image.shape[:2]))
    return image.repeat(factor, axis=0).repeat(factor, axis=1)


def _highest(cells: Cells, values: Integers | NDArray[np.int8], region: Sequence[float]) -> Integers:
    """(rows, columns) of a region, y upwards: the highest value, >= 0, of the cells in a pixel; else -1."""
    low, high = np.array(region[:4]).reshape(2, 2).T / cells.unit  # [smallest cells]
    pixel = max(1.0, float((high - low).max()) / LONGER_SIDE)
    columns, rows = (max(1, int(n)) for n in np.ceil((high - low) / pixel - 1e-6))
    lower = cells.lower[:, :2]
    begin = np.clip(np.floor((lower - low) / pixel), 0, (columns - 1, rows - 1)).astype(np.int64)
    end = np.clip(np.ceil((lower + cells.size[:, None] - low) / pixel), 1, (columns, rows))
    highest = np.full((rows, columns), -1, dtype=np.int64)
    at, which = pixels_in(begin, end.astype(np.int64), columns)
    np.maximum.at(highest.reshape(-1), at, values[which])
    return highest[::-1]
