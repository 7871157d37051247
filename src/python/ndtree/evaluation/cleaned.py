# SPDX-License-Identifier: BSD-3-Clause
"""A log's own points without those that moved, or with how probable that is, as files."""

from __future__ import annotations

import itertools
import os
import shutil
from abc import ABC, abstractmethod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndtree.base.files import replaced, require_no_input
from ndtree.base.progress import Progress
from ndtree.base.scan import Scan
from ndtree.evaluation.moved import THRESHOLD, MovedPoints
from ndtree.logs import Log
from ndtree.logs.core.archive import is_archive, require_of_archive, save_archive
from ndtree.logs.core.log import SizedLog
from ndtree.logs.folders.cloud_rows import write_cloud, write_rows
from ndtree.logs.folders.point_clouds import PointCloudLog
from ndtree.logs.formats.npz import NpzLog

ENDINGS = (".npz", ".ply", ".pcd")

Bools = NDArray[np.bool_]
Floats = NDArray[np.float32]


class Writer(ABC):
    """Takes a log's scans one by one, and writes what is kept of them."""

    def __init__(self, log: Log, target: Path, mark: bool) -> None:
        self.log = log
        self.target = target
        self.mark = mark  # Nothing is left out, and the probabilities are written.

    def check(self) -> None:  # noqa: B027
        """Refuse a log whose scans the file cannot hold, by the first, before the others are looked at."""

    @abstractmethod
    def take(self, scan: Scan, moved: Floats, keep: Bools) -> None: ...

    @abstractmethod
    def finish(self) -> None: ...


class _Archive(Writer):
    """An .npz; of another one all arrays are kept, those with an entry for each point without what moved."""

    def __init__(self, log: Log, target: Path, mark: bool) -> None:
        super().__init__(log, target, mark)
        self._scans: list[Scan] = []
        self._moved: list[Floats] = []
        self._keep: list[Bools] = []

    def check(self) -> None:
        if not isinstance(self.log, NpzLog):
            for scan in itertools.islice(self.log, 1):
                require_of_archive(scan, 0, self.log.name)

    def take(self, scan: Scan, moved: Floats, keep: Bools) -> None:
        if not isinstance(self.log, NpzLog):
            self._scans.append(scan.only(keep))
        self._moved.append(moved)
        self._keep.append(keep)

    def finish(self) -> None:
        if not isinstance(self.log, NpzLog):
            fields = (lambda i: {"moved": self._moved[i]}) if self.mark else None
            save_archive(self._scans, self.target, self.log.name, fields)
            return
        keep = np.concatenate(self._keep) if self._keep else np.zeros(0, bool)
        with np.load(self.log.path or "", allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        points = len(arrays["points"])
        per_scan = len(arrays["origins"])
        if self.mark:
            arrays["moved"] = np.concatenate(self._moved)
        else:
            counts = [int(np.count_nonzero(one)) for one in self._keep]
            for name, values in arrays.items():
                # Where there are as many points as scans, names decide.
                is_of_points = values.ndim > 0 and len(values) == points
                is_of_scans = name in ("origins", "poses", "stamps")
                if is_of_points and not (points in (per_scan, per_scan + 1) and is_of_scans):
                    arrays[name] = values[keep]
            arrays["offsets"] = np.cumsum([0, *counts]).astype(arrays["offsets"].dtype)
        with replaced(self.target, is_archive) as part:
            np.savez_compressed(part, **arrays)


class _OneCloud(Writer):
    """All points that returned, in the map's frame, with the number of their scan and an archive's fields."""

    def __init__(self, log: Log, target: Path, mark: bool) -> None:
        super().__init__(log, target, mark)
        self._columns: dict[str, list[NDArray[Any]]] = {}
        self._number = 0
        self._first = 0
        self._fields: dict[str, NDArray[Any]] = {}
        if isinstance(log, NpzLog):
            with np.load(log.path or "", allow_pickle=False) as archive:
                count = len(archive["points"])
                for name in archive.files:
                    if name in ("points", "offsets", "origins", "stamps", "poses", "no_return"):
                        continue
                    values = archive[name]
                    if values.shape == (count,) and values.dtype.kind in "buif":
                        self._fields[name] = _small(values)

    def take(self, scan: Scan, moved: Floats, keep: Bools) -> None:
        use = keep & scan.did_return & np.isfinite(scan.endpoints).all(axis=1)
        points = scan.endpoints[use]
        small = points.dtype == np.float32 or np.abs(points).max(initial=0.0) < 1e4
        kind = np.float32 if small else np.float64
        columns: dict[str, NDArray[Any]] = {
            axis: points[:, k].astype(kind) if k < scan.dim else np.zeros(len(points), kind)
            for k, axis in enumerate("xyz")
        }
        columns["scan"] = np.full(len(points), self._number, np.int32)
        for name, values in self._fields.items():
            columns[name] = values[self._first : self._first + len(scan)][use]
        if self.mark:
            columns["moved"] = moved[use]
        for name, values in columns.items():
            self._columns.setdefault(name, []).append(values)
        self._number += 1
        self._first += len(scan)

    def finish(self) -> None:
        with replaced(self.target) as part:
            write_cloud(part, {name: np.concatenate(values) for name, values in self._columns.items()})


class _Folder(Writer):
    """The files of a folder of clouds, each with its own fields; all else in the folder is copied."""

    log: PointCloudLog

    def __init__(self, log: PointCloudLog, target: Path, mark: bool) -> None:
        super().__init__(log, target, mark)
        source = Path(log.path or "")
        self._source = source if source.is_dir() else source.parent
        require_no_input(target, [self._source])
        if target.exists() and not target.is_dir():
            raise ValueError(f"{target}: is a file, expected a folder")

    def take(self, scan: Scan, moved: Floats, keep: Bools) -> None:
        assert self.log.file is not None
        name = os.path.basename(self.log.file)
        self.target.mkdir(parents=True, exist_ok=True)
        with replaced(self.target / name) as part:
            write_rows(self.log.file, str(part), keep, moved if self.mark else None)

    def finish(self) -> None:
        clouds = {os.path.basename(file) for file in self.log._files}
        for path in sorted(self._source.iterdir()):
            if path.is_file() and path.name not in clouds:
                shutil.copy2(path, self.target / path.name)


def writer_of(log: Log, target: Path, mark: bool) -> Writer:
    """What writes a file or folder with this name.

    Raises ValueError if a log of this kind cannot be written so.
    """
    if log.path:
        require_no_input(target, [log.path])
    ending = target.suffix.lower()
    if ending == ".npz":
        return _Archive(log, target, mark)
    if ending in (".ply", ".pcd"):
        return _OneCloud(log, target, mark)
    if isinstance(log, PointCloudLog):
        return _Folder(log, target, mark)
    raise ValueError(
        f"{target}: expected {', '.join(ENDINGS)}; a folder is for a folder of PCD, PLY, LAS or LAZ files, "
        f"and the format of {log.name} is {log.format}"
    )


class Cleaned:
    """A log on its way to a file, and what became of its points.

    `points`: That has looked.
    `keeps_points`: For a picture.
    """

    def __init__(self, points: MovedPoints, writer: Writer, keeps_points: bool) -> None:
        self._points = points
        self._writer = writer
        self._keeps_points = keeps_points
        self.scans = self.points = self.moved = self.unknown = 0
        self.removed: list[Bools] = []
        self.truth: list[Bools] = []
        self._seen: list[tuple[NDArray[Any], Bools]] = []

    def write(self, progress: Progress) -> None:
        """Go over the scans once more, and write them.

        Raises ValueError if there is no scan, or a scan cannot be written so.
        """
        log = self._writer.log
        total = len(log) if isinstance(log, SizedLog) else 0
        truth = self._truth(log)
        first = 0
        for scan in log if isinstance(self._writer, _Folder) else self._points.again:  # A folder has files.
            moved = self._points.probability(scan)
            returned = scan.hits(self._points.max_range)
            went = returned & (moved > THRESHOLD)
            self._writer.take(scan, moved, np.ones(len(scan), bool) if self._writer.mark else ~went)
            self.scans += 1
            self.points += int(np.count_nonzero(returned))
            self.moved += int(np.count_nonzero(went))
            self.unknown += int(np.count_nonzero(returned & (moved == THRESHOLD)))
            if truth is not None:
                self.removed.append(went[returned])
                self.truth.append(truth[first : first + len(scan)][returned])
                first += len(scan)
            if self._keeps_points:
                self._seen.append((scan.endpoints[returned], went[returned]))
            progress("writing", self.scans, total)
        if not self.scans:
            raise log.without_scans()
        self._writer.finish()

    @staticmethod
    def _truth(log: Log) -> Bools | None:
        """What an archive itself says of its points."""
        if not isinstance(log, NpzLog):
            return None
        with np.load(log.path or "", allow_pickle=False) as archive:
            if "moving" not in archive.files:
                return None
            truth = archive["moving"]
            return truth if truth.shape == (len(archive["points"]),) and truth.dtype == np.bool_ else None

    def draw(self, path: Path) -> None:
        """Draw all points from above, moving ones in red, and beside it what is left."""
        from ndtree.plot.points import moved_points

        points = np.concatenate([one for one, _ in self._seen])
        moved_points(points, np.concatenate([moved for _, moved in self._seen]), path)


def _small(values: NDArray[Any]) -> NDArray[Any]:
    """In a type that PLY has."""
    if values.dtype.kind == "b":
        return values.astype(np.uint8)
    if values.dtype.itemsize == 8 and values.dtype.kind in "iu":
        return values.astype(np.int32)
    return values.astype(np.float32) if values.dtype == np.float16 else values
