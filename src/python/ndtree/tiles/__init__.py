# SPDX-License-Identifier: BSD-3-Clause
"""Maps in tiles: larger than memory, in a folder or wherever fsspec gets.

A tile is a map file of its own; a manifest, which is replaced last, says which files are the map. What
happens in one of the coarsest cells does not depend on the others: so tiles make the very map that one
machine makes of the same scans, byte for byte.
"""

from ndtree.tiles.grid import TileGrid
from ndtree.tiles.manifest import NAME as MANIFEST
from ndtree.tiles.manifest import Manifest, StoredFile, TileEntry
from ndtree.tiles.mapper import TileMapper
from ndtree.tiles.order import in_order
from ndtree.tiles.storage import storage_of
from ndtree.tiles.tiled_map import TiledMap, open_tiles

__all__ = [
    "MANIFEST",
    "Manifest",
    "StoredFile",
    "TileEntry",
    "TileGrid",
    "TileMapper",
    "TiledMap",
    "in_order",
    "open_tiles",
    "storage_of",
]
