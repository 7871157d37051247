# SPDX-License-Identifier: BSD-3-Clause
"""Images that ROS's map_server and nav2 read as maps: a YAML file, and a PGM or PNG that it names."""

from __future__ import annotations

import math
import os
import struct
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from ndtree._lazy import needs
from ndtree.base.words import number_of
from ndtree.logs.core.failures import one_line, shown
from ndtree.logs.core.plain_file import open_regular

_NEEDS = "map_server's files need PyYAML and Pillow"
#: Far more than anybody's file about an image has.
_MOST_YAML = 1 << 16
_MOST_NESTED = 8
#: Edge of a pixel [m]: anything else is another unit, or damage.
_SMALLEST, _LARGEST = 1e-4, 1e3
#: Pillow reads others, too, some of them by calling programs.
_IMAGES = ("PPM", "PNG", "BMP", "GIF", "JPEG", "TIFF")
_MOST_PIXELS = 178_956_970  # As Pillow's usual bound.
_ROWS_AT_ONCE = 256
_WITH_ALPHA = ("RGBA", "LA", "PA", "La", "RGBa")
#: Yaws of less turn no image by as much as a pixel [rad].
_STRAIGHT = 1e-6
#: The grey of unknown pixels in images of ROS 1, and the threshold above which they are not free.
_UNKNOWN, _UNKNOWN_ABOVE = 205, 0.196


@dataclass(frozen=True)
class MapImage:
    """What an image says.

    `states` (columns, rows) int8: -1 unknown, 0 free, 1 occupied; the first axis is x, the second y.
    `lower` (2,) float64: Lower corner of the first [m].
    """

    states: NDArray[np.int8]
    lower: NDArray[np.float64]
    cell_size: float  # [m]
    notes: tuple[str, ...]  # What a user should know of how it was read, a line each.


def map_image(name: str) -> MapImage:
    """Read an image of map_server's by the thresholds of its YAML file, which count as reached.

    `name`: Its YAML file.
    Raises OSError, ValueError, ImportError as `ndtree.maps.open.open_map`.
    """
    entries = _entries(name)
    if "image" not in entries:
        raise ValueError(f"{name}: no 'image', expected the YAML file of a map_server map")
    image = entries["image"]
    if not isinstance(image, str) or not image or "\0" in image:
        raise ValueError(f"{name}: image: found {shown(repr(image))}, expected the name of a file")
    size = _number(name, entries, "resolution")
    if not _SMALLEST <= size <= _LARGEST:
        raise ValueError(
            f"{name}: resolution: found {size:g}, expected metres a pixel, {_SMALLEST:g} to {_LARGEST:g}"
        )
    occupied = _number(name, entries, "occupied_thresh", 0.65)
    free = _number(name, entries, "free_thresh", 0.196)
    for key, value in (("occupied_thresh", occupied), ("free_thresh", free)):
        if not 0 <= value <= 1:
            raise ValueError(f"{name}: {key}: found {value:g}, expected a probability, 0 to 1")
    if free > occupied:
        least = f"occupied_thresh = {occupied:g}"
        raise ValueError(f"{name}: free_thresh: found {free:g}, expected at most {least}")
    negate = bool(_number(name, entries, "negate", 0))
    mode = entries.get("mode", "trinary")
    mode = mode.lower() if isinstance(mode, str) else mode
    if mode not in ("trinary", "scale", "raw"):
        raise ValueError(f"{name}: mode: found {shown(repr(mode))}, expected trinary, scale or raw")
    origin = entries.get("origin")
    coordinates = [_finite(value) for value in origin] if isinstance(origin, list) else []
    if len(coordinates) != 3 or None in coordinates:
        raise ValueError(f"{name}: origin: found {shown(repr(origin))}, expected [x, y, yaw]")
    x, y, yaw = coordinates
    if abs(math.remainder(yaw, math.tau)) > _STRAIGHT:
        raise ValueError(f"{name}: origin: found a yaw of {yaw:g}, expected 0: turned images are not read")

    def state(grey: NDArray[np.float64]) -> NDArray[np.int8]:
        """Of greys from 0 to 255."""
        if mode == "raw":
            share = np.where(grey <= 100, grey, np.nan) / 100.0
        else:
            share = (grey if negate else 255.0 - grey) / 255.0
        states = np.full(grey.shape, -1, dtype=np.int8)
        states[share <= free] = 0
        states[share >= occupied] = 1
        return states

    states, counts = _pixels(_image_of(name, image), state, mode)
    channels = len(counts) // 255
    notes = []
    doubtful = int(counts[_UNKNOWN * channels]) if channels < 4 else 0
    if doubtful and mode != "raw" and not negate and state(np.array([float(_UNKNOWN)]))[0] == 0:
        notes.append(
            f"{number_of(doubtful, 'pixel')} of grey {_UNKNOWN}, which ROS 1 writes for unknown: free, as "
            f"free_thresh is {free:g}; with {_UNKNOWN_ABOVE} they would be unknown"
        )
    greys = np.arange(len(counts)) / channels
    costs = (state(greys) == -1) & (greys <= (100 if mode == "raw" else 255))
    if mode != "trinary" and (between := int(counts[costs].sum())):
        notes.append(
            f"{number_of(between, 'pixel')} between free_thresh and occupied_thresh: unknown; "
            "in nav2 free, or a cost with trinary_costmap: false"
        )
    if mode == "raw" and (above := int(counts[(greys > 100) & (greys < 255)].sum())):
        notes.append(
            f"{number_of(above, 'pixel')} of grey 101 to 254: unknown in mode raw; "
            "if white is free in this image, its mode is trinary or scale"
        )
    if (states == -1).all():
        notes.append("no pixel is free or occupied: the map is empty")
    return MapImage(states[::-1].T, np.array([x, y]), size, tuple(notes))


def _entries(name: str) -> dict[Any, Any]:
    """What the YAML file says, without what YAML can say but such files never do."""
    with needs(_NEEDS, "convert"):
        import yaml

    class Loader(yaml.SafeLoader):
        """Without aliases, which let a small file stand for a huge one, and not deeply nested."""

        depth = 0

        def compose_node(self, parent: Any, index: Any) -> Any:
            if self.check_event(yaml.AliasEvent):
                raise ValueError("an alias, expected none")
            if self.depth == _MOST_NESTED:
                raise ValueError(f"more than {_MOST_NESTED} levels, expected fewer")
            self.depth += 1
            node = super().compose_node(parent, index)
            names = [str(one.value) for one, _ in node.value] if isinstance(node, yaml.MappingNode) else []
            if len(set(names)) < len(names):
                raise ValueError(f"{Counter(names).most_common(1)[0][0]} is there twice, expected once")
            self.depth -= 1
            return node

    with open_regular(name) as file:
        content = file.read(_MOST_YAML + 1)
    if len(content) > _MOST_YAML:
        raise ValueError(f"{name}: more than {_MOST_YAML >> 10} KiB, expected a map_server map's YAML file")
    try:
        entries = yaml.load(content.decode("utf-8", "replace"), Loader)
    except (MemoryError, RecursionError):
        raise
    except Exception as error:  # PyYAML raises its own, and what its conversions of dates and numbers raise.
        raise ValueError(f"{name}: not YAML as expected: {one_line(error)}") from None
    if not isinstance(entries, dict):
        raise ValueError(f"{name}: no 'image', expected the YAML file of a map_server map")
    return entries


def _finite(value: Any) -> float | None:
    """A number, or None."""
    if not isinstance(value, (bool, int, float, str)):
        return None
    try:
        number = float(value)
    except (ValueError, OverflowError):
        return None
    return number if math.isfinite(number) else None


def _number(name: str, entries: dict[Any, Any], key: str, default: float | None = None) -> float:
    value = entries.get(key, default)
    if value is None:
        raise ValueError(f"{name}: {key}: found nothing, expected a number")
    number = _finite(value)
    if number is None:
        raise ValueError(f"{name}: {key}: found {shown(repr(value))}, expected a number")
    return number


def _image_of(name: str, image: str) -> str:
    """The path of the image that a YAML file names."""
    path = os.path.join(os.path.dirname(name), image)
    if not os.path.exists(path) or os.path.isdir(path):
        beside = os.path.basename(image.replace("\\", "/"))
        is_there = os.path.isfile(os.path.join(os.path.dirname(name), beside))
        wanted = f"{beside}, which is beside it" if is_there else "a file"
        raise ValueError(f"{name}: image: found {shown(repr(image))}, expected {wanted}")
    return path


def _opened(path: str, file: IO[bytes]) -> Any:
    """As Pillow opens images, which warns of large ones: all threads share what filters warnings."""
    from PIL import Image

    Image.init()
    head = file.read(16)
    for make, fits in (Image.OPEN[kind] for kind in _IMAGES):
        if fits(head):
            file.seek(0)
            with suppress(SyntaxError, IndexError, TypeError, struct.error):
                image = make(file, "")
                if image.width * image.height > _MOST_PIXELS:
                    raise ValueError(f"{path}: an image of more than {_MOST_PIXELS:,} pixels, expected fewer")
                return image
    raise ValueError(f"{path}: not an image, expected PGM or PNG")


def _pixels(
    path: str, state: Callable[[NDArray[np.float64]], NDArray[np.int8]], mode: str
) -> tuple[NDArray[np.int8], NDArray[np.intp]]:
    """(rows, columns) states of an image's greys, means of a pixel's colors; how many have each sum of these.

    As nav2 has it, the opaqueness of an image that has one counts as a fourth color where `mode` is trinary;
    where it is scale, pixels that are not opaque are unknown; where it is raw, it says nothing.
    """
    with open_regular(path) as file:
        try:
            with needs(_NEEDS, "convert"):
                image = _opened(path, file)
            if image.mode in ("I", "F") or image.mode.startswith("I;"):
                raise ValueError(f"{path}: pixels of more than 8 bits, expected 0 to 255")
            has_alpha = "transparency" in image.info or image.mode in _WITH_ALPHA
            grey = image.mode in ("1", "L") and not has_alpha
            if not grey and image.mode != "RGBA":
                image = image.convert("RGBA")
            channels = 1 if grey else 4 if has_alpha and mode == "trinary" else 3
            states = state(np.arange(channels * 255 + 1) / channels)  # By the sum of a pixel's channels.
            counts = np.zeros(len(states), dtype=np.intp)
            columns, rows = image.size
            found = np.empty((rows, columns), dtype=np.int8)
            for first in range(0, rows, _ROWS_AT_ONCE):
                last = min(first + _ROWS_AT_ONCE, rows)
                part = np.asarray(image.crop((0, first, columns, last)))
                if grey:
                    sums = part.astype(np.uint8) * (255 if image.mode == "1" else 1)
                else:
                    sums = part[..., :channels].sum(axis=2, dtype=np.uint16)
                found[first:last] = states[sums]
                counts += np.bincount(sums.ravel(), minlength=len(counts))
                if not grey and mode == "scale":
                    found[first:last][part[..., 3] < 255] = -1
        except (OSError, SyntaxError, EOFError) as error:
            raise ValueError(f"{path}: a damaged image: {one_line(error)}") from None
    return found, counts
