# SPDX-License-Identifier: BSD-3-Clause
"""What the services of a node do with its map."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from enum import IntEnum
from pathlib import Path
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped, Quaternion
from nav_msgs.msg import Path as WayMessage

from ndtree._native._core import OccupancyMap
from ndtree.live.localizing import quaternion_of_yaw
from ndtree.live.mapper import LiveMapper
from ndtree.live.ros.messages import header
from ndtree.live.ros.middleware import Level, Middleware
from ndtree.live.ros.sinks import GridSink, OctomapSink
from ndtree.live.routing import Router
from ndtree.live.slam import scans_beside
from ndtree.maps.open import open_map
from ndtree.maps.writers import write

#: Types of octomap_server's services, which are offered where octomap_msgs is installed.
OCTOMAP_SERVICES = "GetOctomap", "BoundingBoxQuery"


class Loaded(IntEnum):
    """What nav_msgs/LoadMap answers."""

    success = 0
    no_such_file = 1
    no_map = 2


def loaded(path: Path) -> OccupancyMap:
    """A map of any kind."""
    return open_map(path).resampled()


class Services:
    """Answers requests.

    `frame`: That of the map.
    `grid`, `octomap`: What publishes the map as it is asked for; the latter None if octomap_msgs is missing.
    """

    def __init__(
        self,
        node: Middleware,
        mapper: LiveMapper,
        frame: Callable[[], str],
        grid: GridSink,
        octomap: OctomapSink | None,
    ) -> None:
        self._node, self._mapper, self._frame = node, mapper, frame
        self._grid, self._octomap = grid, octomap
        self._router = Router(node.value("plan_unknown"))

    def write(self, file: str) -> None:
        """Write the map to a file, and beside it the scans of slam."""
        write(self._mapper.snapshot(), Path(file))
        if self._node.value("slam"):
            self._mapper.session().save(scans_beside(file))

    def save(self) -> tuple[bool, str]:
        """Write the map to its file; whether that was done, and the file or what went wrong."""
        file = self._node.value("map_file")
        try:
            if not file:
                raise ValueError("map_file is not set, expected the name of a file")
            self.write(file)
        except (ValueError, OSError, RuntimeError, ImportError) as error:
            return False, str(error)
        return True, file

    def load(self, url: str) -> Loaded:
        """Go on with a map of a file."""
        try:
            self._mapper.replace(loaded(Path(url.removeprefix("file://"))))
        except FileNotFoundError:
            return Loaded.no_such_file
        except (ValueError, OSError, RuntimeError) as error:
            self._node.say(Level.error, str(error))
            return Loaded.no_map
        return Loaded.success

    def reset(self) -> None:
        """Forget everything."""
        self._mapper.replace(None)

    def clear_around(self) -> tuple[bool, str]:
        """Forget the box around the sensor; whether that was done, and where or what went wrong."""
        radius = self._node.value("clear_radius")
        try:
            position = self._mapper.position
            if position is None:
                raise RuntimeError("nothing was mapped yet")
            with self._mapper.locked() as m:
                m.clear(np.stack([position - radius, position + radius]))
        except (ValueError, RuntimeError) as error:
            return False, str(error)
        return True, f"within {radius:g} m of {position.tolist()}"

    def clear_box(self, frame: str, points: Sequence[Any]) -> None:
        """Forget the box around points in a frame: in 2-D of x and y alone."""
        if frame not in ("", self._frame()):
            self._node.say(Level.error, f"clear_box: is in {frame}, expected {self._frame()}")
            return
        corners = np.array([[one.x, one.y, one.z] for one in points])
        try:
            with self._mapper.locked() as m:
                m.clear(np.stack([corners.min(axis=0), corners.max(axis=0)])[:, : m.dim])
        except (ValueError, RuntimeError) as error:
            self._node.say(Level.error, f"clear_box: {error}")

    def octomap(self, *, binary: bool) -> Any:
        """The map as it is now as an Octomap; None if there is none, or it is none in space."""
        try:
            m = self._mapper.snapshot()
            if self._octomap is None or m.dim != 3:
                raise ValueError("expected a 3-D map" if self._octomap else "octomap_msgs is not installed")
            return self._octomap.message(m, self._mapper.stamp, binary=binary)
        except (ValueError, RuntimeError) as error:
            self._node.say(Level.warning, f"octomap: {error}")
            return None

    def plan(self, request: Any) -> Any:
        """What a nav_msgs/GetPlan gets: a way in the map's frame; empty if there is none, and why is said.

        The robot is a ball of `robot_radius`; positions alone count, not orientations.
        """
        frame = self._frame()
        empty = WayMessage(header=header(frame, self._mapper.stamp if self._mapper.has_map else 0.0))
        try:
            for name in ("start", "goal"):
                given = getattr(request, name).header.frame_id
                if given not in ("", frame):
                    raise ValueError(f"{name}: is in {given}, expected {frame}")
            m = self._mapper.snapshot()
            ends = [
                np.array([one.pose.position.x, one.pose.position.y, one.pose.position.z])[: m.dim]
                for one in (request.start, request.goal)
            ]
            way = self._router.way(m, *ends, self._node.value("robot_radius"), float(request.tolerance))
        except (ValueError, RuntimeError) as error:
            self._node.say(Level.warning, f"get_plan: {error}")
            return empty
        if not way:
            self._node.say(Level.warning, f"get_plan: {way.reason}")
            return empty
        return _message(way.points, empty)

    def grid(self) -> Any:
        """The grid of the map as it is now; None if nothing is known."""
        try:
            self._grid.update(self._mapper.snapshot(), self._mapper.stamp)
            return self._grid.whole()
        except (ValueError, RuntimeError) as error:
            self._node.say(Level.warning, f"get_map: {error}")
            return None


def _message(points: Any, path: Any) -> Any:
    """Each pose looks along the way that follows it."""
    ahead = np.diff(points, axis=0)
    for point, way in zip(points, [*ahead, *ahead[-1:]]):
        pose = PoseStamped(header=path.header)
        for axis, value in zip("xyz", point):
            setattr(pose.pose.position, axis, float(value))
        x, y, z, w = quaternion_of_yaw(math.atan2(way[1], way[0]))
        pose.pose.orientation = Quaternion(x=x, y=y, z=z, w=w)
        path.poses.append(pose)
    return path
