# SPDX-License-Identifier: BSD-3-Clause
"""Which maps the tiles are, and their bytes."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass, field
from typing import Any

from ndtree._native import _core
from ndtree._native._core import OccupancyMap

_PREAMBLE = struct.Struct("<8sIQ")  # Magic, version, length; see io/map_file.hpp.


@dataclass(frozen=True)
class MapKind:
    """What all tiles have in common: enough to make an empty map.

    `options`: All that the refinement reads; of tiles that an older version made, constants of the method,
        too.
    """

    dim: int
    branching: int
    refinement: str
    options: dict[str, float] = field(hash=False)

    @classmethod
    def of(cls, m: OccupancyMap) -> MapKind:
        """That of a map.

        Raises ValueError for an OctoMap, and a map with layers, of which there are no tiles.
        """
        if m.refinement == "octomap":
            raise ValueError("an OctoMap has no tiles: must be a map of ndtree's own")
        if m.layers:
            raise ValueError(f"layers: {', '.join(m.layers)}: must be none, as tiles hold occupancy alone")
        return cls(m.dim, m.branching, m.refinement, dict(m.options))

    def new(self) -> OccupancyMap:
        """An empty map."""
        known = _core.default_options()
        options = {name: value for name, value in self.options.items() if name in known}
        constants = {name: value for name, value in self.options.items() if name not in known}
        make: Any = _core.FixedMap if self.refinement == "fixed" else _core.AdaptiveMap
        return make(  # type: ignore[no-any-return]
            dim=self.dim, branching=self.branching, refinement=self.refinement, constants=constants, **options
        )

    def is_worth_storing(self, m: OccupancyMap) -> bool:
        """Whether a map of this kind knows anything, parts of cells included."""
        return m.stats().nodes > 1 or m != self.new()


def with_counters(map_file: bytes, updates: int, splits: int, merges: int, scans: int) -> bytes:
    """A map file with other numbers of updates, splits, merges and scans; its cells stay as they are."""
    at = _PREAMBLE.size + 8
    at += 2 + struct.unpack_from("<H", map_file, at)[0]
    options, at = struct.unpack_from("<I", map_file, at)[0], at + 4
    for _ in range(options):
        at += 2 + struct.unpack_from("<H", map_file, at)[0] + 8
    counted = map_file[:at] + struct.pack("<4Q", updates, splits, merges, scans) + map_file[at + 32 : -4]
    return counted + struct.pack("<I", zlib.crc32(counted))
