# SPDX-License-Identifier: BSD-3-Clause
"""The node ``ndtree_map`` of ROS 2: listens to sensors and transforms, maps, and publishes the map."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

import rclpy
from geometry_msgs.msg import PolygonStamped
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions

from ndtree.base.options import MAP_OPTIONS
from ndtree.live.ros.map_service import TICK, MapService
from ndtree.live.ros.middleware import Level, Publisher
from ndtree.live.ros.parameters import CHANGING, ROWS, check, in_parameters
from ndtree.live.ros.services import Fields
from ndtree.live.ros2.sources import Sources
from ndtree.logs.ros.storage import Raw

#: Subscribers have so long to take the last map when the node ends [s].
DELIVERY = 5.0
#: So often it is looked whether the node is to end [s].
LOOKS = 0.2
#: What rclpy raises by what a user says: nothing.
ERRORS: tuple[type[Exception], ...] = ()
_DONE = TransitionCallbackReturn.SUCCESS
#: Subscribers that come later get the last one, as from map_server.
LATCHED = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)


def begin(arguments: Sequence[str] | None) -> None:
    """Make this process one with nodes."""
    # ROS's own handlers would take the context away before the last map is published.
    rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)


def finish() -> None:
    """End that."""
    rclpy.try_shutdown()


#: Types of parameters.
_TYPES = {
    bool: Parameter.Type.BOOL,
    int: Parameter.Type.INTEGER,
    float: Parameter.Type.DOUBLE,
    str: Parameter.Type.STRING,
}


def declare(node: Node) -> None:
    """Give a node all of them; options of the map stay unset until they are given."""
    for row in ROWS:
        descriptor = ParameterDescriptor(description=row.description, read_only=False)
        if row.range is not None and row.kind is int:
            first, last = map(int, row.range)
            descriptor.integer_range = [IntegerRange(from_value=first, to_value=last, step=0)]
        elif row.range is not None:
            low, high = row.range
            descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=high, step=0.0)]
        node.declare_parameter(row.key, row.start, descriptor)
    for option in MAP_OPTIONS:
        descriptor = ParameterDescriptor(description=f"{option.help} Unset: the map's own, or measured.")
        node.declare_parameter(option.name, _TYPES[option.type], descriptor)


class _Publisher:
    def __init__(self, publisher: Any) -> None:
        self._publisher = publisher
        self.publish = publisher.publish

    def listeners(self) -> int:
        return int(self._publisher.get_subscription_count())


class MapNode(LifecycleNode):
    """Maps what sensors publish, a `Middleware`; its parameters are those of `ndtree.live.ros.parameters`."""

    def __init__(self) -> None:
        super().__init__("ndtree_map")
        declare(self)
        self.name = self.get_fully_qualified_name()
        self.add_on_set_parameters_callback(self._may_set)
        self._map: MapService | None = None
        self._sources: Sources | None = None
        self._made: list[Any] = []
        self._is_configured = False
        self._lost = 0

    def value(self, name: str) -> Any:
        return self.get_parameter(name).value

    def map_options(self) -> dict[str, Any]:
        found = {option.name: self.get_parameter_or(option.name) for option in MAP_OPTIONS}
        return {
            name: one.value
            for name, one in found.items()
            if one is not None and one.type_ != Parameter.Type.NOT_SET
        }

    def publisher(self, kind: Any, topic: str, *, depth: int | None = None) -> Publisher:
        qos = LATCHED if depth is None else QoSProfile(depth=depth)
        return _Publisher(self.create_publisher(kind, topic, qos))

    def now(self) -> float:
        return 1e-9 * float(self.get_clock().now().nanoseconds)

    def say(self, level: Level, text: str) -> None:
        logger = self.get_logger()
        # Each in a line of its own: rclpy refuses another level from the same line.
        if level is Level.error:
            logger.error(text)
        elif level is Level.warning:
            logger.warning(text)
        else:
            logger.info(text)

    def run(self, ended: threading.Event) -> None:
        """Map until the node is asked to end; raises what configuring raises."""
        if self.value("autostart"):
            self._start()
        executor = SingleThreadedExecutor()
        executor.add_node(self)
        while not ended.is_set() and rclpy.ok():
            executor.spin_once(timeout_sec=LOOKS)

    def _start(self) -> None:
        """Configure and activate, as a lifecycle manager would."""
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
        assert self._map is not None
        reading, reliable, queue = self._map.reading, self.value("reliable"), self.value("queue")
        self._sources = Sources(self, self._put, reading, reliable=reliable, queue=queue)
        for type, error in self._sources.missing.items():
            self.get_logger().warning(f"{type}: {error}: there will be no transforms")
        self._made = [
            # By a clock that passes although a simulator's does not.
            self.create_timer(TICK, self._tick, clock=Clock(clock_type=ClockType.STEADY_TIME)),
            self.create_timer(self.value("diagnostics_period"), self._diagnose),
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
        self._map = MapService(self)
        self._published = [one for one in self.publishers if one not in before]
        services = self._map.services
        self._offered = [
            self.create_service(kind, f"~/{name}", _answering(answer))
            for name, (kind, answer) in services.offered().items()
        ]
        self._box_listener = self.create_subscription(PolygonStamped, "~/clear_box", services.clear, 10)

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


def _answering(answer: Callable[[Any], Fields]) -> Callable[[Any, Any], Any]:
    """A service's answer as rclpy asks for it."""

    def answered(request: Any, response: Any) -> Any:
        for name, one in answer(request).items():
            setattr(response, name, one)
        return response

    return answered
