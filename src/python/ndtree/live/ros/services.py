# SPDX-License-Identifier: BSD-3-Clause
"""What the services of a node do with its map."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from geometry_msgs.msg import PolygonStamped, PoseStamped
from nav_msgs.msg import Path as WayMessage
from nav_msgs.srv import GetMap, GetPlan, LoadMap
from std_srvs.srv import Empty, Trigger

from ndtree._native._core import OccupancyMap
from ndtree.live.localizing import quaternion_of_yaw
from ndtree.live.mapper import LiveMapper
from ndtree.live.ros.messages import header, optional_class, pose_message
from ndtree.live.ros.middleware import Level, Middleware
from ndtree.live.ros.sinks import GridSink, OctomapSink
from ndtree.live.routing import Router
from ndtree.live.slam import scans_beside
from ndtree.maps.open import open_map
from ndtree.maps.writers import write

#: Fields of an answer; those left out are empty.
Fields = dict[str, Any]
#: What nav_msgs/LoadMap answers.
_LOADED, _NO_SUCH_FILE, _NO_MAP = range(3)


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

    def offered(self) -> dict[str, tuple[Any, Callable[[Any], Fields]]]:
        """By name, the class of each service, and its answer; octomap_server's where octomap_msgs is."""
        found: dict[str, tuple[Any, Callable[[Any], Fields]]] = {
            "save": (Trigger, self._save),
            "load": (LoadMap, self._load),
            "reset": (Empty, self._reset),
            "clear_around": (Trigger, self._clear_around),
            "get_map": (GetMap, self._told("get_map", self._get_map)),
            "get_plan": (GetPlan, self._get_plan),
        }
        get, query = (optional_class(f"octomap_msgs/srv/{one}") for one in ("GetOctomap", "BoundingBoxQuery"))
        if query is not None:
            found["octomap_full"] = get, self._told("octomap", lambda request: self._get_octomap(False))
            found["octomap_binary"] = get, self._told("octomap", lambda request: self._get_octomap(True))
            found["clear_bbox"] = query, lambda request: self._clear_box("", [request.min, request.max])
        return found

    def clear(self, polygon: PolygonStamped) -> None:
        """Forget the box around a polygon: in 2-D of x and y alone."""
        self._clear_box(polygon.header.frame_id, polygon.polygon.points)

    def write(self, file: str) -> None:
        """Write the map to a file, and beside it the scans of slam."""
        write(self._mapper.snapshot(), Path(file))
        if self._node.value("slam"):
            self._mapper.session().save(scans_beside(file))

    def _told(self, name: str, answer: Callable[[Any], Fields]) -> Callable[[Any], Fields]:
        """An answer that is empty, and why is said, where there is none."""

        def told(request: Any) -> Fields:
            try:
                return answer(request)
            except (ValueError, RuntimeError) as error:
                self._node.say(Level.warning, f"{name}: {error}")
                return {}

        return told

    def _save(self, request: Any) -> Fields:
        file = self._node.value("map_file")
        try:
            if not file:
                raise ValueError("map_file is not set, expected the name of a file")
            self.write(file)
        except (ValueError, OSError, RuntimeError, ImportError) as error:
            return {"success": False, "message": str(error)}
        return {"success": True, "message": file}

    def _load(self, request: Any) -> Fields:
        """Go on with a map of a file."""
        try:
            self._mapper.replace(loaded(Path(request.map_url.removeprefix("file://"))))
        except FileNotFoundError:
            return {"result": _NO_SUCH_FILE}
        except (ValueError, OSError, RuntimeError) as error:
            self._node.say(Level.error, str(error))
            return {"result": _NO_MAP}
        return {"result": _LOADED}

    def _reset(self, request: Any) -> Fields:
        self._mapper.replace(None)
        return {}

    def _clear_around(self, request: Any) -> Fields:
        """Forget the box around the sensor."""
        radius = self._node.value("clear_radius")
        try:
            position = self._mapper.position
            if position is None:
                raise RuntimeError("nothing was mapped yet")
            with self._mapper.locked() as m:
                m.clear(np.stack([position - radius, position + radius]))
        except (ValueError, RuntimeError) as error:
            return {"success": False, "message": str(error)}
        return {"success": True, "message": f"within {radius:g} m of {position.tolist()}"}

    def _clear_box(self, frame: str, points: Sequence[Any]) -> Fields:
        corners = np.array([[one.x, one.y, one.z] for one in points])
        try:
            if frame not in ("", self._frame()):
                raise ValueError(f"is in {frame}, expected {self._frame()}")
            with self._mapper.locked() as m:
                m.clear(np.stack([corners.min(axis=0), corners.max(axis=0)])[:, : m.dim])
        except (ValueError, RuntimeError) as error:
            self._node.say(Level.error, f"clear_box: {error}")
        return {}

    def _get_octomap(self, binary: bool) -> Fields:
        m = self._mapper.snapshot()
        if self._octomap is None or m.dim != 3:
            raise ValueError("expected a 3-D map" if self._octomap else "octomap_msgs is not installed")
        return {"map": self._octomap.message(m, self._mapper.stamp, binary=binary)}

    def _get_map(self, request: Any) -> Fields:
        self._grid.update(self._mapper.snapshot(), self._mapper.stamp)
        return {"map": self._grid.whole()}

    def _get_plan(self, request: Any) -> Fields:
        """A way in the map's frame, of a ball of `robot_radius`; positions alone count, not orientations."""
        frame = self._frame()
        plan = WayMessage(header=header(frame, self._mapper.stamp if self._mapper.has_map else 0.0))
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
            if not way:
                raise ValueError(way.reason)
            plan.poses = _along(way.points, plan.header)
        except (ValueError, RuntimeError) as error:
            self._node.say(Level.warning, f"get_plan: {error}")
        return {"plan": plan}


def _along(points: Any, header: Any) -> list[PoseStamped]:
    """Poses on a way; each looks along what follows."""
    ahead = np.diff(points, axis=0)
    turns = (quaternion_of_yaw(math.atan2(way[1], way[0])) for way in (*ahead, *ahead[-1:]))
    return [
        PoseStamped(header=header, pose=pose_message([*point, 0.0][:3], turn))
        for point, turn in zip(points, turns)
    ]
