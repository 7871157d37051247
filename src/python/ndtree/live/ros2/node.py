# SPDX-License-Identifier: BSD-3-Clause
"""The node ``ndtree_map``: listens to sensors and transforms, maps, and publishes the map."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PolygonStamped
from nav_msgs.srv import GetMap, LoadMap
from rcl_interfaces.msg import SetParametersResult
from rclpy.duration import Duration
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from std_srvs.srv import Empty, Trigger

from ndtree._native import _core
from ndtree._native._core import OccupancyMap
from ndtree.base.scan import Scan
from ndtree.live.mapper import LiveMapper
from ndtree.live.messages import MessagesIntake
from ndtree.live.ros2.messages import optional_class
from ndtree.live.ros2.parameters import CHANGING, declare, map_options, reading_options, value
from ndtree.live.ros2.sinks import CellsSink, FrontiersSink, GridSink, OctomapSink
from ndtree.live.ros2.sources import Sources
from ndtree.live.saver import Saver
from ndtree.live.window import Window
from ndtree.logs.core.selection import Selection
from ndtree.logs.poses.transforms import plain
from ndtree.logs.ros.storage import Raw
from ndtree.maps.open import open_map
from ndtree.maps.writers import write

#: How often the node looks around for topics, and lets measurements give up [s].
TICK = 0.1
#: A rate of diagnostics is that of this time [s]; and how often it is said why nothing is mapped [s].
SAYS = 5.0
#: Subscribers have so long to take the last map when the node ends [s].
DELIVERY = 5.0
_DONE = TransitionCallbackReturn.SUCCESS


class MapNode(LifecycleNode):
    """Maps what sensors publish; see the table of its parameters in `parameters`."""

    def __init__(self) -> None:
        super().__init__("ndtree_map")
        declare(self)
        self.add_on_set_parameters_callback(self._may_set)
        self._mapper: LiveMapper | None = None
        self._intake: MessagesIntake | None = None
        self._sources: Sources | None = None
        self._grid: GridSink | None = None
        self._made: list[Any] = []
        self._is_announced = False
        self._is_configured = False
        self._position: np.ndarray | None = None
        self._before = (0, 0.0)
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
                self.get_logger().error(str(error))
                return TransitionCallbackReturn.FAILURE
        self._is_configured = False
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        options = reading_options(self)
        topics = {plain(one.partition("@")[0]) for one in options.get("topic", ())}
        poses = {plain(options[name]) for name in ("odometry", "poses") if name in options}
        self._sources = Sources(
            self, self._put, topics, poses, reliable=value(self, "reliable"), queue=value(self, "queue")
        )
        for type, error in self._sources.missing.items():
            self.get_logger().warning(f"{type}: {error}: there will be no transforms")
        self._made = [
            self.create_timer(TICK, self._tick),
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
        self._intake = self._grid = self._position = None
        self._is_announced, self._before, self._lost = False, (0, 0.0), 0
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._close()
        return super().on_shutdown(state)

    def _configure(self) -> None:
        limit = value(self, "max_range") or math.inf
        target, options = None, map_options(self)
        file = value(self, "map_file")
        if value(self, "resume") and file and Path(file).exists():
            target = _loaded(file)
            options = dict(target.options)
        if target is None:
            self._new_map(value(self, "dim") or 3, options)  # Refuses what no map can be made of.
        intake = MessagesIntake(
            self.get_fully_qualified_name(),
            options=options,
            reading=reading_options(self),
            dim=value(self, "dim") or None,
            max_range=limit,
            no_return=value(self, "no_return"),
            look=value(self, "look"),
        )
        if value(self, "no_return") not in ("auto", "free", "ignore"):
            raise ValueError(f"no_return = {value(self, 'no_return')}: must be auto, free or ignore")
        before = list(self.publishers)
        self._grid = GridSink(self, self._frame)
        sinks: list[Any] = [self._grid, CellsSink(self, self._frame), FrontiersSink(self, self._frame)]
        octomap = optional_class("octomap_msgs/msg/Octomap")
        if octomap is not None:
            sinks.append(OctomapSink(self, self._frame, octomap))
        if file and value(self, "save_period") > 0:
            sinks.append(Saver(file, value(self, "save_period")))
        selection = Selection(3, min_range=value(self, "min_range"))

        def prepare(scan: Scan) -> Scan:
            origin = np.atleast_2d(scan.origin)
            self._position = origin[-1] if len(origin) else self._position
            return selection.cut(scan)

        self._intake = intake
        self._mapper = LiveMapper(
            intake,
            target=target,
            make=self._new_map,
            queue=value(self, "queue"),
            patience=value(self, "patience"),
            threads=value(self, "threads"),
            window=Window(value(self, "window")) if value(self, "window") > 0 else None,
            sinks=sinks,
            prepare=prepare,
        )
        self._status_publisher = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._published = [one for one in self.publishers if one not in before]
        self._offered = [
            self.create_service(Trigger, "~/save", self._save),
            self.create_service(LoadMap, "~/load", self._load),
            self.create_service(Empty, "~/reset", self._reset),
            self.create_service(Trigger, "~/clear_around", self._clear_around),
            self.create_service(GetMap, "~/get_map", self._get_map),
        ]
        self._box_listener = self.create_subscription(PolygonStamped, "~/clear_box", self._clear_box, 10)

    def _new_map(self, dim: int, options: dict[str, Any]) -> OccupancyMap:
        if not value(self, "fixed_cells"):
            return _core.AdaptiveMap(dim=dim, **options)
        return _core.FixedMap(dim=dim, **_fitting(self, options))

    def _frame(self) -> str:
        log = None if self._intake is None else self._intake.log
        return (value(self, "fixed_frame") or "map") if log is None else log.fixed_frame

    def _put(self, raw: Raw) -> None:
        if self._mapper is not None:
            self._mapper.put(raw, 1e-9 * raw.received)

    def _silence(self) -> None:
        if self._sources is not None:
            self._lost += self._sources.lost
            self._sources.close()
            self._sources = None
        for timer in self._made:
            self.destroy_timer(timer)
        self._made = []

    def _close(self) -> None:
        mapper, sources = self._mapper, self._sources
        if mapper is not None and sources is not None:
            sources.take_all()
        self._silence()
        if mapper is None:
            return
        file = value(self, "map_file")
        try:
            mapper.close()
            if file and mapper.has_map:
                write(mapper.snapshot(), Path(file))
        except (ValueError, OSError) as error:
            self.get_logger().error(str(error))
        self._diagnose()
        self._mapper = None
        self.get_logger().info(mapper.figures.summary())

    def _tick(self) -> None:
        mapper, intake, sources = self._mapper, self._intake, self._sources
        if mapper is None or intake is None or sources is None:
            return
        sources.take_poses()  # What has not been taken yet is not late.
        mapper.advance(1e-9 * self.get_clock().now().nanoseconds)
        if intake.log is not None and not self._is_announced:
            self._is_announced = True
            for line in intake.said():
                self.get_logger().info(line)
            sources.choose({plain(one) for one in (*intake.sensors, *intake.pose_topics)})
        elif intake.log is None and mapper.undecided:
            self.get_logger().warning(mapper.undecided, throttle_duration_sec=SAYS)
        sources.look()
        if self._grid is not None:
            self._grid.welcome()

    def _diagnose(self) -> None:
        mapper, sources = self._mapper, self._sources
        if mapper is None:
            return
        figures = mapper.figures
        now = 1e-9 * self.get_clock().now().nanoseconds
        mapped, since = self._before
        rate = (figures.mapped - mapped) / (now - since) if now > since else 0.0
        self._before = figures.mapped, now
        values: dict[str, Any] = {
            "rate [Hz]": f"{rate:.1f}",
            "delay, median [ms]": f"{1e3 * figures.delay(0.5):.1f}",
            "delay, 99 % [ms]": f"{1e3 * figures.delay(0.99):.1f}",
            "received": figures.received,
            "mapped": figures.mapped,
            "dropped": figures.dropped,
            "lost by the middleware": self._lost + (sources.lost if sources is not None else 0),
            "late poses": figures.late_poses,
            "waiting": figures.waiting,
            **{f"left out, {kind}": count for kind, count in figures.left_out.items()},
            **{f"{sink} failed": error for sink, error in mapper.failures.items()},
        }
        status = DiagnosticStatus(name=f"{self.get_name()}: map", hardware_id="", level=DiagnosticStatus.OK)
        if mapper.has_map:
            stats = mapper.snapshot().stats()
            values["cells"] = stats.observed_leaves
            values["memory [MiB]"] = f"{stats.memory_bytes / 2**20:.1f}"
            status.message = f"{rate:.1f} scans/s"
        else:
            status.level = DiagnosticStatus.WARN
            status.message = mapper.undecided or "nothing to map yet"
        if mapper.has_map and (rate == 0 or mapper.failures):
            status.level = DiagnosticStatus.WARN
            status.message = next(iter(mapper.failures.values()), "no scans are mapped")
        status.values = [KeyValue(key=key, value=str(one)) for key, one in values.items()]
        message = DiagnosticArray(status=[status])
        message.header.stamp = self.get_clock().now().to_msg()
        self._status_publisher.publish(message)

    def _may_set(self, parameters: list[Parameter[Any]]) -> SetParametersResult:
        """Refuse to change, while it maps, what is read only when the node is configured."""
        for one in parameters:
            if self._mapper is not None and one.name not in CHANGING and one.name != "use_sim_time":
                reason = f"{one.name} is read when the node is configured, and not while it maps"
                return SetParametersResult(successful=False, reason=reason)
        return SetParametersResult(successful=True)

    def _save(self, request: Any, response: Any) -> Any:
        file = value(self, "map_file")
        try:
            if not file:
                raise ValueError("map_file is not set, expected the name of a file")
            assert self._mapper is not None
            write(self._mapper.snapshot(), Path(file))
            response.success, response.message = True, file
        except (ValueError, OSError, RuntimeError, ImportError) as error:
            response.success, response.message = False, str(error)
        return response

    def _load(self, request: Any, response: Any) -> Any:
        path = request.map_url.removeprefix("file://")
        try:
            m = _loaded(path)
            assert self._mapper is not None
            self._mapper.replace(m)
            response.result = LoadMap.Response.RESULT_SUCCESS
        except FileNotFoundError:
            response.result = LoadMap.Response.RESULT_MAP_DOES_NOT_EXIST
        except (ValueError, OSError, RuntimeError) as error:
            self.get_logger().error(str(error))
            response.result = LoadMap.Response.RESULT_INVALID_MAP_DATA
        return response

    def _reset(self, request: Any, response: Any) -> Any:
        if self._mapper is not None:
            self._mapper.replace(None)
        return response

    def _clear_around(self, request: Any, response: Any) -> Any:
        radius = value(self, "clear_radius")
        try:
            assert self._mapper is not None
            if self._position is None:
                raise RuntimeError("nothing was mapped yet")
            with self._mapper.locked() as m:
                m.clear(np.stack([self._position - radius, self._position + radius]))
            response.success, response.message = True, f"within {radius:g} m of {self._position.tolist()}"
        except (ValueError, RuntimeError) as error:
            response.success, response.message = False, str(error)
        return response

    def _clear_box(self, message: PolygonStamped) -> None:
        """Forget the box around a polygon's points: in 2-D of x and y alone."""
        if message.header.frame_id not in ("", self._frame()):
            self.get_logger().error(f"clear_box: is in {message.header.frame_id}, expected {self._frame()}")
            return
        points = np.array([[one.x, one.y, one.z] for one in message.polygon.points])
        try:
            assert self._mapper is not None
            with self._mapper.locked() as m:
                m.clear(np.stack([points.min(axis=0), points.max(axis=0)])[:, : m.dim])
        except (ValueError, RuntimeError) as error:
            self.get_logger().error(f"clear_box: {error}")

    def _get_map(self, request: Any, response: Any) -> Any:
        try:
            assert self._grid is not None and self._mapper is not None
            self._grid.update(self._mapper.snapshot(), self._mapper.stamp)  # As the map is now.
            response.map = self._grid.whole()
        except (ValueError, RuntimeError) as error:
            self.get_logger().warning(f"get_map: {error}")
        return response


def _fitting(node: MapNode, options: dict[str, Any]) -> dict[str, Any]:
    """Options of the map, as its kind calls them."""
    if not value(node, "fixed_cells"):
        return options
    return {("cell_size" if name == "min_cell_size" else name): one for name, one in options.items()}


def _loaded(path: str) -> OccupancyMap:
    placed = open_map(path)
    return placed.resampled(placed.cell_size)
