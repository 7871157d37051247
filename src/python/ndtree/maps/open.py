# SPDX-License-Identifier: BSD-3-Clause
"""Maps of any kind in files: ours, OctoMap's, and the images of ROS's map_server."""

from __future__ import annotations

import math
import os
import re
import shlex
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ndtree._errors import WrongValue
from ndtree._native import _core
from ndtree._native._core import OccupancyMap
from ndtree.logs import MAP_MAGIC, OCTOMAP_MAGIC, kind_of
from ndtree.logs.core.failures import readable
from ndtree.logs.core.plain_file import open_regular
from ndtree.maps.images import map_image
from ndtree.tiles import MANIFEST, open_tiles

#: Of files of before OctoMap 1.0: a number that other files may begin with, too, so that the name counts.
OLD_OCTOMAP_MAGIC = b"\3\0\0\0"
YAML_SUFFIXES = (".yaml", ".yml")
_KNOWN = "a map of ndtree's, OctoMap's (.bt, .ot) or map_server's (.yaml)"
TILES_MAGIC = b'"ndtree tiles"'
TILES_SUFFIX = ".tiles"
_URL = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+):/{1,2}(?=[^/]|$)")  # A Path takes one slash away.
_ON_LATTICE = 1e-6  # [cells]


@dataclass(frozen=True)
class PlacedMap:
    """A map whose frame may be shifted: what it says of a point p is found at p - offset.

    `offset` (dim,) float64: [m]; 0 but for images that do not begin at a whole number of pixels from 0.
    """

    map: OccupancyMap
    offset: NDArray[np.float64]
    name: str  # The file's name as it was given, for messages.
    notes: tuple[str, ...] = ()  # What a user should know of how it was read, a line each.

    @property
    def cell_size(self) -> float:
        """Edge of the smallest cells [m]."""
        return float(self.map.options["min_cell_size"])

    def state(self, points: NDArray[np.float64]) -> NDArray[np.int8]:
        """(n,) states at points (n, dim) of the common frame."""
        return np.asarray(self.map.state(points - self.offset))

    @property
    def moved_note(self) -> str:
        """What `resampled` does without a cell size, in one line; empty where nothing is shifted."""
        if not self.offset.any():
            return ""
        at = ", ".join(f"{value:.10g}" for value in self.offset)
        by = ", ".join(f"{value:.3g}" for value in self._whole - self.offset)
        return (
            f"origin ({at}) m is not a whole number of pixels of {self.cell_size:g} m from 0: "
            f"the map is moved by ({by}) m to the nearest"
        )

    @property
    def _whole(self) -> NDArray[np.float64]:
        """The shift to the nearest whole number of cells [m], free of the last bits."""
        cells = np.rint(self.offset / self.cell_size)
        return np.asarray(np.round(cells * self.cell_size, 9))

    def resampled(self, cell_size: float | None = None) -> OccupancyMap:
        """The map without its shift: itself where there is none, else in other cells, see `to_grid`.

        Without a cell size its own cells are moved by half of one at most, all alike.

        Raises ValueError if the cell size is none.
        """
        if cell_size is not None and not (cell_size > 0 and math.isfinite(cell_size)):
            raise WrongValue.of("cell_size", f"{cell_size} m", "> 0 and finite")
        if not self.offset.any():
            return self.map
        leaves = self.map.leaves()
        if not leaves.observed.any():
            return self.map
        lower = leaves.lower[leaves.observed].min(axis=0)
        upper = (leaves.lower + leaves.size[:, None])[leaves.observed].max(axis=0)
        size = self.cell_size
        if cell_size is None:
            shape = np.rint((upper - lower) / size).astype(int)
            states = self.map.to_grid([lower, lower + (shape - 0.5) * size], size)
            return _core.from_grid(states, lower + self._whole, size)
        first = np.floor((lower + self.offset) / cell_size)
        shape = (np.ceil((upper + self.offset) / cell_size) - first).astype(int)
        corner = first * cell_size
        states = self.map.to_grid(
            [corner - self.offset, corner + (shape - 0.5) * cell_size - self.offset], cell_size
        )
        return _core.from_grid(states, corner, cell_size)


def is_map(path: str | os.PathLike[str]) -> bool:
    """Whether a file is a map of any kind, and not a log; decided by its first bytes, or by ``.yaml``.

    Raises OSError if it cannot be read.
    """
    if tiles_url(path) is not None:
        return True
    if os.path.isdir(path):  # Some logs are folders.
        return False
    return _kind_by_content(os.fspath(path)) != ""


def _kind_by_content(name: str) -> str:
    """ "ndtree", "octomap" or "map_server"; "" if a file is none of these."""
    suffix = Path(name).suffix.lower()
    with open_regular(name) as file:
        head = file.read(len(OCTOMAP_MAGIC))
    if suffix in YAML_SUFFIXES:
        return "map_server"
    if head.startswith(OCTOMAP_MAGIC) or (head.startswith(OLD_OCTOMAP_MAGIC) and suffix == ".bt"):
        return "octomap"
    return "ndtree" if head.startswith(MAP_MAGIC) else ""


def tiles_url(path: str | os.PathLike[str]) -> str | None:
    """Where a map in tiles is: for a folder that has its manifest or name, and what has a URL; else None."""
    text = os.fspath(path)
    scheme = _URL.match(text)
    if scheme is not None:
        return f"{scheme[1]}://{text[scheme.end() :]}"
    if os.path.isdir(text) and Path(text).suffix.lower() == TILES_SUFFIX:
        return text  # Also if its manifest is damaged, or not there.
    manifest = os.path.join(text, MANIFEST)
    if not os.path.isfile(manifest):
        return None
    with open_regular(manifest) as file:  # Other folders have a file of this name, too.
        return text if TILES_MAGIC in file.read(100) else None


def open_map(path: str | os.PathLike[str]) -> PlacedMap:
    """Open a map of any kind: `load`, `load_octomap`, tiles, or an image that map_server and nav2 read.

    Of a map in tiles, all are read into one.

    A pixel of an image becomes a free, an occupied or an unknown cell by the YAML file's thresholds and
    mode, as nav2's map_server has it: where an image has an alpha channel, the mode trinary takes that for a
    fourth color, and the mode scale calls all pixels unknown that are not opaque.

    Raises OSError if a file cannot be read; ValueError if it is damaged or no map: which file, what was
    found, and what was expected; ImportError if map_server's files need a library that is not installed; it
    names the extra.
    """
    name = os.fspath(path)
    with readable(name, "cannot be read as a map"):
        url = tiles_url(name)
        if url is not None:
            whole = open_tiles(url).to_map()
            return PlacedMap(whole, np.zeros(whole.dim), name)
        if os.path.isdir(name):
            raise no_map(name, _KNOWN)
        kind = _kind_by_content(name)
        if kind == "map_server":
            return _map_server(name)
        if not kind:
            raise no_map(name, _KNOWN)
        loaded: OccupancyMap = _core.load_octomap(name) if kind == "octomap" else _core.load(name)
        return PlacedMap(loaded, np.zeros(loaded.dim), name)


def no_map(name: str, expected: str, in_python: str = "") -> ValueError:
    """The error of a file or folder that is no map: what it is, and what makes a map of it.

    `in_python` is the call that reads it, if it is a log.
    """
    known = kind_of(name)
    if known is None:
        return ValueError(f"{name}: is neither a map nor a log of a known kind, expected {expected}")
    kind, ways = known
    if in_python and ways == (f"ndtree map {shlex.quote(name)}",):
        ways = (*ways, f"in Python: {in_python}")
    lines = "".join(f"\n  {way}" for way in ways)
    return ValueError(f"{name}: {kind}, expected {expected}{'; try' * bool(ways)}{lines}")


def _map_server(name: str) -> PlacedMap:
    image = map_image(name)
    lower, size = image.lower, image.cell_size
    on_lattice = np.all(np.abs(lower / size - np.rint(lower / size)) <= _ON_LATTICE)
    offset = np.zeros(2) if on_lattice else lower
    return PlacedMap(_core.from_grid(image.states, lower - offset, size), offset, name, image.notes)
