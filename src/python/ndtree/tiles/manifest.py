# SPDX-License-Identifier: BSD-3-Clause
"""What a tiled map says of itself: one small file, which is replaced last and says which others count."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndtree._native import _core
from ndtree._native._core import OccupancyMap
from ndtree.tiles.grid import MapKind, Tile, TileGrid
from ndtree.tiles.storage import Storage

NAME = "manifest.json"
TILES = "tiles"
_FORMAT = "ndtree tiles"
_VERSION = 1


@dataclass(frozen=True)
class StoredFile:
    """A file that the manifest counts on.

    `file`: Its name in the folder; it is made from the content, and so never written anew with another one.
    """

    file: str
    bytes: int
    sha256: str


@dataclass(frozen=True)
class TileEntry(StoredFile):
    """A tile.

    `revision`: Of the manifest that first had it with this content.
    `bounds`: Lower and upper corner around all observed cells [m].
    """

    revision: int
    observed_leaves: int
    bounds: tuple[list[float], list[float]] | None


@dataclass
class Manifest:
    """The state of a tiled map.

    `revision`: Grows by one with each state that was written.
    `frame`: A map file with the root and the counters of the whole map, and no cell.
    `tiles`: By place.
    `made_from`: What its writer needs to go on.
    """

    kind: MapKind
    grid: TileGrid
    revision: int
    frame: StoredFile
    tiles: dict[Tile, TileEntry]
    made_from: dict[str, Any] = field(default_factory=dict)

    @property
    def bounds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
        """The smallest box around all observed cells; None if there are none."""
        boxes = [entry.bounds for entry in self.tiles.values() if entry.bounds is not None]
        if not boxes:
            return None
        return np.min([box[0] for box in boxes], axis=0), np.max([box[1] for box in boxes], axis=0)

    def files(self) -> set[str]:
        """All files that it counts on."""
        return {self.frame.file, *(entry.file for entry in self.tiles.values())}

    def as_bytes(self) -> bytes:
        """The file."""
        bounds = self.bounds
        content = {
            "format": _FORMAT,
            "version": _VERSION,
            "revision": self.revision,
            "map": asdict(self.kind),
            "lattice": {"unit": self.grid.unit, "cube": self.grid.cube, "cubes": self.grid.cubes},
            "tile_size": self.grid.size,
            "bounds": None if bounds is None else [one.tolist() for one in bounds],
            "frame": asdict(self.frame),
            "tiles": [{"at": list(tile), **asdict(entry)} for tile, entry in sorted(self.tiles.items())],
            "made_from": self.made_from,
        }
        return (json.dumps(content, indent=1, allow_nan=False) + "\n").encode()

    @classmethod
    def from_bytes(cls, content: bytes, place: str) -> Manifest:
        """Read what `as_bytes` wrote.

        Raises ValueError if it is not that, naming the place.
        """
        try:
            held = json.loads(content)
            is_ours = held["format"] == _FORMAT
        except (ValueError, TypeError, KeyError, RecursionError):
            is_ours = False
        if not is_ours:
            raise ValueError(f"{place}: no manifest of a tiled map, expected JSON with format {_FORMAT!r}")
        if held.get("version") != _VERSION:
            raise ValueError(
                f"{place}: format version {held.get('version')}: this ndtree reads version {_VERSION}"
            )
        try:
            of_map, lattice = held["map"], held["lattice"]
            kind = MapKind(
                int(of_map["dim"]),
                int(of_map["branching"]),
                str(of_map["refinement"]),
                {str(name): float(value) for name, value in of_map["options"].items()},
            )
            grid = TileGrid(kind.dim, float(lattice["unit"]), int(lattice["cube"]), int(lattice["cubes"]))
            tiles = {tuple(int(i) for i in one.pop("at")): _entry(one) for one in held["tiles"]}
            if any(len(tile) != kind.dim for tile in tiles):
                raise ValueError("a tile's place has another dimension than the map")
            if TileGrid.of(kind.new(), grid.size) != grid:
                raise ValueError("the lattice is not that of the map's options")
            frame = _stored(held["frame"])
            return cls(kind, grid, int(held["revision"]), frame, tiles, dict(held["made_from"]))
        except (KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError) as error:
            said = f"no {error}" if isinstance(error, KeyError) else error
            raise ValueError(f"{place}: damaged: {said}") from error


def _stored(held: Mapping[str, Any]) -> StoredFile:
    return StoredFile(_name(held["file"]), int(held["bytes"]), str(held["sha256"]))


def _entry(held: Mapping[str, Any]) -> TileEntry:
    stored, bounds = vars(_stored(held)), held["bounds"]
    corners = None if bounds is None else ([float(x) for x in bounds[0]], [float(x) for x in bounds[1]])
    revision, observed_leaves = int(held["revision"]), int(held["observed_leaves"])
    return TileEntry(**stored, revision=revision, observed_leaves=observed_leaves, bounds=corners)


def _name(held: Any) -> str:
    """A name inside the folder."""
    if not isinstance(held, str) or not held or held.startswith("/") or ".." in held.split("/"):
        raise ValueError(f"file {held!r}: must be a name inside the folder")
    return held


def open_manifest(storage: Storage) -> Manifest:
    """The manifest of a tiled map.

    Raises OSError if there is none, or it cannot be read; ValueError if it is damaged.
    """
    place = storage.place(NAME)
    try:
        content = storage.read(NAME)
    except (FileNotFoundError, NotADirectoryError) as error:
        raise FileNotFoundError(2, "no tiled map: no such file", place) from error
    return Manifest.from_bytes(content, place)


def store_bytes(storage: Storage, content: bytes, begin: str) -> StoredFile:
    """Write a map file under a name that begins so and ends with its checksum, unless it is there already."""
    digest = hashlib.sha256(content).hexdigest()
    stored = StoredFile(f"{begin}-{digest[:16]}.ndt", len(content), digest)
    if not storage.has(stored.file):
        storage.write(stored.file, content)
    return stored


def store_tile(storage: Storage, m: OccupancyMap, tile: Tile, revision: int) -> TileEntry:
    """Write a tile, whose map holds nothing else."""
    stored = store_bytes(storage, m.to_bytes(), f"{TILES}/{'_'.join(map(str, tile))}")
    bounds = m.bounds()
    corners = None if bounds is None else (bounds[0].tolist(), bounds[1].tolist())
    return TileEntry(
        **vars(stored), revision=revision, observed_leaves=m.stats().observed_leaves, bounds=corners
    )


def read_map(storage: Storage, stored: StoredFile) -> OccupancyMap:
    """A map that the manifest counts on.

    Raises OSError if it cannot be read; ValueError if it is not there, or not what was written.
    """
    place = storage.place(stored.file)
    try:
        content = storage.read(stored.file)
    except FileNotFoundError as error:
        raise ValueError(
            f"{place}: is not there, but the manifest counts on it: "
            "if the map was written anew, open it again"
        ) from error
    if hashlib.sha256(content).hexdigest() != stored.sha256:
        raise ValueError(f"{place}: damaged: SHA-256 is not that of the manifest, {stored.sha256}")
    try:
        return _core.from_bytes(content)
    except ValueError as error:
        raise ValueError(f"{place}: {error}") from error


def commit(storage: Storage, manifest: Manifest) -> None:
    """Make this the state of the tiled map: from then on it is what everybody sees, and before, what was."""
    storage.write(NAME, manifest.as_bytes())


def tidy(storage: Storage, manifest: Manifest) -> int:
    """Remove tiles and frames that no manifest counts on any more. @returns how many."""
    orphans = storage.names(TILES) - manifest.files()
    for name in orphans:
        storage.remove(name)
    return len(orphans)
