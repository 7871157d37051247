# SPDX-License-Identifier: BSD-3-Clause
"""What a page draws: boxes, and what tells how large a map is: a grid below it, its axes, a scale bar."""

from __future__ import annotations

from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray

from ndtree.cells.lattice import Floats, Integers, Pyramid
from ndtree.plot.colors import round_length

_GREY, _LINE, _FINE = (40, 40, 40), (150, 150, 150), (210, 210, 210)
_SQUARES = 12  # Of the grid along the longer side, about.
_WORDS = 1.0  # Beside the grid, what they take of a square.
_BAR = 0.25  # Share of the longer side that the scale bar takes at most.


def framed(lower: Floats, upper: Floats) -> tuple[Floats, Floats]:
    """A box and what is drawn around it, as a box: the grid, the scale bar and the words beside them."""
    step, begin, end = _grid_of(lower, upper)
    beside = _WORDS * step
    return np.append(begin - (0.0, beside), lower[2]), np.append(end + beside, upper[2])


def _grid_of(lower: Floats, upper: Floats) -> tuple[float, Floats, Floats]:
    """Side of a square of the grid, and the grid's corners (2,), (2,)."""
    extent = upper[:2] - lower[:2]
    step = round_length(max(float(extent.max()) / _SQUARES, 1e-3))
    return step, np.floor(lower[:2] / step) * step, np.ceil(upper[:2] / step) * step


def draw_frame(scene: viser.SceneApi, lower: Floats, upper: Floats) -> list[Any]:
    """Draw them around a box in the page's frame (3,), (3,) [m]; what can be removed again."""
    step, begin, end = _grid_of(lower, upper)
    below = float(lower[2]) - 0.01 * step
    wide, high = (float(side) for side in end - begin)
    middle = 0.5 * (begin + end)
    handles: list[Any] = [
        scene.add_grid(
            "/frame/grid",
            wide,
            high,
            cell_size=step,
            cell_color=_FINE,
            section_size=5 * step,
            section_color=_LINE,
            fade_distance=1e6,
            shadow_opacity=0.0,
            position=(float(middle[0]), float(middle[1]), below),
        )
    ]
    length = round_length(_BAR * max(wide, high))
    corner = np.array([begin[0], begin[1] - 0.5 * step, below])
    tick = np.array([0.0, 0.15 * step, 0.0])
    along = np.array([length, 0.0, 0.0])
    bar = [(corner, corner + along), (corner - tick, corner + tick)]
    bar.append((corner + along - tick, corner + along + tick))
    handles.append(
        scene.add_line_segments(
            "/frame/scale", np.array(bar, dtype=np.float32), _GREY, thickness=3.0, thickness_units="screen"
        )
    )
    words = {
        f"{length:g} m": corner + 0.5 * along - (0.0, 0.2 * step, 0.0),
        "x": np.array([end[0] + 0.3 * step, begin[1], below]),
        "y": np.array([begin[0], end[1] + 0.3 * step, below]),
    }
    for text, at in words.items():
        position = tuple(float(value) for value in at)
        handles.append(scene.add_label(f"/frame/{text}", text, position=position, anchor="top-center"))
    return handles


#: The page takes instances' colors as amounts of light, not as what a screen is told.
_LINEAR = np.rint(255 * (np.arange(256) / 255) ** 2.2).astype(np.uint8)
_CUBE = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
_CUBE_FACES = np.array(
    [
        *((0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1)),
        *((2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)),
    ]
)


def drawn_boxes(pyramid: Pyramid, chosen: Integers, flat_axis: int | None, lift: float) -> dict[str, Any]:
    """What the page needs to draw boxes: one cube or tile, and where and how large it is each time."""
    lower, upper = pyramid.lower[chosen], pyramid.upper[chosen]
    positions, scales = 0.5 * (lower + upper), upper - lower
    vertices, faces = _CUBE, _CUBE_FACES
    if flat_axis is not None:
        vertices = np.zeros((4, 3))
        across = [a for a in range(3) if a != flat_axis]
        vertices[:, across] = ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))
        faces = np.array([(0, 1, 2), (0, 2, 3)])
        scales[:, flat_axis] = 1.0
        positions[:, flat_axis] += lift
    wxyzs = np.zeros((len(chosen), 4), dtype=np.float32)
    wxyzs[:, 0] = 1.0
    return {
        "vertices": vertices.astype(np.float32),
        "faces": faces.astype(np.uint32),
        "batched_wxyzs": wxyzs,
        "batched_positions": positions.astype(np.float32),
        "batched_scales": scales.astype(np.float32),
        "batched_colors": _LINEAR[pyramid.colors[chosen]],
    }


def edges_of(lower: Floats, upper: Floats) -> NDArray[np.float32]:
    """The edges of a box: (12, 2, 3)."""
    corners = np.where(_CUBE > 0, upper, lower)
    pairs = [(i, j) for i in range(8) for j in range(i) if np.count_nonzero(_CUBE[i] != _CUBE[j]) == 1]
    return corners[np.array(pairs)].astype(np.float32)
