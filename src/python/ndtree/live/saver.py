# SPDX-License-Identifier: BSD-3-Clause
"""Writes a map that grows, every so often."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from pathlib import Path

from ndtree._errors import WrongValue
from ndtree._native._core import OccupancyMap
from ndtree.live.session import Session
from ndtree.live.slam import scans_beside
from ndtree.maps.writers import write


class Saver:
    """A sink that writes the map to a file; it appears whole or not at all.

    `path`: Its ending decides the format, as for `ndtree.convert`.
    `period`: From one time to the next [s].
    `session`: What slam can go on with, which is written beside the map, to `scans_beside`.
    """

    def __init__(
        self, path: str | os.PathLike[str], period: float, session: Callable[[], Session] | None = None
    ) -> None:
        if not 0 < period < math.inf:
            raise WrongValue.of("save_every", f"{period:g} s", "> 0 and finite")
        self.path, self.period, self.session = path, period, session

    def update(self, m: OccupancyMap, stamp: float) -> None:
        """Write a map; with slam from the first scan that is placed on."""
        try:
            session = None if self.session is None else self.session()
        except RuntimeError:  # Nothing is placed yet.
            return
        write(m, Path(self.path))
        if session is not None:
            session.save(scans_beside(self.path))
