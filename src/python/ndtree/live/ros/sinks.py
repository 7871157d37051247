# SPDX-License-Identifier: BSD-3-Clause
"""What the node publishes of a map; each only while somebody listens, but for the grid."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseArray
from nav_msgs.msg import OccupancyGrid
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import MarkerArray

from ndtree._native._core import OccupancyMap
from ndtree.live.canvas import GridPart, difference
from ndtree.live.grid import GridFollower, GroundFollower
from ndtree.live.outputs import Frontiers, State, cell_points, changed_points
from ndtree.live.passing import Passing, hide
from ndtree.live.ros import messages
from ndtree.live.ros.middleware import Middleware, Publisher
from ndtree.live.ros.parameters import Layer
from ndtree.live.way import Robot
from ndtree.maps.ground import FREE, UNKNOWN
from ndtree.maps.writers.rosbag import octomap_nodes

#: Updates that a subscriber may be behind.
UPDATES = 100


class NodeSink:
    """A sink that publishes by a node.

    `frame`: The frame of the map.
    """

    #: The parameter with its period.
    parameter = ""

    def __init__(self, node: Middleware, frame: Callable[[], str]) -> None:
        self._node, self._frame = node, frame

    @property
    def period(self) -> float:
        """As the node's parameter has it [s]."""
        return float(self._node.value(self.parameter))


class GridSink(NodeSink):
    """``map`` as OccupancyGrid, and ``map_updates`` for what has changed.

    The grid comes as a whole when it has grown, when a subscriber has come, and always if map_msgs is not
    installed.

    `node`, `frame`: As for `NodeSink`.
    `robot`: Where heights may count from, and where the grid may be free.
    `passing`: Where something is no obstacle yet, unless it is one already.
    `layer`: A grid of other heights than those of the parameters, on topics of its own.
    """

    parameter = "grid_period"

    def __init__(
        self,
        node: Middleware,
        frame: Callable[[], str],
        robot: Robot,
        passing: Passing,
        layer: Layer | None = None,
    ) -> None:
        super().__init__(node, frame)
        self._robot, self._passing, self._layer = robot, passing, layer
        topic = "map" if layer is None else f"map_{layer.name}"
        self._maps = node.publisher(OccupancyGrid, topic)
        self._update = messages.optional_class("map_msgs/msg/OccupancyGridUpdate")
        self._updates = (
            None if self._update is None else node.publisher(self._update, f"{topic}_updates", depth=UPDATES)
        )
        self._grid: GridFollower | None = None
        self._made_of: tuple[Any, ...] = ()
        self._values: NDArray[np.int8] | None = None
        self._origin = 0.0, 0.0
        self._differs = False  # From the grid of the map.
        self._z = 0.0
        self._listeners = [0, 0]
        self._lock = threading.Lock()
        self._stamp = 0.0

    def update(self, m: OccupancyMap, stamp: float) -> None:
        with self._lock:
            self._stamp = stamp
            part = self._followed(m)
            has_come = self._has_come()
            if self._values is None:
                return
            if has_come or (part is not None and (part.is_whole or self._updates is None)):
                self._maps.publish(self._message())
            elif part is not None:
                assert self._updates is not None
                self._updates.publish(messages.update_message(self._update, part, self._frame(), stamp))

    def _followed(self, m: OccupancyMap) -> GridPart | None:
        """What of the grid has changed."""
        value, layer = self._node.value, self._layer
        cell_size = value("grid_cell_size") or None
        low, high = (value("grid_low"), value("grid_high")) if layer is None else (layer.low, layer.high)
        above = value("grid_above") if m.dim == 3 else ""
        slope = value("ground_slope") if above == "ground" else 0.0
        if above == "robot" and self._robot.position is not None:
            unit = m.options["min_cell_size"]  # In steps, for the grid is drawn anew at each.
            base = unit * round(float(self._robot.position[2]) / unit)
            low, high = low + base, high + base
        depth = value("grid_wall_depth") or None
        made_of = cell_size, low, high, above, slope, depth
        is_new = self._grid is None or made_of != self._made_of
        if is_new:
            height = (float(low), float(high)) if m.dim == 3 else None
            self._made_of, self._z = made_of, 0.0
            if height is not None and above == "ground":
                self._grid = GroundFollower(cell_size, height, slope, depth)
            else:
                self._grid, self._z = GridFollower(cell_size, height, depth), height[0] if height else 0.0
        assert self._grid is not None
        part = self._grid.follow(m)
        before = self._values
        if self._grid.values is None:  # Nothing is known between these heights: nor is what was shown.
            if before is None or (before == UNKNOWN).all():
                return None
            before[:] = UNKNOWN
            return GridPart(0, 0, before, True)
        radius, places = value("grid_clear"), self._passing.places()
        is_whole = before is None or is_new or (part is not None and part.is_whole)
        if not (is_whole or radius or len(places) or self._differs):
            if part is not None:
                rows, columns = part.values.shape
                before[part.row : part.row + rows, part.column : part.column + columns] = part.values
            return part
        shown = self._cleared(radius) if radius else self._grid.values.copy()
        published = None if before is None else (before, self._origin)
        hide(shown, self._grid.origin, self._grid.cell_size, places, published)
        self._values, self._origin = shown, self._grid.origin
        self._differs = bool(radius) or len(places) > 0
        return GridPart(0, 0, shown, True) if is_whole else difference(before, shown)

    def _cleared(self, radius: float) -> NDArray[np.int8]:
        """The grid, free within a distance of the robot."""
        assert self._grid is not None and self._grid.values is not None
        values = self._grid.values.copy()
        if self._robot.position is not None:
            rows, columns = values.shape
            x, y = (self._robot.position[:2] - self._grid.origin) / self._grid.cell_size - 0.5
            aside = (np.arange(columns) - x) ** 2, (np.arange(rows)[:, None] - y) ** 2
            values[aside[0] + aside[1] <= (radius / self._grid.cell_size) ** 2] = FREE
        return values

    def _has_come(self) -> bool:
        """Whether somebody listens who did not before: to updates, too, which lack what was before."""
        before = self._listeners
        self._listeners = [0 if one is None else one.listeners() for one in (self._maps, self._updates)]
        return any(now > then for now, then in zip(self._listeners, before))

    def _message(self) -> OccupancyGrid:
        assert self._grid is not None and self._values is not None
        place = (*self._origin, self._z)
        return messages.grid_message(self._values, self._grid.cell_size, place, self._frame(), self._stamp)

    def welcome(self) -> None:
        """Send the grid as a whole if a subscriber has come since the last one."""
        with self._lock:
            if self._has_come() and self._values is not None:
                self._maps.publish(self._message())

    def whole(self) -> OccupancyGrid:
        """The grid as it is now; ValueError if nothing is known."""
        with self._lock:
            if self._values is None:
                raise ValueError("nothing is known yet")
            return self._message()


class CellsSink(NodeSink):
    """``~/occupied_cells`` as PointCloud2, ``~/cell_markers`` as MarkerArray, and the same of free cells."""

    parameter = "cells_period"

    def __init__(self, node: Middleware, frame: Callable[[], str]) -> None:
        super().__init__(node, frame)
        self._publishers: dict[State, tuple[Publisher, Publisher]] = {}
        names: dict[State, str] = {"occupied": "~/cell_markers", "free": "~/free_cell_markers"}
        for state, markers in names.items():
            clouds = node.publisher(PointCloud2, f"~/{state}_cells")
            self._publishers[state] = clouds, node.publisher(MarkerArray, markers)

    def update(self, m: OccupancyMap, stamp: float) -> None:
        for state, (clouds, markers) in self._publishers.items():
            to_clouds, to_markers = clouds.listeners(), markers.listeners()
            if not (to_clouds or to_markers):
                continue
            without = state == "occupied" and self._node.value("filter_speckles")
            points = cell_points(m, state, without_speckles=without)
            if to_clouds:
                clouds.publish(messages.cloud_message(points, self._frame(), stamp))
            if to_markers:
                markers.publish(messages.marker_message(points, self._frame(), stamp))


class ChangesSink(NodeSink):
    """``~/changes`` as PointCloud2: what has another state than in the message before."""

    parameter = "cells_period"

    def __init__(self, node: Middleware, frame: Callable[[], str]) -> None:
        super().__init__(node, frame)
        self._clouds = node.publisher(PointCloud2, "~/changes", depth=UPDATES)
        self._seen: OccupancyMap | None = None

    def update(self, m: OccupancyMap, stamp: float) -> None:
        if not self._clouds.listeners():
            self._seen = None
            return
        if self._seen is None or self._seen.options != m.options:  # Then everything is new.
            self._seen = type(m)(dim=m.dim, layers=m.layers, **m.options)
        changes, self._seen = m.changes(since=self._seen), m
        if len(changes.size):
            self._clouds.publish(messages.cloud_message(changed_points(changes), self._frame(), stamp))


class FrontiersSink(NodeSink):
    """``~/frontiers`` as PoseArray."""

    parameter = "frontiers_period"

    def __init__(self, node: Middleware, frame: Callable[[], str]) -> None:
        super().__init__(node, frame)
        self._poses = node.publisher(PoseArray, "~/frontiers")
        self._frontiers = Frontiers(float(node.value("frontier_cells")))

    def update(self, m: OccupancyMap, stamp: float) -> None:
        if self._poses.listeners():
            self._poses.publish(messages.frontier_message(self._frontiers.follow(m), self._frame(), stamp))


class OctomapSink(NodeSink):
    """``~/octomap_full`` and ``~/octomap_binary`` of a 3-D map, if octomap_msgs is installed."""

    parameter = "octomap_period"

    def __init__(self, node: Middleware, frame: Callable[[], str], kind: Any) -> None:
        super().__init__(node, frame)
        self._kind = kind
        self._publishers = {
            binary: node.publisher(kind, f"~/octomap_{'binary' if binary else 'full'}")
            for binary in (False, True)
        }

    def update(self, m: OccupancyMap, stamp: float) -> None:
        for binary, publisher in self._publishers.items():
            if m.dim == 3 and publisher.listeners():
                publisher.publish(self.message(m, stamp, binary=binary))

    def message(self, m: OccupancyMap, stamp: float, *, binary: bool) -> Any:
        """A 3-D map as an Octomap."""
        found = octomap_nodes(m, self._node.value("octomap_cell_size") or None, binary=binary)
        return messages.octomap_message(self._kind, found, self._frame(), stamp, binary=binary)
