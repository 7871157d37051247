# SPDX-License-Identifier: BSD-3-Clause
"""Which points moved, told while scans come in: a fixed number of scans later."""

from __future__ import annotations

import operator
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ndtree._native import _core
from ndtree._native._checked import checked
from ndtree.base.scan import Scan


@checked
class DelayedMoved:
    """Judges scans by those before and after them, as `MovedEvidence` does, while a robot drives.

    What a map held before a scan tells only of space that was seen free. Here each scan is given back once at
    least `after` later ones have come, with the probability that each of its points moved. Scans are judged
    `after` at a time, by themselves and as many on both sides, so that each is read in three windows: three
    times the work of `ndtree clean`, and the memory of three times `after` scans.

    Parameters
    ----------
    dim : int
        2 or 3.
    after : int
        Scans that come before one is judged, at least; at most twice as many do.
    max_range : float
        As of `OccupancyMap.insert` [m].
    **options : float
        As of `MovedEvidence`: cell_size, range_sigma, ...

    Raises
    ------
    ValueError
        If `after` is less than 1, or an option is out of its limits; it is named.
    """

    def __init__(self, *, dim: int, after: int = 20, max_range: float = np.inf, **options: float) -> None:
        if operator.index(after) < 1:
            raise ValueError(f"after = {after}: must be >= 1 scan")
        if not float(max_range) > 0:
            raise ValueError(f"max_range = {max_range} m: must be > 0")
        self._make = lambda: _core.MovedEvidence(dim=dim, **options)
        self._make()  # Options that are wrong are refused here.
        self._after = after
        self._max_range = max_range
        self._judged: list[Scan] = []
        self._waiting: list[Scan] = []

    def add(self, scan: Scan) -> Iterator[tuple[Scan, NDArray[np.float32]]]:
        """Take the next scan.

        Returns
        -------
        iterator of (Scan, (n,) float32)
            Scans that are judged by now, in their order, with the probabilities of their points; 0.5 for
            beams that did not return.

        Raises
        ------
        ValueError
            If the scan cannot be used: see `MovedEvidence.add`.
        """
        self._waiting.append(scan)
        return self._judge(self._after) if len(self._waiting) == 2 * self._after else iter(())

    def finish(self) -> Iterator[tuple[Scan, NDArray[np.float32]]]:
        """Judge the scans that still wait, by fewer later ones. The next scan begins anew."""
        told = self._judge(len(self._waiting))
        self._judged = []
        return told

    def _judge(self, count: int) -> Iterator[tuple[Scan, NDArray[np.float32]]]:
        evidence = self._make()
        for use in (evidence.add, evidence.look):
            for scan in (*self._judged, *self._waiting):
                use(
                    scan.endpoints,
                    scan.origin,
                    returned=scan.returned,
                    max_range=self._max_range,
                    range_sigma=scan.range_sigma,
                )
        self._judged, self._waiting = self._waiting[:count], self._waiting[count:]
        return iter([(scan, self._probability(evidence, scan)) for scan in self._judged])

    def _probability(self, evidence: _core.MovedEvidence, scan: Scan) -> NDArray[np.float32]:
        told = np.asarray(evidence.probability(scan.endpoints))
        told[~scan.hits(self._max_range)] = 0.5
        return told
