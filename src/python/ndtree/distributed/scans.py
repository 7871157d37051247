# SPDX-License-Identifier: BSD-3-Clause
"""Scans of logs in columns that are mapped into memory, from which maps are made, and made again."""

from __future__ import annotations

import functools
import io
import itertools
import math
from collections import OrderedDict
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ndtree.base.scan import Scan
from ndtree.tiles.grid import Tile
from ndtree.tiles.storage import Storage

#: That are kept in memory: logs that are mixed take turns.
OPEN_FILES = 8
Floats = NDArray[np.float64]


class Where(NamedTuple):
    """Where a scan is stored."""

    batch: int  # Of its log.
    position: int  # In the batch.
    row: int  # Its first beam there,
    beams: int  # and how many there are.


@dataclass(frozen=True)
class IndexedScan:
    """What a plan has to know of a scan."""

    time: float  # By which it is ordered; see `Place`.
    where: Where
    box: tuple[list[float], list[float]] | None  # What it reaches at most [m]; None without a valid beam.
    tiles: dict[Tile, int]  # Which it may change, and how much of it is there; see `TileGrid.shares_by`.


@dataclass(frozen=True)
class ScanIndex:
    """All scans of a log, in its order."""

    log: str
    scans: list[IndexedScan]
    stored_bytes: int  # Of all batches.
    refused: int  # Scans that no map of the kind can take.
    ignored: int  # Beams that were left out because they did not return.

    def as_bytes(self) -> bytes:
        """As a file: columns."""
        scans = self.scans
        dim = next((len(scan.box[0]) for scan in scans if scan.box is not None), 1)
        blank = ([math.nan] * dim, [math.nan] * dim)
        tiles = [tile for scan in scans for tile in scan.tiles]
        file = io.BytesIO()
        np.savez(
            file,
            log=np.array(self.log),
            sums=np.array([self.stored_bytes, self.refused, self.ignored]),
            time=np.array([scan.time for scan in scans], dtype=np.float64),
            places=np.array([(*scan.where, len(scan.tiles)) for scan in scans], np.int64).reshape(-1, 5),
            boxes=np.array([scan.box or blank for scan in scans], dtype=np.float64).reshape(-1, 2, dim),
            tiles=np.array(tiles, dtype=np.int64).reshape(len(tiles), -1 if tiles else dim),
            counts=np.array([count for scan in scans for count in scan.tiles.values()], dtype=np.int64),
        )
        return file.getvalue()

    @classmethod
    def from_bytes(cls, content: bytes) -> ScanIndex:
        """Read what `as_bytes` wrote."""
        held = np.load(io.BytesIO(content), allow_pickle=False)
        crossed = iter(zip(map(tuple, held["tiles"].tolist()), held["counts"].tolist()))
        scans = []
        for time, place, box in zip(held["time"].tolist(), held["places"].tolist(), held["boxes"].tolist()):
            *where, tiles = place
            reach = None if math.isnan(box[0][0]) else (box[0], box[1])
            scans.append(IndexedScan(time, Where(*where), reach, dict(itertools.islice(crossed, tiles))))
        stored_bytes, refused, ignored = held["sums"].tolist()
        return cls(str(held["log"]), scans, stored_bytes, refused, ignored)


def index_name(run: str, log: str, revision: int | None = None) -> str:
    """File of a log's index, written when all scans are there; of a later revision, if some were moved."""
    return f"{run}/scans/{_file_of(log)}{'' if revision is None else f'/index-{revision:06d}'}.npz"


def column_name(run: str, log: str, batch: int, column: str) -> str:
    """File of one column of some of its scans."""
    return f"{run}/scans/{_file_of(log)}/{batch:06d}-{column}.npy"


#: Columns with a value for each beam; an origin for all beams of a scan has a row for the scan.
_OF_BEAMS = ("endpoints", "origins", "returned", "range_sigma")
_OF_SCANS = "origin"


def columns_of(scan: Scan) -> dict[str, NDArray[Any]]:
    """What is stored of a scan, to the last bit and of its own types."""
    scan.require_sensor("maps by many machines")
    of_each = scan.origin.ndim > 1
    held = {
        "endpoints": scan.endpoints,
        "origins": scan.origin if of_each else None,
        _OF_SCANS: None if of_each else scan.origin[None],
        "returned": scan.returned,
        "range_sigma": scan.range_sigma,
    }
    return {name: values for name, values in held.items() if values is not None}


class BatchWriter:
    """Stores a log's scans in batches: those that follow each other, as long as they have the same columns.

    `beams`: A batch ends where it has this many.
    """

    def __init__(self, storage: Storage, run: str, log: str, beams: int) -> None:
        self._storage, self._run, self._log, self._most = storage, run, log, beams
        self._waiting: list[dict[str, NDArray[Any]]] = []
        self._kind: list[tuple[str, str]] = []
        self._beams = self._batch = self.stored_bytes = 0

    def add(self, scan: Scan) -> Where:
        """Add the next scan; where it is stored."""
        columns = columns_of(scan)
        kind = [(name, values.dtype.str) for name, values in columns.items()]
        if self._waiting and (kind != self._kind or self._beams >= self._most):
            self.store()
            self._batch += 1
        self._kind = kind
        where = Where(self._batch, len(self._waiting), self._beams, len(scan))
        self._waiting.append(columns)
        self._beams += len(scan)
        return where

    def store(self) -> None:
        """Write what waits."""
        if not self._waiting:
            return
        for name in self._waiting[0]:
            values = np.concatenate([columns[name] for columns in self._waiting])
            file = column_name(self._run, self._log, self._batch, name)
            self.stored_bytes += self._storage.write_array(file, values)
        self._waiting.clear()
        self._beams = 0


def moved(scan: Scan, pose: Any) -> Scan:
    """A scan after a rigid motion: every point x of it is at `pose * x`.

    Parameters
    ----------
    pose : (dim + 1, dim + 1) array of float
        A rotation and a translation.
    """
    matrix = np.asarray(pose, dtype=np.float64)
    turn, shift = matrix[:-1, :-1], matrix[:-1, -1]

    def of(points: NDArray[Any]) -> Floats:
        # Written out, since how a product of matrices rounds is the machine's business.
        flat = np.asarray(points, dtype=np.float64)
        return np.stack(
            [
                functools.reduce(np.add, (turn[a, b] * flat[..., b] for b in range(len(turn)))) + shift[a]
                for a in range(len(turn))
            ],
            axis=-1,
        )

    return Scan(of(scan.endpoints), of(scan.origin), scan.returned, scan.stamp, scan.range_sigma)


def moves_name(run: str, log: str, revision: int) -> str:
    """File of the motions of a log's scans, as of a revision."""
    return f"{run}/scans/{_file_of(log)}/moves-{revision:06d}.npy"


class StoredScans:
    """Scans of several logs, wherever they were stored; the batches that were used last stay open.

    `run`: Folder of the run that stored them.
    `moves`: By log, the file of its scans' motions, for logs that have some.
    """

    def __init__(self, storage: Storage, run: str, moves: dict[str, str]) -> None:
        self._storage = storage
        self._run = run
        self._batches: OrderedDict[tuple[str, int], dict[str, NDArray[Any]]] = OrderedDict()
        self._columns: dict[str, set[str]] = {}
        self._motions = {log: storage.array(name) for log, name in moves.items()}
        self.bytes_read = 0

    def get(self, log: str, number: int, where: Where) -> Scan:
        """The scan with this number in its log."""
        columns, rows = self._batch(log, where.batch), slice(where.row, where.row + where.beams)
        held = {name: columns[name][rows] for name in _OF_BEAMS if name in columns}
        self.bytes_read += sum(values.nbytes for values in held.values())
        origin = held["origins"] if "origins" in held else columns[_OF_SCANS][where.position]
        scan = Scan(held["endpoints"], origin, held.get("returned"), 0.0, held.get("range_sigma"))
        motions = self._motions.get(log)
        if motions is None or np.array_equal(motions[number], np.eye(scan.dim + 1)):
            return scan
        return moved(scan, motions[number])

    def _batch(self, log: str, batch: int) -> dict[str, NDArray[Any]]:
        key = (log, batch)
        if key not in self._batches:
            if log not in self._columns:
                folder = f"{self._run}/scans/{_file_of(log)}"
                self._columns[log] = self._storage.names(folder)
            names = {name: column_name(self._run, log, batch, name) for name in (*_OF_BEAMS, _OF_SCANS)}
            self._batches[key] = {
                name: self._storage.array(file) for name, file in names.items() if file in self._columns[log]
            }
            if len(self._batches) > OPEN_FILES:
                self._batches.popitem(last=False)
        self._batches.move_to_end(key)
        return self._batches[key]


def _file_of(log: str) -> str:
    """A name for files: those of different logs are different."""
    return "".join(
        c if c.isascii() and (c.isalnum() or c in "-_" or (c == "." and i > 0)) else f"%{ord(c):x}%"
        for i, c in enumerate(log)
    )
