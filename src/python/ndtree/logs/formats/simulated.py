# SPDX-License-Identifier: BSD-3-Clause
"""Simulated logs, whose truth is known exactly."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ndtree._native import _core
from ndtree._native._checked import checked
from ndtree.base.scan import Scan
from ndtree.logs.core.archive import save_archive
from ndtree.logs.core.log import SizedLog

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from ndtree.base.typing import SimulationOptions, World


@checked
class SimulatedLog(SizedLog):
    """A log that measures each scan when it is asked for, and knows the world that it measures."""

    format = "simulated"
    may_be_padded = False

    def __init__(self, world: str, simulation: Any, moves: bool = False) -> None:
        self.world = world
        self.moves = moves
        self._simulation = simulation
        super().__init__(None, dim=simulation.dim)

    @property
    def name(self) -> str:
        """For example "world office"."""
        return f"world {self.world}"

    def __len__(self) -> int:
        return len(self._simulation)

    def _scans(self) -> Iterator[Scan]:
        for i in range(len(self)):
            yield self[i]

    def save(
        self, path: str | os.PathLike[str], *, progress: Callable[[str, int, int], None] | None = None
    ) -> int:
        """As `Log.save`, with an array ``moving``, (P,) bool, where something moves."""
        fields = (lambda i: {"moving": self.moved(i)}) if self.moves else None
        return save_archive(self._watched(progress), path, self.name, fields)

    def __getitem__(self, i: int) -> Scan:
        """Scan i, which depends on the seed and on i only."""
        if not -len(self) <= i < len(self):
            raise IndexError(f"scan {i}: the log has {len(self)}")
        return Scan(*self._simulation.scan(i % len(self)))

    def moved(self, i: int) -> NDArray[np.bool_]:
        """(n,) bool: which beams of scan i returned from something that moves, exactly; no outlier did."""
        if not -len(self) <= i < len(self):
            raise IndexError(f"scan {i}: the log has {len(self)}")
        return self._simulation.moved(i % len(self))

    def contains(self, points: ArrayLike) -> NDArray[np.bool_]:
        """(n,) bool: whether points (n, dim) in the map frame [m] are inside something solid, or on it."""
        return self._simulation.contains(points)

    def distance(
        self, origins: ArrayLike, directions: ArrayLike, *, max_range: float = math.inf
    ) -> NDArray[np.float64]:
        """(n,) float64: exact distances to the first surface [m], nan where there is none.

        `origins` (n, dim) or (dim,): Where the rays start [m].
        `directions` (n, dim): Of any length but zero.
        `max_range`: Surfaces beyond it do not count [m].
        """
        return self._simulation.distance(origins, directions, max_range=max_range)

    def seen_space(
        self, scans: Iterable[Scan], *, max_range: float = math.inf, **options: Any
    ) -> _core.SeenSpace:
        """Which space scans of this log saw, by the exact line of sight.

        `scans`: Some or all of this log.
        `max_range`: As for `Scan.insert_into` [m]; the sensor's own limits it, too.
        `**options`: As in `SeenSpace`: ``samples``, ``spacings``, ``tolerance`` [m], ``margin`` [m],
            ``middle``, ``seed``.
        Raises ValueError as `SeenSpace`.
        """
        return _core.SeenSpace(scans, max_range=max_range, simulation=self._simulation, **options)


@checked
def simulate(
    world: World, *, seed: int = 1, scans: int | None = None, **options: Unpack[SimulationOptions]
) -> SimulatedLog:
    """Simulate a drive through a world that is known exactly.

    Parameters
    ----------
    world : {"office", "apartment", "street"}
        A planar laser in an office (2-D), a depth camera in an apartment (3-D), a lidar in a street (3-D).
    seed : int
        Of everything random; the world itself is always the same.
    scans : int, optional
        Number of scans, spread evenly along the way. Left out: as many as the world suggests.
    **options
        As in `ndtree.typing.SimulationOptions`: ``noise_scale``, ``outlier_rate``, ``no_return_rate``,
        ``position_sigma`` [m], ``heading_sigma`` [rad], ``yaw`` [rad]; and how many move: ``people``, the
        first of whom walks ahead of the sensor, ``doors`` of the office, and ``cars`` of the street.

    Raises
    ------
    ValueError
        If there is no such world, or an option is out of its limits.
    """
    simulation = _core.simulate(world, seed=seed, scans=scans, **options)
    return SimulatedLog(world, simulation, any(options.get(kind) for kind in ("people", "doors", "cars")))
