# SPDX-License-Identifier: BSD-3-Clause
"""What the node publishes of a map; each only while somebody listens, but for the grid."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from geometry_msgs.msg import PoseArray
from nav_msgs.msg import OccupancyGrid
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import MarkerArray

from ndtree._native._core import OccupancyMap
from ndtree.live.grid import GridFollower
from ndtree.live.outputs import Frontiers, occupied_points
from ndtree.live.ros.messages import (
    cloud_message,
    frontier_message,
    grid_message,
    marker_message,
    octomap_message,
    optional_class,
    update_message,
)
from ndtree.live.ros.middleware import Middleware
from ndtree.maps.writers.rosbag import octomap_nodes

#: Updates that a subscriber may be behind.
UPDATES = 100


class NodeSink:
    """A sink that publishes by a node.

    Parameters
    ----------
    node : Middleware
    frame : callable
        The frame of the map.
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
    """

    parameter = "grid_period"

    def __init__(self, node: Middleware, frame: Callable[[], str]) -> None:
        super().__init__(node, frame)
        self._maps = node.publisher(OccupancyGrid, "map")
        self._update = optional_class("map_msgs/msg/OccupancyGridUpdate")
        self._updates = (
            None if self._update is None else node.publisher(self._update, "map_updates", depth=UPDATES)
        )
        self._height: tuple[float, float] | None = None
        self._grid: GridFollower | None = None
        self._listeners = [0, 0]
        self._lock = threading.Lock()
        self._stamp = 0.0
        self.sent_bytes = 0

    @property
    def has_updates(self) -> bool:
        """Whether map_msgs is installed."""
        return self._update is not None

    def update(self, m: OccupancyMap, stamp: float) -> None:
        with self._lock:
            self._stamp = stamp
            height = None
            if m.dim == 3:
                height = float(self._node.value("grid_low")), float(self._node.value("grid_high"))
            if self._grid is None or height != self._height:
                self._grid = GridFollower(self._node.value("grid_cell_size") or None, height)
                self._height = height
            part = self._grid.follow(m)
            has_come = self._has_come()
            if self._grid.values is None:
                return
            if has_come or (part is not None and (part.is_whole or self._updates is None)):
                self._send_whole()
            elif part is not None:
                assert self._updates is not None
                self._updates.publish(update_message(self._update, part, self._frame(), stamp))
                self.sent_bytes += part.values.size

    def _has_come(self) -> bool:
        """Whether somebody listens who did not before: to updates, too, which lack what was before."""
        before = self._listeners
        self._listeners = [0 if one is None else one.listeners() for one in (self._maps, self._updates)]
        return any(now > then for now, then in zip(self._listeners, before))

    def _send_whole(self) -> None:
        assert self._grid is not None and self._grid.values is not None
        z = self._height[0] if self._height else 0.0
        self._maps.publish(grid_message(self._grid, self._frame(), self._stamp, z))
        self.sent_bytes += self._grid.values.size

    def welcome(self) -> None:
        """Send the grid as a whole if a subscriber has come since the last one."""
        with self._lock:
            if self._has_come() and self._grid is not None and self._grid.values is not None:
                self._send_whole()

    def whole(self) -> OccupancyGrid:
        """The grid as it is now; ValueError if nothing is known."""
        with self._lock:
            if self._grid is None or self._grid.values is None:
                raise ValueError("nothing is known yet")
            z = self._height[0] if self._height else 0.0
            return grid_message(self._grid, self._frame(), self._stamp, z)


class CellsSink(NodeSink):
    """``~/occupied_cells`` as PointCloud2, and ``~/cell_markers`` as MarkerArray."""

    parameter = "cells_period"

    def __init__(self, node: Middleware, frame: Callable[[], str]) -> None:
        super().__init__(node, frame)
        self._clouds = node.publisher(PointCloud2, "~/occupied_cells")
        self._markers = node.publisher(MarkerArray, "~/cell_markers")

    def update(self, m: OccupancyMap, stamp: float) -> None:
        to_clouds, to_markers = (one.listeners() for one in (self._clouds, self._markers))
        if not (to_clouds or to_markers):
            return
        points = occupied_points(m)
        if to_clouds:
            self._clouds.publish(cloud_message(points, self._frame(), stamp))
        if to_markers:
            self._markers.publish(marker_message(points, self._frame(), stamp))


class FrontiersSink(NodeSink):
    """``~/frontiers`` as PoseArray."""

    parameter = "frontiers_period"

    def __init__(self, node: Middleware, frame: Callable[[], str]) -> None:
        super().__init__(node, frame)
        self._poses = node.publisher(PoseArray, "~/frontiers")
        self._frontiers = Frontiers(float(node.value("frontier_cells")))

    def update(self, m: OccupancyMap, stamp: float) -> None:
        if self._poses.listeners():
            self._poses.publish(frontier_message(self._frontiers.follow(m), self._frame(), stamp))


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
                found = octomap_nodes(m, None, binary=binary)
                publisher.publish(octomap_message(self._kind, *found, self._frame(), stamp, binary=binary))
