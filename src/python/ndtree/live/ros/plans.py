# SPDX-License-Identifier: BSD-3-Clause
"""nav_msgs/GetPlan of a node: a way through the map as it is now."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped, Quaternion
from nav_msgs.msg import Path

from ndtree.live.localizing import quaternion_of_yaw
from ndtree.live.mapper import LiveMapper
from ndtree.live.ros.messages import header
from ndtree.live.ros.middleware import Level, Middleware
from ndtree.live.routing import Router


class Plans:
    """Answers requests. The robot is a ball of `robot_radius`; positions alone count, not orientations."""

    def __init__(self, node: Middleware, mapper: LiveMapper) -> None:
        self._node, self._mapper = node, mapper
        self._router = Router(node.value("plan_unknown"))

    def path(self, request: Any, frame: str) -> Any:
        """The way as a path in the map's frame; empty if there is none, and the node says why."""
        empty = Path(header=header(frame, self._mapper.stamp if self._mapper.has_map else 0.0))
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
