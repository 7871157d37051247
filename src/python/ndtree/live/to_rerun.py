# SPDX-License-Identifier: BSD-3-Clause
"""Shows a live map to rerun: to a file, or to a viewer that runs."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from ndtree._lazy import needs
from ndtree._native._core import OccupancyMap
from ndtree.live.grid import GridFollower
from ndtree.live.outputs import GRID_COLORS, Frontiers, Shown, by_size, cell_points, direction_of
from ndtree.maps.ground import FREE, OCCUPIED, UNKNOWN

with needs("ndtree.live.RerunSink needs rerun-sdk", "rerun"):
    import rerun

#: How often the map is shown [s]: each time all occupied cells are written.
PERIOD = 1.0
#: How a viewer's address begins.
ADDRESS = "rerun+"
#: Classes of pixels: rerun has no negative ones.
CLASSES = {UNKNOWN: 0, FREE: 1, OCCUPIED: 2}
_NAMES = {UNKNOWN: "unknown", FREE: "free", OCCUPIED: "occupied"}
#: Arrows of frontiers are so long [m].
ARROW = 0.5


class RerunSink:
    """A sink of a live mapper that writes what changes for rerun.

    ``map/cells/0.05m`` are boxes, an entity for each size of cells, ``map/frontiers`` arrows into the
    unknown, ``map/way`` a line, and ``grid`` the map in the plane as an image of classes, the row of the
    largest y first. The timeline is ``time``, that of the scans.

    `target`: A file whose name ends in .rrd, or the address of a viewer:
        ``rerun+http://127.0.0.1:9876/proxy``.
    `**shown`: Fields of `Shown`: ``period``, ``height``, ``way``, ``min_cells``.
    Raises ValueError if the target is something else, or a number out of its limits.
    """

    def __init__(
        self,
        target: str | os.PathLike[str],
        **shown: Any,
    ) -> None:
        how, name = Shown(**{"period": PERIOD, **shown}), os.fspath(target)
        if not name.startswith(ADDRESS) and Path(name).suffix != ".rrd":
            raise ValueError(
                f"rerun = {name}: expected a file that ends in .rrd, or an address {ADDRESS}http://..."
            )
        self.period, self._way = how.period, how.way
        self._grid, self._frontiers = GridFollower(None, how.height), Frontiers(how.min_cells)
        self._sizes: set[float] = set()
        self._recording = rerun.RecordingStream("ndtree")
        if name.startswith(ADDRESS):
            self._recording.connect_grpc(name)
        else:
            with open(name, "wb"):  # Fails with the reason, which the library would only log.
                pass
            self._recording.save(name)
        context = [(CLASSES[value], _NAMES[value], color) for value, color in GRID_COLORS.items()]
        self._recording.log("grid", rerun.AnnotationContext(context), static=True)

    def update(self, m: OccupancyMap, stamp: float) -> None:
        """Write the map as it is."""
        to = self._recording
        to.set_time("time", timestamp=stamp)
        sizes = set()
        for size, centers, colors in by_size(cell_points(m)):
            sizes.add(size)
            halves = np.full((len(centers), 3), size / 2)
            shown = (255 * colors).round().astype(np.uint8)
            to.log(_cells(size), rerun.Boxes3D(centers=centers, half_sizes=halves, colors=shown))
        for size in self._sizes - sizes:
            to.log(_cells(size), rerun.Clear(recursive=False))
        self._sizes = sizes
        poses = self._frontiers.follow(m)
        origins = np.array([one.position for one in poses]).reshape(-1, 3)
        ways = ARROW * np.array([direction_of(one.quaternion) for one in poses]).reshape(-1, 3)
        to.log("map/frontiers", rerun.Arrows3D(origins=origins, vectors=ways))
        if self._way is not None:
            to.log("map/way", rerun.LineStrips3D([self._way.points()]))
        if self._grid.follow(m) is not None:
            assert self._grid.values is not None
            classes = np.select([self._grid.values == value for value in CLASSES], list(CLASSES.values()))
            to.log("grid", rerun.SegmentationImage(classes[::-1].astype(np.uint8)))

    def close(self) -> None:
        """Write what waits."""
        self._recording.flush()
        self._recording.disconnect()


def _cells(size: float) -> str:
    return f"map/cells/{size:g}m"
