# SPDX-License-Identifier: BSD-3-Clause
"""Images that ROS's map_server and nav2 read as maps: a YAML file, and a PGM or PNG that it names."""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndtree.logs.core.failures import one_line, shown
from ndtree.logs.core.plain_file import open_regular

_NEEDS = "map_server's files need {} ({}); install them with: pip install 'ndtree-mapping[convert]'"
#: Far more than anybody's file about an image has.
_MOST_YAML = 1 << 16
_MOST_NESTED = 8
#: Pillow reads others, too, some of them by calling programs.
_IMAGES = ("PPM", "PNG", "BMP", "GIF", "JPEG", "TIFF")
_ROWS_AT_ONCE = 256
_WITH_ALPHA = ("RGBA", "LA", "PA", "La", "RGBa")
#: Yaws of less turn no image by as much as a pixel [rad].
_STRAIGHT = 1e-6


def states_of_image(name: str) -> tuple[NDArray[np.int8], NDArray[np.float64], float]:
    """What an image says.

    Parameters
    ----------
    name : str
        Its YAML file.

    Returns
    -------
    states : (columns, rows) int8
        -1 unknown, 0 free, 1 occupied; the first axis is x, the second y.
    lower : (2,) float64
        Lower corner of the first [m].
    cell_size : float
        [m]

    Raises
    ------
    OSError, ValueError, ImportError
        As `ndtree.maps.open.open_map`.
    """
    entries = _entries(name)
    if "image" not in entries:
        raise ValueError(f"{name}: no 'image', expected the YAML file of a map_server map")
    image = entries["image"]
    if not isinstance(image, str) or not image or "\0" in image:
        raise ValueError(f"{name}: image: found {shown(repr(image))}, expected the name of a file")
    size = _number(name, entries, "resolution")
    if not size > 0:
        raise ValueError(f"{name}: resolution: found {size}, expected a number > 0 m")
    occupied = _number(name, entries, "occupied_thresh", 0.65)
    free = _number(name, entries, "free_thresh", 0.196)
    negate = bool(_number(name, entries, "negate", 0))
    mode = entries.get("mode", "trinary")
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
        states[share < free] = 0
        states[share > occupied] = 1
        return states

    states = _pixels(os.path.join(os.path.dirname(name), image), state, mode)
    return states[::-1].T, np.array([x, y]), size


def _entries(name: str) -> dict[Any, Any]:
    """What the YAML file says, without what YAML can say but such files never do."""
    try:
        import yaml
    except ImportError as error:
        raise ImportError(_NEEDS.format("PyYAML and Pillow", error)) from None

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
    number = _finite(value)
    if number is None:
        raise ValueError(f"{name}: {key}: found {shown(repr(value))}, expected a number")
    return number


def _pixels(
    path: str, state: Callable[[NDArray[np.float64]], NDArray[np.int8]], mode: str
) -> NDArray[np.int8]:
    """(rows, columns) states of an image's greys, which are the means of a pixel's colors.

    As nav2 has it, the opaqueness of an image that has one counts as a fourth color where `mode` is trinary;
    where it is scale, pixels that are not opaque are unknown; where it is raw, it says nothing.
    """
    try:
        from PIL import Image, UnidentifiedImageError
    except ImportError as error:
        raise ImportError(_NEEDS.format("PyYAML and Pillow", error)) from None
    with open_regular(path) as file:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", Image.DecompressionBombWarning)
                image = Image.open(file, formats=_IMAGES)
            if image.mode in ("I", "F") or image.mode.startswith("I;"):
                raise ValueError(f"{path}: pixels of more than 8 bits, expected 0 to 255")
            has_alpha = "transparency" in image.info or image.mode in _WITH_ALPHA
            grey = image.mode in ("1", "L") and not has_alpha
            if not grey and image.mode != "RGBA":
                image = image.convert("RGBA")
            channels = 1 if grey else 4 if has_alpha and mode == "trinary" else 3
            states = state(np.arange(channels * 255 + 1) / channels)  # By the sum of a pixel's channels.
            columns, rows = image.size
            found = np.empty((rows, columns), dtype=np.int8)
            for first in range(0, rows, _ROWS_AT_ONCE):
                last = min(first + _ROWS_AT_ONCE, rows)
                part = np.asarray(image.crop((0, first, columns, last)))
                if grey:
                    found[first:last] = states[part.astype(np.uint8) * (255 if image.mode == "1" else 1)]
                else:
                    found[first:last] = states[part[..., :channels].sum(axis=2, dtype=np.uint16)]
                    if mode == "scale":
                        found[first:last][part[..., 3] < 255] = -1
        except UnidentifiedImageError:
            raise ValueError(f"{path}: not an image, expected PGM or PNG") from None
        except Image.DecompressionBombError:
            raise ValueError(
                f"{path}: an image of more than {2 * (Image.MAX_IMAGE_PIXELS or 0):,} pixels, expected fewer"
            ) from None
        except (OSError, SyntaxError, EOFError) as error:
            raise ValueError(f"{path}: a damaged image: {one_line(error)}") from None
    return found
