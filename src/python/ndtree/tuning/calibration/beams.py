# SPDX-License-Identifier: BSD-3-Clause
"""The scans of a log, as calibration reads them: checked beams, and a bounded sample of their ends."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndtree.base.progress import Progress
from ndtree.base.scan import Scan
from ndtree.logs.core.joined import Again
from ndtree.logs.core.log import Log
from ndtree.tuning.calibration.figures import Bools, Floats

MOST_POINTS = 1_000_000  # End points kept, at random.
FARTHEST = 1e9  # Coordinates [m] that the grid of the neighbours can count.


class Scans(Log):
    """Scans that are no log, kept."""

    format = "scans"

    def __init__(self, scans: Iterable[Scan]) -> None:
        self._kept = list(scans)
        super().__init__(None, dim=self._kept[0].dim if self._kept else 2)

    def __len__(self) -> int:
        return len(self._kept)

    def _scans(self) -> Iterator[Scan]:
        return iter(self._kept)


class Source:
    """The scans of a log up to a limit, checked, as often as needed."""

    def __init__(self, log: Log, limit: int | None, progress: Progress) -> None:
        self.log = log
        self._scans = Again(log, limit)
        self.progress = progress
        self._total = len(log) if hasattr(log, "__len__") else 0
        if limit is not None:
            self._total = min(self._total, limit)

    def beams(self, what: str, max_range: float) -> Iterator[tuple[int, Beams]]:
        """The number of each scan, from 0, and its beams."""
        i = -1
        dim = self.log.dim
        for i, scan in enumerate(self._scans):
            if dim not in (2, 3):
                raise ValueError(f"{self.log.name}: scan {i} is {dim}-D: must be 2-D or 3-D")
            if scan.dim != dim:
                raise ValueError(f"{self.log.name}: scan {i} is {scan.dim}-D: must be {dim}-D as the first")
            with self.naming(i):
                beams = Beams(scan, max_range)
            yield i, beams
            self.progress(what, i + 1, self._total)
        if i < 0:
            raise self.log.without_scans()

    @contextmanager
    def naming(self, i: int) -> Iterator[None]:
        """Errors in here say which scan they are about."""
        try:
            yield
        except ValueError as error:
            raise ValueError(f"{self.log.name}: scan {i}: {error}") from None


class Beams:
    """The beams of a scan that say something, none longer than `max_range`."""

    def __init__(self, scan: Scan, max_range: float) -> None:
        origin = np.broadcast_to(np.asarray(scan.origin, dtype=np.float64), scan.endpoints.shape)
        way = scan.endpoints - origin
        length = np.linalg.norm(way, axis=1)
        use = np.isfinite(length) & (length > 0)
        far = use & ((np.abs(origin) > FARTHEST) | (np.abs(scan.endpoints) > FARTHEST)).any(axis=1)
        if far.any():
            beam = int(np.flatnonzero(far)[0])
            raise ValueError(
                f"beam {beam} reaches {scan.endpoints[beam].tolist()} m: "
                f"must be within {FARTHEST:g} m of the map's origin"
            )
        self.origin = origin[use]
        self.direction = way[use] / length[use, None]
        self.hit = scan.did_return[use] & (length[use] <= max_range)
        self.length = np.minimum(length[use], max_range)

    def at(self, distance: Floats) -> Floats:
        return self.origin + distance[:, None] * self.direction

    def only(self, use: Bools) -> Beams:
        part = object.__new__(Beams)
        for name, array in vars(self).items():
            setattr(part, name, array[use])
        return part


class Points:
    """A random sample of the end points that returned, all equally likely, of bounded size."""

    end: Floats
    direction: Floats
    length: Floats
    scan: NDArray[np.int64]

    def __init__(self, generator: np.random.Generator) -> None:
        self._generator = generator
        self._share = 1.0
        self._kept: list[tuple[NDArray[Any], ...]] = []
        self._count = 0
        self.longest = 0.0

    def add(self, beams: Beams, scan: int) -> None:
        if beams.hit.any():
            self.longest = max(self.longest, float(beams.length[beams.hit].max()))
        use = beams.hit
        if self._share < 1:
            use = use & (self._generator.random(len(use)) < self._share)
        one = beams.only(use)
        self._kept.append((one.at(one.length), one.direction, one.length, np.full(len(one.length), scan)))
        self._count += len(one.length)
        while self._count > 2 * MOST_POINTS:
            self._thin(0.5)

    def finish(self) -> None:
        if self._count > MOST_POINTS:
            self._thin(MOST_POINTS / self._count)
        self.end, self.direction, self.length, self.scan = (np.concatenate(part) for part in zip(*self._kept))
        self._kept = []

    def _thin(self, share: float) -> None:
        arrays = tuple(np.concatenate(part) for part in zip(*self._kept))
        use = self._generator.random(len(arrays[0])) < share
        self._kept = [tuple(array[use] for array in arrays)]
        self._count = len(self._kept[0][0])
        self._share *= share
