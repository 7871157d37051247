# SPDX-License-Identifier: BSD-3-Clause
"""Depth images: a pixel with a depth is a measured point, one without says nothing."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import lru_cache
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from ndtree._errors import WrongValue, key
from ndtree._lazy import needs
from ndtree._native._core import depth_points
from ndtree.base.words import numbers_in
from ndtree.logs.core.arrays import Floats
from ndtree.logs.core.plain_file import open_regular

ENDINGS = (".png", ".pgm")
#: More pixels are no depth camera's.
_MOST_PIXELS = 1 << 25
_PGM_HEADER = 1 << 12
_PNG = b"\x89PNG\r\n\x1a\n"
_GAP = rb"(?:\s|#[^\n]*\n)+"
_PGM = re.compile(rb"P5" + _GAP + rb"(\d{1,9})" + _GAP + rb"(\d{1,9})" + _GAP + rb"(\d{1,9})\s")


@dataclass(frozen=True)
class Camera:
    """A pinhole camera whose image holds depths along its optical axis, z.

    `fx`, `fy`: Focal lengths [px], fx > 0; fy < 0 where the first row of the image is its lowest.
    `cx`, `cy`: Principal point [px]; the middle of the first pixel is (0, 0).
    """

    fx: float
    fy: float
    cx: float
    cy: float
    scale: float = 1.0  # Image values in a metre, > 0.

    def __post_init__(self) -> None:
        for name in ("fx", "fy", "scale"):
            value = getattr(self, name)
            if not ((value > 0 or (name == "fy" and value < 0)) and math.isfinite(value)):
                limit = "not 0" if name == "fy" else "> 0"
                raise ValueError(f"{name} = {value:g} of the camera: must be {limit} and finite")
        for name in ("cx", "cy"):
            if not math.isfinite(getattr(self, name)):
                raise ValueError(f"{name} = {getattr(self, name):g} of the camera: must be finite")


def camera_of(text: str, *, scale: float) -> Camera:
    """Of ``"fx,fy,cx,cy,scale"``, or of ``"fx,fy,cx,cy"`` and a scale; ValueError of something else."""
    numbers = numbers_in(text)
    if len(numbers) not in (4, 5):
        raise WrongValue(f"{key('camera')} = {text!r}: expected fx,fy,cx,cy or fx,fy,cx,cy,scale")
    return Camera(*numbers[:4], scale=numbers[4] if len(numbers) == 5 else scale)


def points_of(
    image: NDArray[Any], camera: Camera, *, pixel_stride: int = 1, no_depth: tuple[int, ...] = ()
) -> Floats:
    """Points that a depth image measured.

    `image` (ndarray, (rows, columns)): Integers or floats, ``camera.scale`` a metre. Zero, negative and not
        finite values are no depth.
    `pixel_stride`: Of each block of this many rows and columns, its middle pixel is used; >= 1.
    `no_depth`: Further values that are no depth.
    Returns ndarray of float64, (n, 3): In the camera's frame [m]: x to the right, y down, z ahead. Row by
    row.
    """
    x, y = _rays(camera, image.shape, pixel_stride)
    first = pixel_stride // 2
    values = image[first::pixel_stride, first::pixel_stride]
    return depth_points(values, x, y, 1.0 / camera.scale, no_depth)


@lru_cache(maxsize=4)
def _rays(camera: Camera, shape: tuple[int, int], pixel_stride: int) -> tuple[Floats, Floats]:
    """x of columns and y of rows at a depth of one image value [m]."""
    first = pixel_stride // 2
    v, u = (np.arange(first, n, pixel_stride).astype(np.float64) for n in shape)
    x, y = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
    return x / camera.scale, y / camera.scale


def load_depth(path: str) -> NDArray[np.uint16]:
    """The depth image in a file, PNG or binary PGM, of one channel of 16 bits."""
    with open_regular(path) as file:
        return _pgm_pixels(file, path) if path.lower().endswith(".pgm") else png_pixels(file, path)


def _pgm_pixels(file: IO[bytes], where: str) -> NDArray[np.uint16]:
    """A binary PGM's own values, whatever the largest is said to be."""
    content = file.read(2 * _MOST_PIXELS + _PGM_HEADER)
    header = _PGM.match(content[:_PGM_HEADER])
    if header is None:
        raise ValueError(f"{where}: not a binary PGM, expected one of 16 bits")
    columns, rows, largest = (int(number) for number in header.groups())
    _check_size(where, columns, rows)
    if not 255 < largest < 65536:
        raise ValueError(f"{where}: found a PGM of values up to {largest}, expected one of 16 bits")
    if len(content) - header.end() < 2 * rows * columns:
        raise ValueError(f"{where}: the PGM is cut off, expected {columns} x {rows} pixels")
    values = np.frombuffer(content, ">u2", rows * columns, header.end())
    return values.reshape(rows, columns).astype(np.uint16)


def _check_size(where: str, columns: int, rows: int) -> None:
    """Refuses images that no depth camera makes, and whose points would take gigabytes."""
    if columns * rows > _MOST_PIXELS:
        raise ValueError(f"{where}: {columns} x {rows} pixels, expected at most {_MOST_PIXELS}")


def png_pixels(file: IO[bytes], where: str) -> NDArray[np.uint16]:
    """A depth image of one channel in a PNG of 16 bits a pixel, (rows, columns); errors call it `where`.

    Raises ImportError if Pillow is not there; ValueError if it is no such image, or damaged.
    """
    with needs("depth images in PNG need Pillow", "clouds"):
        from PIL.PngImagePlugin import PngImageFile
    expected = "expected a PNG of one channel of 16 bits"
    try:
        if file.read(len(_PNG)) != _PNG:
            raise ValueError(f"{where}: not a PNG, {expected}")
        file.seek(0)
        with PngImageFile(file) as image:
            _check_size(where, *image.size)
            # Pillow names 16 bits "I;16", and before version 10.3 widened them to "I".
            if image.mode not in ("I;16", "I;16B", "I"):
                raise ValueError(f"{where}: found an image of mode {image.mode}, {expected}")
            return np.asarray(image).astype(np.uint16)
    except (OSError, SyntaxError, EOFError) as error:
        raise ValueError(f"{where}: the PNG is damaged ({error}), expected a whole one") from None
