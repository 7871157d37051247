# SPDX-License-Identifier: BSD-3-Clause
"""Maps of any kind in files: ours, OctoMap's, and the images of ROS's map_server."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndtree import _core
from ndtree._core import OccupancyMap
from ndtree.readers import MAP_MAGIC

OCTOMAP_MAGIC = b"# Octomap OcTree"
YAML_SUFFIXES = (".yaml", ".yml")
_KNOWN = "a map of ndtree's, OctoMap's (.bt, .ot) or map_server's (.yaml)"
_ON_LATTICE = 1e-6  # [cells]
_NEEDS = "map_server's files need {} ({}); install them with: pip install 'ndtree-mapping[convert]'"


@dataclass(frozen=True)
class PlacedMap:
    """A map whose frame may be shifted: what it says of a point p is found at p - offset.

    Attributes
    ----------
    map : OccupancyMap
    offset : (dim,) float64
        [m]; 0 but for images that do not begin at a whole number of pixels from 0.
    name : str
        The file's name as it was given, for messages.
    """

    map: OccupancyMap
    offset: NDArray[np.float64]
    name: str

    @property
    def cell_size(self) -> float:
        """Edge of the smallest cells [m]."""
        return float(self.map.options["min_cell_size"])

    def state(self, points: NDArray[np.float64]) -> NDArray[np.int8]:
        """(n,) states at points (n, dim) of the common frame."""
        return np.asarray(self.map.state(points - self.offset))

    def resampled(self, cell_size: float | None) -> OccupancyMap:
        """The map without its shift: itself where there is none, else asked at the centres of cells.

        Raises
        ------
        ValueError
            If there is a shift, and no cell size.
        """
        if not self.offset.any():
            return self.map
        if cell_size is None:
            at = ", ".join(f"{value:g}" for value in self.offset)
            raise ValueError(
                f"{self.name}: origin ({at}) m is no whole number of pixels of {self.cell_size:g} m from 0: "
                "give a cell size to sample it anew"
            )
        if not (cell_size > 0 and math.isfinite(cell_size)):
            raise ValueError(f"cell_size = {cell_size} m: must be > 0 and finite")
        leaves = self.map.leaves()
        lower = leaves.lower[leaves.observed].min(axis=0) + self.offset
        upper = (leaves.lower + leaves.size[:, None])[leaves.observed].max(axis=0) + self.offset
        first = np.floor(lower / cell_size)
        shape = (np.ceil(upper / cell_size) - first).astype(int)
        axes = [(first[a] + np.arange(shape[a]) + 0.5) * cell_size for a in range(len(shape))]
        points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(shape))
        return _core.from_grid(self.state(points).reshape(shape), first * cell_size, cell_size)


def is_map(path: str | os.PathLike[str]) -> bool:
    """Whether a file is a map of any kind, and not a log; decided by its first bytes, or by ``.yaml``.

    Raises
    ------
    OSError
        If it cannot be read.
    """
    if os.path.isdir(path):  # Some logs are folders.
        return False
    with open(path, "rb") as file:
        head = file.read(len(OCTOMAP_MAGIC))
    return head.startswith((MAP_MAGIC, OCTOMAP_MAGIC)) or Path(path).suffix.lower() in YAML_SUFFIXES


def open_map(path: str | os.PathLike[str]) -> PlacedMap:
    """Open a map of any kind: `load`, `load_octomap`, or an image that map_server and nav2 read.

    A pixel of an image becomes a free, an occupied or an unknown cell by the YAML file's thresholds and
    mode, as map_server has it; transparent ones are unknown.

    Raises
    ------
    OSError
        If a file cannot be read.
    ValueError
        If it is damaged or no map: which file, what was found, and what was expected.
    ImportError
        If map_server's files need a library that is not installed; it names the extra.
    """
    name = os.fspath(path)
    with open(name, "rb") as file:
        head = file.read(len(OCTOMAP_MAGIC))
    if Path(name).suffix.lower() in YAML_SUFFIXES:
        return _map_server(name)
    if head.startswith(OCTOMAP_MAGIC):
        loaded: OccupancyMap = _core.load_octomap(name)
    elif head.startswith(MAP_MAGIC):
        loaded = _core.load(name)
    else:
        raise ValueError(
            f"{name}: neither the first bytes nor the name are those of a map, expected {_KNOWN}"
        )
    return PlacedMap(loaded, np.zeros(loaded.dim), name)


def _map_server(name: str) -> PlacedMap:
    try:
        import yaml
    except ImportError as error:
        raise ImportError(_NEEDS.format("PyYAML and Pillow", error)) from None
    with open(name, encoding="utf-8", errors="replace") as file:
        try:
            entries = yaml.safe_load(file)
        except yaml.YAMLError as error:
            raise ValueError(f"{name}: not YAML: {' '.join(str(error).split())}") from None
    if not isinstance(entries, dict) or "image" not in entries:
        raise ValueError(f"{name}: no 'image', expected the YAML file of a map_server map")
    size = _number(name, entries, "resolution")
    if not size > 0:
        raise ValueError(f"{name}: resolution: found {size}, expected a number > 0 m")
    occupied = _number(name, entries, "occupied_thresh", 0.65)
    free = _number(name, entries, "free_thresh", 0.196)
    negate = bool(_number(name, entries, "negate", 0))
    mode = entries.get("mode", "trinary")
    if mode not in ("trinary", "scale", "raw"):
        raise ValueError(f"{name}: mode: found {mode!r}, expected trinary, scale or raw")
    origin = entries.get("origin")
    try:
        x, y, yaw = (float(value) for value in origin)  # type: ignore[union-attr]
        if not all(map(math.isfinite, (x, y, yaw))):
            raise ValueError
    except (TypeError, ValueError):
        raise ValueError(f"{name}: origin: found {origin!r}, expected [x, y, yaw]") from None
    if yaw != 0:
        raise ValueError(f"{name}: origin: found a yaw of {yaw:g}, expected 0: turned images are not read")
    values, opaque = _pixels(os.path.join(os.path.dirname(name), str(entries["image"])))
    if mode == "raw":
        share = np.where(values <= 100, values, np.nan) / 100.0
    else:
        share = (values if negate else 255.0 - values) / 255.0
    states = np.full(values.shape, -1, dtype=np.int8)
    states[share < free] = 0
    states[share > occupied] = 1
    states[~opaque] = -1
    states = states[::-1].T
    lower = np.array([x, y])
    on_lattice = np.all(np.abs(lower / size - np.rint(lower / size)) <= _ON_LATTICE)
    offset = np.zeros(2) if on_lattice else lower
    return PlacedMap(_core.from_grid(states, lower - offset, size), offset, name)


def _number(name: str, entries: dict[str, Any], key: str, default: float | None = None) -> float:
    value = entries.get(key, default)
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        raise ValueError(f"{name}: {key}: found {value!r}, expected a number")
    return number


def _pixels(path: str) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Grey values 0 to 255 of an image's rows, and which of them are not transparent."""
    try:
        from PIL import Image, UnidentifiedImageError
    except ImportError as error:
        raise ImportError(_NEEDS.format("PyYAML and Pillow", error)) from None
    try:
        with Image.open(path) as image:
            if image.mode in ("I", "F") or image.mode.startswith("I;"):
                raise ValueError(f"{path}: pixels of more than 8 bits, expected 0 to 255")
            planes = np.asarray(image.convert("RGBA"), dtype=np.float64)
    except UnidentifiedImageError:
        raise ValueError(f"{path}: not an image, expected PGM or PNG") from None
    except (SyntaxError, EOFError) as error:
        raise ValueError(f"{path}: a damaged image: {error}") from None
    except OSError as error:
        if error.filename is not None or error.errno is not None:
            raise
        raise ValueError(f"{path}: a damaged image: {error}") from None  # Cut off.
    return planes[..., :3].mean(axis=2), planes[..., 3] > 0
