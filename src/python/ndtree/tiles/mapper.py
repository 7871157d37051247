# SPDX-License-Identifier: BSD-3-Clause
"""Mapping into tiles on one machine: what is larger than memory, and goes on after it was killed."""

from __future__ import annotations

import hashlib
import math
import os
import time
from collections.abc import Iterable
from dataclasses import asdict
from typing import Any

import numpy as np

from ndtree._errors import WrongValue
from ndtree._native._checked import checked
from ndtree._native._core import OccupancyMap
from ndtree._native.results import InsertReport
from ndtree.base.scan import Scan
from ndtree.tiles.grid import MapKind, Tile, TileGrid, beams_of, reach_of, with_counters
from ndtree.tiles.manifest import (
    TILES,
    Manifest,
    TileEntry,
    commit,
    open_manifest,
    read_map,
    store_bytes,
    store_tile,
    tidy,
)
from ndtree.tiles.resident import Growth, Resident
from ndtree.tiles.storage import Storage, storage_of

#: Memory of cells, unless it is given.
MAX_RESIDENT = 2 << 30
CHECKPOINT_SECONDS = 120.0
_FULL = 0.5  # Of the limit: beyond it tiles go, so that there is room to copy what stays ...
_KEPT = 0.2  # ... until so much is left.
_NODE_BYTES = 16
_LOOKED_AT = 512  # Beams between two looks at memory, and one for each this many nodes:
_NODES_OF_BEAM = 16  # A look takes a fraction of what insertion takes.
_COUNTS = ("beams", "returned", "not_returned", "beyond_max_range", "invalid")


@checked
class TileMapper:
    """Inserts scans one by one, and keeps a bounded part of the map in memory.

    All scans go into one map, so that each costs what it does without tiles; before that, the tiles that it
    crosses are read, and those that rest are written and forgotten. From time to time the whole state is
    written. A mapper that is made anew at the same place begins there: give it all scans again, from the
    first on, and it skips those that it has.

    Parameters
    ----------
    storage : str or os.PathLike or Storage
        The folder of the map, or a URL of fsspec.
    m : OccupancyMap
        Any with the options that the map shall have; it is not changed.
    tile_size : float, optional
        As for `TileGrid.of` [m].
    max_resident : int
        Memory of cells [bytes].
    checkpoint_seconds : float
        Between two states that are written; inf: in the end alone.
    made_from : dict, optional
        What a state must have been made from so that this goes on with it: plain JSON.

    Attributes
    ----------
    done : int
        Scans that the state on disk, if there was one, had taken in.
    seconds : float
        Spent on insertion itself by this mapper [s].

    Raises
    ------
    ValueError
        If there is an unfinished state of another map, or made from something else.
    """

    def __init__(
        self,
        storage: str | os.PathLike[str] | Storage,
        m: OccupancyMap,
        *,
        tile_size: float | None = None,
        max_resident: int = MAX_RESIDENT,
        checkpoint_seconds: float = CHECKPOINT_SECONDS,
        made_from: dict[str, Any] | None = None,
    ) -> None:
        if max_resident < 1 << 20:
            raise WrongValue.of("max_resident", f"{max_resident} bytes", f"at least {1 << 20}")
        self._storage = storage if isinstance(storage, Storage) else storage_of(storage)
        self._kind = MapKind.of(m)
        self._grid = TileGrid.of(m, tile_size)
        self._limit = max_resident
        self._pause = checkpoint_seconds
        self._made_from = made_from or {}
        self._digest = hashlib.blake2b(digest_size=16)
        self._expected = ""
        self._seen = self.done = 0
        self.seconds = 0.0
        self.counts = dict.fromkeys(_COUNTS, 0)
        self._entries: dict[Tile, TileEntry] = {}
        self._frame = self._kind.new()
        self._revision = 0
        self._go_on()
        self._growth = Growth(self._frame.snapshot())
        self._resident = Resident(self._frame, self._grid, self._read)
        self._changed: set[Tile] = set()
        self._beams = 0
        self._patience = _LOOKED_AT
        self._written_at = time.monotonic()

    @property
    def revision(self) -> int:
        """Of the last state that was written; 0: none."""
        return self._revision

    @property
    def map(self) -> OccupancyMap:
        """The part of the map that is in memory."""
        return self._resident.map

    def insert(self, scan: Scan, *, max_range: float = math.inf, threads: int = 0) -> InsertReport | None:
        """Take a scan in, as ``scan.insert_into(map)``.

        Returns
        -------
        InsertReport, or None
            None of a scan that the state on disk knows.

        Raises
        ------
        ValueError
            As ``insert``; or, at the last of the scans that are known, if they were others.
        """
        scan = scan.with_sigma(self._kind.options)
        self._look_at(scan, max_range)
        if self._seen <= self.done:
            if self._seen == self.done and self._digest.hexdigest() != self._expected:
                raise ValueError(
                    f"{self._storage.url}: was begun with other scans: the first {self.done} are not those "
                    "that it holds; map them into another folder"
                )
            return None
        starts, ends = beams_of(scan, self._kind.options, max_range)
        if not self._growth.contains(reach_of(starts, ends)):
            self._growth.include(scan, max_range)  # And refuses what no map takes.
        crossed = self._grid.crossed_by(starts, ends)
        self._resident.hold(crossed)
        report = scan.insert_into(self._resident.map, max_range=max_range, threads=threads)
        self._changed |= crossed
        for name in _COUNTS:
            self.counts[name] += getattr(report, name)
        self.seconds += report.seconds
        self._beams += len(scan)
        if self._beams >= self._patience:
            self._make_room(crossed)
        if time.monotonic() - self._written_at > self._pause:
            self.write()
        return report

    def write(self, *, complete: bool = False) -> Manifest:
        """Write the state as it is now; what was before stays until all of it is there.

        Parameters
        ----------
        complete : bool
            There are no more scans; a mapper that is made here later begins anew.

        Raises
        ------
        ValueError
            If `complete`, and there were fewer scans than the state on disk knows.
        """
        if complete and self._seen < self.done:
            raise ValueError(
                f"{self._storage.url}: was begun with other scans: it holds {self.done}, and there are only "
                f"{self._seen}; map them into another folder"
            )
        revision = self._revision + 1
        self._store(sorted(self._changed))
        stats = self._resident.map.stats()
        frame = with_counters(
            self._growth.map.to_bytes(), stats.updates, stats.splits, stats.merges, stats.scans
        )
        progress = {
            "complete": complete,
            "scans": max(self._seen, self.done),
            "digest": self._digest.hexdigest() if self._seen >= self.done else self._expected,
            "beams": self.counts,
        }
        manifest = Manifest(
            self._kind,
            self._grid,
            revision,
            store_bytes(self._storage, frame, f"{TILES}/frame"),
            dict(self._entries),
            {**self._made_from, "progress": progress},
        )
        commit(self._storage, manifest)
        self._revision = revision
        tidy(self._storage, manifest)
        self._written_at = time.monotonic()
        return manifest

    def _go_on(self) -> None:
        try:
            manifest = open_manifest(self._storage)
        except FileNotFoundError:
            return
        self._revision = manifest.revision
        progress = manifest.made_from.get("progress")
        if not isinstance(progress, dict) or progress.get("complete", True):
            return  # Finished: what comes now takes its place.
        of_others = {key: value for key, value in manifest.made_from.items() if key != "progress"}
        for what, was, now in (
            ("map", asdict(manifest.kind), asdict(self._kind)),
            ("grid", asdict(manifest.grid), asdict(self._grid)),
            ("source", of_others, self._made_from),
        ):
            if was != now:
                key = next(k for k in {**was, **now} if was.get(k) != now.get(k))
                raise ValueError(
                    f"{self._storage.url}: is an unfinished map with another {what}: {key} = {was.get(key)}, "
                    f"now {now.get(key)}; finish it, or map into another folder"
                )
        self._entries = dict(manifest.tiles)
        self._frame = read_map(self._storage, manifest.frame)
        self.done = int(progress["scans"])
        self._expected = str(progress["digest"])
        self.counts = {name: int(progress["beams"][name]) for name in _COUNTS}
        tidy(self._storage, manifest)

    def _look_at(self, scan: Scan, max_range: float) -> None:
        """Scans and their order go into the digest by which one that goes on knows them again."""
        self._seen += 1
        self._digest.update(repr((scan.endpoints.shape, scan.stamp, max_range)).encode())
        for values in (scan.endpoints, scan.origin, scan.returned, scan.range_sigma):
            if values is not None:
                self._digest.update(np.ascontiguousarray(values).data)

    def _read(self, tile: Tile) -> OccupancyMap | None:
        entry = self._entries.get(tile)
        return None if entry is None else read_map(self._storage, entry)

    def _store(self, tiles: Iterable[Tile]) -> None:
        for tile in tiles:
            cells = self._resident.cut_out(tile, self._kind.new())
            if tile in self._entries or self._kind.is_worth_storing(cells):
                entry = store_tile(self._storage, cells, tile, self._revision + 1)
                before = self._entries.get(tile)
                if before is None or before.file != entry.file:
                    self._entries[tile] = entry
        self._changed.difference_update(tiles)

    def _make_room(self, needed: set[Tile]) -> None:
        """Write and forget tiles that were not crossed for longest, if there are too many cells in memory."""
        self._beams = 0
        stats = self._resident.map.stats()
        self._patience = _LOOKED_AT + stats.nodes // _NODES_OF_BEAM
        if stats.memory_bytes <= _FULL * self._limit:
            return
        for tile in self._resident.tiles:
            if tile in needed:
                continue
            self._store([tile] if tile in self._changed else [])
            self._resident.let_go([tile])
            if self._resident.map.stats().nodes * _NODE_BYTES <= _KEPT * self._limit:
                break
        self._resident.map.shrink_to_fit()
