# SPDX-License-Identifier: BSD-3-Clause
"""Folders with a file for each scan: what all of them have in common."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from ndtree.readers.log import SizedLog
from ndtree.readers.source import ReaderOption
from ndtree.readers.trajectory import Pose
from ndtree.scan import Scan

TIME_OFFSET = ReaderOption("time_offset", float, "Added to the times of scans to find their poses [s].")


class FolderLog(SizedLog):
    """One file a scan, of which one is in memory at a time.

    Parameters
    ----------
    path : str
        The folder.
    files : sequence of str
        Paths, in the order of the scans.
    """

    def __init__(self, path: str, files: Sequence[str]) -> None:
        super().__init__(path, dim=3)
        self._files = files

    def __len__(self) -> int:
        return len(self._files)

    def _scans(self) -> Iterator[Scan]:
        for i in range(len(self)):
            try:
                T_map_sensor = self._pose(i)
            except (ValueError, OSError) as error:
                self._skip("scans without a pose", error)
                continue
            try:
                points = self._points(i)
            except (ValueError, OSError) as error:
                self._skip("damaged scans", error)
                continue
            yield Scan(self._in_map(points, T_map_sensor), T_map_sensor.position, stamp=self._stamp(i))

    @abstractmethod
    def _pose(self, i: int) -> Pose:
        """T_map_sensor of a scan."""

    @abstractmethod
    def _points(self, i: int) -> NDArray[np.floating]:
        """(n, 3): what a scan measured [m]."""

    def _stamp(self, i: int) -> float:
        """Time of a scan [s]; 0 where there is none."""
        return 0.0

    def _in_map(self, points: NDArray[np.floating], T_map_sensor: Pose) -> NDArray[np.floating]:
        return T_map_sensor.apply(points)
