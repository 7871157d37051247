# SPDX-License-Identifier: BSD-3-Clause
"""What a live mapper is made of beside its intake: the map, what happens to it, and who looks at it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from ndtree._native._checked import checked
from ndtree._native._core import AdaptiveMap, OccupancyMap
from ndtree.base.options import default_of
from ndtree.live.corrections import Corrections
from ndtree.live.fading import Fading, Window
from ndtree.live.localizing import Localization, Localizer
from ndtree.live.passing import Passing
from ndtree.live.slam import Slam
from ndtree.live.way import Robot, Way

#: Measurements that wait, and how long one waits for its pose [s].
QUEUE: int = default_of("queue")
PATIENCE: float = default_of("patience")

Make = Callable[[int, "dict[str, Any]"], OccupancyMap]


class Sink(Protocol):
    """Who is shown the map while it grows.

    `period`: Least time from one `update` to the next [s]; 0: after each scan. A sink that takes long is
        shown the map less often, so that it takes a fifth of one processor at most.
    """

    period: float

    def update(self, m: OccupancyMap, stamp: float) -> None:
        """Look at a snapshot of the map, which stays as it is; `stamp` is that of its last scan [s]."""


@checked
@dataclass(frozen=True)
class LiveSettings:
    """How a live mapper maps; each is a keyword of `LiveMapper`, too.

    Attributes
    ----------
    target : OccupancyMap, optional
        The map to go on with. Left out, one is made as the intake decides.
    make : callable
        Makes the map of a dimension and options; an `AdaptiveMap` unless given.
    queue : int
        Measurements that wait at most; the oldest of more is dropped, and counted.
    patience : float
        How long a measurement waits for the poses of its time, by the clock of its source [s].
    threads : int
        That insert, as for `OccupancyMap.insert`.
    window : Window, optional
        What is kept of the map.
    fading : Fading, optional
        What is forgotten because it was not seen for long.
    sinks : sequence of Sink
    way : Way or Robot, optional
        Is told where the sensor is.
    corrections : Corrections, optional
        Moves scans when their poses are corrected. The map is an `AdaptiveMap` then, made of scans alone: not
        with a target, a window or fading, nor changed by others.
    localizer : Localizer, optional
        Finds each scan in `target`, which is not changed then; the intake's map frame is that of odometry.
    localized : callable, optional
        Is told each `Localization`.
    slam : Slam, optional
        Makes the poses of scans, with `corrections`; the intake's map frame is that of odometry.
    passing : Passing, optional
        Is told each scan before it is mapped.

    Raises
    ------
    ValueError
        If a number is out of its limits, or two do not go together.
    """

    target: OccupancyMap | None = None
    make: Make = lambda dim, options: AdaptiveMap(dim=dim, **options)
    queue: int = QUEUE
    patience: float = PATIENCE
    threads: int = 0
    window: Window | None = None
    fading: Fading | None = None
    sinks: Sequence[Sink] = ()
    way: Way | Robot | None = None
    corrections: Corrections | None = None
    localizer: Localizer | None = None
    localized: Callable[[Localization], None] | None = None
    slam: Slam | None = None
    passing: Passing | None = None

    def __post_init__(self) -> None:
        if self.queue < 1:
            raise ValueError(f"queue = {self.queue}: must be >= 1")
        if not self.patience >= 0:
            raise ValueError(f"patience = {self.patience:g} s: must be >= 0")
        for name in ("target", "window", "fading"):
            if self.corrections is not None and getattr(self, name) is not None:
                raise ValueError(
                    f"{name}: expected none, as a map that follows corrections is of scans alone"
                )
        if self.localizer is not None and (
            self.target is None or self.corrections or self.window or self.fading
        ):
            raise ValueError("localizer: expected a target, and nothing that changes it")
        if self.slam is not None and (self.corrections is None or self.localizer is not None):
            raise ValueError("slam: expected corrections, and no localizer")
