# SPDX-License-Identifier: BSD-3-Clause
"""The node ``ndtree_map`` of ROS 2: listens to sensors and transforms, maps, and publishes the map."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from geometry_msgs.msg import PolygonStamped
from nav_msgs.srv import GetMap, GetPlan, LoadMap
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from std_srvs.srv import Empty, Trigger

from ndtree.live.ros.map_service import TICK, MapService
from ndtree.live.ros.messages import optional_class
from ndtree.live.ros.middleware import Level, Publisher
from ndtree.live.ros.parameters import CHANGING, check, config_of, followed, in_parameters
from ndtree.live.ros.services import OCTOMAP_SERVICES
from ndtree.live.ros2.parameters import declare, map_options, value
from ndtree.live.ros2.sources import Sources
from ndtree.logs.ros.storage import Raw

#: Subscribers have so long to take the last map when the node ends [s].
DELIVERY = 5.0
_DONE = TransitionCallbackReturn.SUCCESS
#: Subscribers that come later get the last one, as from map_server.
LATCHED = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)


class _Publisher:
    def __init__(self, publisher: Any) -> None:
        self._publisher = publisher
        self.publish = publisher.publish

    def listeners(self) -> int:
        return int(self._publisher.get_subscription_count())


class RosNode:
    """A node of ROS 2 as the map needs it."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self.name = node.get_fully_qualified_name()

    def value(self, name: str) -> Any:
        return value(self._node, name)

    def map_options(self) -> dict[str, Any]:
        return map_options(self._node)

    def publisher(self, kind: Any, topic: str, *, depth: int | None = None) -> Publisher:
        qos = LATCHED if depth is None else QoSProfile(depth=depth)
        return _Publisher(self._node.create_publisher(kind, topic, qos))

    def now(self) -> float:
        return 1e-9 * float(self._node.get_clock().now().nanoseconds)

    def say(self, level: Level, text: str) -> None:
        logger = self._node.get_logger()
        # Each in a line of its own: rclpy refuses another level from the same line.
        if level is Level.error:
            logger.error(text)
        elif level is Level.warning:
            logger.warning(text)
        else:
            logger.info(text)


class MapNode(LifecycleNode):
    """Maps what sensors publish; see the table of its parameters in `ndtree.live.ros.parameters`."""

    def __init__(self) -> None:
        super().__init__("ndtree_map")
        declare(self)
        self.add_on_set_parameters_callback(self._may_set)
        self._map: MapService | None = None
        self._sources: Sources | None = None
        self._made: list[Any] = []
        self._is_configured = False
        self._lost = 0

    def start(self) -> None:
        """Configure and activate, unless a lifecycle manager is to do it; raises what configuring raises."""
        if not value(self, "autostart"):
            return
        self._configure()
        self._is_configured = True
        for trigger in (self.trigger_configure, self.trigger_activate):
            if trigger() != _DONE:
                raise ValueError("the node cannot be activated, expected parameters that fit together")

    def end(self) -> None:
        """Map what has arrived, save, and wait a while until subscribers have the last map."""
        self._close()
        self._deliver()

    def _deliver(self) -> None:
        until = time.monotonic() + DELIVERY
        for publisher in self.publishers:
            publisher.wait_for_all_acked(Duration(seconds=max(until - time.monotonic(), 0.0)))

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        if not self._is_configured:
            try:
                self._configure()
            except (ValueError, OSError, TypeError) as error:
                self.get_logger().error(in_parameters(error))
                return TransitionCallbackReturn.FAILURE
        self._is_configured = False
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        options = {**config_of(lambda name: value(self, name)).reading, **followed(value(self, "follow"))}
        self._sources = Sources(
            self, self._put, options, reliable=value(self, "reliable"), queue=value(self, "queue")
        )
        for type, error in self._sources.missing.items():
            self.get_logger().warning(f"{type}: {error}: there will be no transforms")
        self._made = [
            # By a clock that passes although a simulator's does not.
            self.create_timer(TICK, self._tick, clock=Clock(clock_type=ClockType.STEADY_TIME)),
            self.create_timer(value(self, "diagnostics_period"), self._diagnose),
        ]
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._silence()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Save, and take back all that configuring has made: the next time it begins anew."""
        self._close()
        self._deliver()
        for service in self._offered:
            self.destroy_service(service)
        self.destroy_subscription(self._box_listener)
        for publisher in self._published:
            self.destroy_publisher(publisher)
        self._lost = 0
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._close()
        return super().on_shutdown(state)

    def _configure(self) -> None:
        before = list(self.publishers)
        self._map = MapService(RosNode(self))
        self._published = [one for one in self.publishers if one not in before]
        self._offered = [
            self.create_service(Trigger, "~/save", self._save),
            self.create_service(LoadMap, "~/load", self._load),
            self.create_service(Empty, "~/reset", self._reset),
            self.create_service(Trigger, "~/clear_around", self._clear_around),
            self.create_service(GetMap, "~/get_map", self._get_map),
            self.create_service(GetPlan, "~/get_plan", self._get_plan),
        ]
        get_octomap, query = (optional_class(f"octomap_msgs/srv/{name}") for name in OCTOMAP_SERVICES)
        if query is not None:
            self._offered += [
                self.create_service(get_octomap, "~/octomap_full", self._get_octomap(False)),
                self.create_service(get_octomap, "~/octomap_binary", self._get_octomap(True)),
                self.create_service(query, "~/clear_bbox", self._clear_bbox),
            ]
        self._box_listener = self.create_subscription(PolygonStamped, "~/clear_box", self._clear_box, 10)

    def _put(self, raw: Raw) -> None:
        if self._map is not None:
            self._map.put(raw)

    def _silence(self) -> None:
        if self._sources is not None:
            self._lost += self._sources.lost
            self._sources.close()
            self._sources = None
        for timer in self._made:
            self.destroy_timer(timer)
        self._made = []

    def _close(self) -> None:
        live, sources = self._map, self._sources
        if live is not None and sources is not None:
            sources.take_all()
        self._silence()
        if live is not None:
            live.close(self._lost)
            self._map = None

    def _tick(self) -> None:
        live, sources = self._map, self._sources
        if live is None or sources is None:
            return
        sources.take_poses()  # What has not been taken yet is not late.
        chosen = live.tick()
        if chosen is not None:
            sources.choose(chosen)
        sources.look()

    def _diagnose(self) -> None:
        if self._map is not None:
            self._map.diagnose(self._lost + (self._sources.lost if self._sources is not None else 0))

    def _may_set(self, parameters: list[Parameter[Any]]) -> SetParametersResult:
        """Refuse to change, while it maps, what is read only when the node is configured."""
        for one in parameters:
            if self._map is not None and one.name not in CHANGING and one.name != "use_sim_time":
                reason = f"{one.name} is read when the node is configured, and not while it maps"
                return SetParametersResult(successful=False, reason=reason)
            try:
                check(one.name, one.value)
            except ValueError as error:
                return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _save(self, request: Any, response: Any) -> Any:
        assert self._map is not None
        response.success, response.message = self._map.services.save()
        return response

    def _load(self, request: Any, response: Any) -> Any:
        assert self._map is not None
        response.result = int(self._map.services.load(request.map_url))
        return response

    def _reset(self, request: Any, response: Any) -> Any:
        if self._map is not None:
            self._map.services.reset()
        return response

    def _clear_around(self, request: Any, response: Any) -> Any:
        assert self._map is not None
        response.success, response.message = self._map.services.clear_around()
        return response

    def _get_octomap(self, binary: bool) -> Callable[[Any, Any], Any]:
        def answered(request: Any, response: Any) -> Any:
            assert self._map is not None
            response.map = self._map.services.octomap(binary=binary) or response.map
            return response

        return answered

    def _clear_bbox(self, request: Any, response: Any) -> Any:
        assert self._map is not None
        self._map.services.clear_box("", [request.min, request.max])
        return response

    def _clear_box(self, message: PolygonStamped) -> None:
        if self._map is not None:
            self._map.services.clear_box(message.header.frame_id, message.polygon.points)

    def _get_map(self, request: Any, response: Any) -> Any:
        assert self._map is not None
        response.map = self._map.services.grid() or response.map
        return response

    def _get_plan(self, request: Any, response: Any) -> Any:
        assert self._map is not None
        response.plan = self._map.services.plan(request)
        return response
