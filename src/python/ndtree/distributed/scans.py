# SPDX-License-Identifier: BSD-3-Clause
"""Scans of logs in files of some megabytes each, from which maps are made, and made again."""

from __future__ import annotations

import functools
import io
import json
from collections import OrderedDict
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndtree.base.scan import Scan
from ndtree.tiles.grid import Tile
from ndtree.tiles.storage import Storage

#: That are kept in memory: logs that are mixed take turns.
OPEN_FILES = 8
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class IndexedScan:
    """What a plan has to know of a scan.

    Attributes
    ----------
    time : float
        By which it is ordered; see `Place`.
    batch, position : int
        In which file of its log it is, and where in it.
    beams : int
    box : pair of lists, or None
        What it reaches at most [m]; None without a valid beam.
    tiles : tuple of Tile
        Which it may change, sorted.
    """

    time: float
    batch: int
    position: int
    beams: int
    box: tuple[list[float], list[float]] | None
    tiles: tuple[Tile, ...]


@dataclass(frozen=True)
class ScanIndex:
    """All scans of a log, in its order.

    Attributes
    ----------
    log : str
    scans : list of IndexedScan
    batch_bytes : list of int
        Of each file.
    refused : int
        Scans that no map of the kind can take.
    ignored : int
        Beams that were left out because they did not return.
    """

    log: str
    scans: list[IndexedScan]
    batch_bytes: list[int]
    refused: int
    ignored: int

    def as_bytes(self) -> bytes:
        """As a file."""
        content = {
            "log": self.log,
            "batch_bytes": self.batch_bytes,
            "refused": self.refused,
            "ignored": self.ignored,
            "scans": [[s.time, s.batch, s.position, s.beams, s.box, s.tiles] for s in self.scans],
        }
        return json.dumps(content, separators=(",", ":")).encode()

    @classmethod
    def from_bytes(cls, content: bytes) -> ScanIndex:
        """Read what `as_bytes` wrote."""
        held = json.loads(content)
        scans = [
            IndexedScan(time, batch, position, beams, box and (box[0], box[1]), tuple(map(tuple, tiles)))
            for time, batch, position, beams, box, tiles in held["scans"]
        ]
        return cls(held["log"], scans, held["batch_bytes"], held["refused"], held["ignored"])


def index_name(run: str, log: str, revision: int | None = None) -> str:
    """File of a log's index, written when all scans are there; of a later revision, if some were moved."""
    return f"{run}/scans/{_file_of(log)}{'' if revision is None else f'/index-{revision:06d}'}.json"


def batch_name(run: str, log: str, batch: int) -> str:
    """File of some of its scans."""
    return f"{run}/scans/{_file_of(log)}/{batch:06d}.npz"


def pack(scans: Iterable[Scan]) -> bytes:
    """Scans as a file; to the last bit, and of their own types."""
    content: dict[str, Any] = {}
    for number, scan in enumerate(scans):
        scan.require_sensor("maps by many machines")
        content[f"{number}/endpoints"] = scan.endpoints
        content[f"{number}/origin"] = scan.origin
        content[f"{number}/stamp"] = np.float64(scan.stamp)
        for name in ("returned", "range_sigma"):
            if getattr(scan, name) is not None:
                content[f"{number}/{name}"] = getattr(scan, name)
    file = io.BytesIO()
    np.savez(file, **content)
    return file.getvalue()


class Batch:
    """The scans of a file; each is unpacked when it is asked for."""

    def __init__(self, content: bytes) -> None:
        self._arrays = np.load(io.BytesIO(content), allow_pickle=False)

    def __getitem__(self, position: int) -> Scan:
        held = self._arrays

        def optional(name: str) -> Any:
            key = f"{position}/{name}"
            return held[key] if key in held else None

        return Scan(
            held[f"{position}/endpoints"],
            held[f"{position}/origin"],
            optional("returned"),
            float(held[f"{position}/stamp"]),
            optional("range_sigma"),
        )


def moved(scan: Scan, pose: Any) -> Scan:
    """A scan after a rigid motion: every point x of it is at `pose * x`.

    Parameters
    ----------
    scan : Scan
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
    """Scans of several logs, wherever they were stored; the files that were read last stay in memory.

    Parameters
    ----------
    storage : Storage
    run : str
        Folder of the run that stored them.
    moves : dict
        By log, the file of its scans' motions, for logs that have some.
    """

    def __init__(self, storage: Storage, run: str, moves: dict[str, str]) -> None:
        self._storage = storage
        self._run = run
        self._batches: OrderedDict[tuple[str, int], Batch] = OrderedDict()
        self._motions = {
            log: np.asarray(np.load(io.BytesIO(storage.read(name)), allow_pickle=False))
            for log, name in moves.items()
        }
        self.bytes_read = 0

    def get(self, log: str, number: int, batch: int, position: int) -> Scan:
        """The scan with this number in its log, at a position of a file."""
        key = (log, batch)
        if key not in self._batches:
            content = self._storage.read(batch_name(self._run, log, batch))
            self.bytes_read += len(content)
            self._batches[key] = Batch(content)
            if len(self._batches) > OPEN_FILES:
                self._batches.popitem(last=False)
        self._batches.move_to_end(key)
        scan = self._batches[key][position]
        motions = self._motions.get(log)
        if motions is None or np.array_equal(motions[number], np.eye(scan.dim + 1)):
            return scan
        return moved(scan, motions[number])


def _file_of(log: str) -> str:
    """A name for files: those of different logs are different."""
    return "".join(
        c if c.isascii() and (c.isalnum() or c in "-_" or (c == "." and i > 0)) else f"%{ord(c):x}%"
        for i, c in enumerate(log)
    )
