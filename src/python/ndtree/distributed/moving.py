# SPDX-License-Identifier: BSD-3-Clause
"""Scans of a tiled map that move: their new places are written, and the blocks that they touch collected."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ndtree._native._core import pose_matrix
from ndtree.distributed.blocks import Block
from ndtree.distributed.scans import ScanIndex, StoredScans, index_name, moved, moves_name
from ndtree.distributed.stages import Job, indexed
from ndtree.tiles.storage import Storage


class Moves:
    """Motions of scans, and their places.

    Attributes:
    `names`, `moves`, `indexes`: Of each log the file of its index, that of its motions, and the index.
    `touched`: Blocks that scans cross now, or crossed.
    """

    def __init__(self, storage: Storage, job: Job, held: Mapping[str, Any]) -> None:
        self._storage, self._job = storage, job
        self.names, self.moves = dict(held["indexes"]), dict(held["moves"])
        self.indexes = {log: ScanIndex.from_bytes(storage.read(name)) for log, name in self.names.items()}
        self.touched: set[Block] = set()
        self._blocks = [Block.from_json(one["block"]) for one in held["blocks"]]
        self._original = StoredScans(storage, job.run, {})

    def log(self, log: str, poses: Mapping[int, ArrayLike]) -> None:
        """Move scans of a log."""
        if log not in self.indexes:
            raise ValueError(f"log {log!r}: must be one of {', '.join(self.indexes)}")
        job, index = self._job, self.indexes[log]
        motions = np.tile(np.eye(job.kind.dim + 1), (len(index.scans), 1, 1))
        if log in self.moves:
            motions = np.array(self._storage.array(self.moves[log]))
        for number, pose in sorted(poses.items()):
            if not 0 <= number < len(index.scans):
                raise ValueError(f"log {log!r}: scan {number}: there are {len(index.scans)}")
            matrix = pose_matrix(pose, dim=job.kind.dim, name=f"log {log!r}: scan {number}: pose")
            if not np.array_equal(matrix, motions[number]):
                motions[number] = matrix
                self._scan(log, index, number, matrix)
        self.moves[log] = moves_name(job.run, log, job.revision)
        self._storage.write_array(self.moves[log], motions)
        self.names[log] = index_name(job.run, log, job.revision)
        self._storage.write(self.names[log], index.as_bytes())

    def _scan(self, log: str, index: ScanIndex, number: int, matrix: Any) -> None:
        before = index.scans[number]
        scan = self._original.get(log, number, before.where)
        there = indexed(self._job, moved(scan, matrix), before.time, before.where)
        index.scans[number] = there
        tiles = {*before.tiles, *there.tiles}
        self.touched.update(block for block in self._blocks if any(tile in block for tile in tiles))
