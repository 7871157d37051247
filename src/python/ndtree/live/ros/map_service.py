# SPDX-License-Identifier: BSD-3-Clause
"""The map of a node, as its parameters have it, with what publishes it, and where the robot is."""

from __future__ import annotations

import math
from typing import Any

from geometry_msgs.msg import PoseWithCovarianceStamped

from ndtree.live.localizing import ODOMETRY, Localization
from ndtree.live.mapper import LiveMapper
from ndtree.live.passing import Passing
from ndtree.live.ros.messages import optional_class, pose_with_covariance, transform
from ndtree.live.ros.middleware import Level, Middleware
from ndtree.live.ros.parameters import config_of, in_parameters, layers_of, live_options_of
from ndtree.live.ros.reports import Reports
from ndtree.live.ros.services import Services, loaded
from ndtree.live.ros.sinks import CellsSink, ChangesSink, FrontiersSink, GridSink, OctomapSink
from ndtree.live.saver import Saver
from ndtree.live.serving import MapServer, address_of
from ndtree.live.way import Robot
from ndtree.logs.poses.transforms import plain
from ndtree.logs.ros.storage import Raw

#: The frame of a map that the robot is found in.
MAP = "map"
#: How far ahead the transform is dated, as others need it for times that are a little later [s].
AHEAD = 0.1
#: For so long it is said again where scans wait [s].
REPEATS = 10.0


class Whereabouts:
    """Publishes each `Localization`, while the robot is not lost; ValueError without tf2_msgs."""

    def __init__(self, node: Middleware) -> None:
        transforms = optional_class("tf2_msgs/msg/TFMessage")
        if transforms is None:
            what = "slam" if node.value("slam") else "localize"
            raise ValueError(f"{what}: needs the package tf2_msgs, to publish where the robot is")
        self._node, self._transforms = node, transforms
        self._tf = node.publisher(transforms, "/tf", depth=100)
        self._poses = node.publisher(PoseWithCovarianceStamped, "~/pose", depth=10)
        self._told: Localization | None = None

    def tell(self, found: Localization) -> None:
        """Publish where the robot is, while it is known."""
        if found.is_lost:
            return
        self._told = found
        self._send_odometry(found, found.stamp)
        self._poses.publish(pose_with_covariance(MAP, found.stamp, found.body, found.covariance))

    def _send_odometry(self, found: Localization, stamp: float) -> None:
        """Where the frame of odometry is at a time [s]."""
        odometry = self._node.value("fixed_frame") or ODOMETRY
        moved = transform(MAP, odometry, stamp + AHEAD, found.map_odometry)
        self._tf.publish(self._transforms(transforms=[moved]))

    def repeat(self) -> None:
        """Say it again by slam, where scans wait: while a loop moves the map, others need it all the same."""
        told, now = self._told, self._node.now()
        if self._node.value("slam") and told is not None and AHEAD < now - told.stamp < REPEATS:
            self._send_odometry(told, now)


#: How often a node looks around for topics, and lets measurements give up [s].
TICK = 0.1


class MapService:
    """A live map as the parameters of a node have it, with sinks that publish it.

    Attributes:
    `services`: What its services do.
    `reading`: What of sensors and frames was said, as `Listener` takes it.
    Raises ValueError, OSError, WrongOption if no map can be made of the parameters.
    """

    def __init__(self, node: Middleware) -> None:
        self._node = node
        value = node.value
        options = live_options_of(value)
        said = config_of(value, node.map_options())
        follows = plain(value("follow")) not in ("", "tf")
        self.reading = {**said.reading, **({"follow": value("follow")} if follows else {})}
        given, begun = options.beginning(said, loaded)
        if options.finds_poses and plain(given.get("fixed_frame", "")) == MAP:
            raise ValueError(f"fixed_frame: must be the odometry's with slam and localize, which tell {MAP}")
        how = options.settings(given, begun)
        if how.target is None:
            given.new_map(given.get("dim", 3))  # Refuses what no map can be made of.
        self._finds, self._makes = options.finds_poses, how.localizer is None
        self._intake = options.intake(node.name, given)
        robot = Robot(self._intake)
        layers = layers_of(value("grid_layers"))
        passing = Passing(lambda: value("grid_stays"), self._heights)
        self._grids = [GridSink(node, self._frame, robot, passing, layer) for layer in (None, *layers)]
        octomap = optional_class("octomap_msgs/msg/Octomap")
        self._octomap = None if octomap is None else OctomapSink(node, self._frame, octomap)
        self._server: MapServer | None = None
        if value("serve"):
            host, port = address_of(value("serve"))
            self._server = MapServer(port, host=host)
        self._robot = Whereabouts(node) if self._finds else None
        self.mapper = LiveMapper(
            self._intake,
            how,
            localized=None if self._robot is None else self._robot.tell,
            sinks=self._sinks(),
            way=robot,
            passing=passing,
        )
        self.services = Services(node, self.mapper, self._frame, self._grids[0], self._octomap)
        self._reports = Reports(node, self.mapper, self._intake, how)
        self.diagnose = self._reports.diagnose

    def _sinks(self) -> list[Any]:
        node = self._node
        sinks: list[Any] = [*self._grids]
        sinks += [kind(node, self._frame) for kind in (CellsSink, ChangesSink, FrontiersSink)]
        sinks += [] if self._octomap is None else [self._octomap]
        file, period = node.value("map_file"), node.value("save_period")
        if file and period > 0:
            sinks.append(Saver(file, period, (lambda: self.mapper.session()) if node.value("slam") else None))
        if self._server is not None:
            sinks.append(self._server)
            node.say(Level.info, f"ndtree view {self._server.url} shows the map as it grows")
        return sinks

    def _heights(self) -> tuple[float, float]:
        """Between which points may be obstacles of some grid [m]."""
        value = self._node.value
        if value("grid_above") != "map":
            return -math.inf, math.inf
        layers = layers_of(value("grid_layers"))
        lows = value("grid_low"), *(one.low for one in layers)
        return min(lows), max(value("grid_high"), *(one.high for one in layers))

    def _frame(self) -> str:
        if self._finds:
            return MAP
        log = self._intake.log
        return (self._node.value("fixed_frame") or "map") if log is None else log.fixed_frame

    def put(self, raw: Raw) -> None:
        """Take a message."""
        self.mapper.put(raw, 1e-9 * raw.received)

    def tick(self) -> set[str] | None:
        """Do what is due every `TICK` seconds; which topics are used, if that was decided since the last."""
        self.mapper.advance(self._node.now())
        if self._robot is not None:
            self._robot.repeat()
        is_new = self._reports.decisions()
        self._reports.failures()
        self._reports.doubts()
        for grid in self._grids:
            grid.welcome()
        intake = self._intake
        return {plain(one) for one in (*intake.sensors, *intake.pose_topics)} if is_new else None

    def close(self, lost: int) -> None:
        """Map what has arrived, publish and save it, and say what became of scans.

        `lost`: As for `diagnose`.
        """
        file = self._node.value("map_file")
        try:
            self.mapper.close()
            if file and self.mapper.has_map and self._makes:
                self.services.write(file)
        except (ValueError, OSError, RuntimeError) as error:
            self._node.say(Level.error, in_parameters(error))
        if self._server is not None:
            self._server.close()
        self._reports.failures()
        self._reports.doubts(again=True)
        self.diagnose(lost)
        self._node.say(Level.info, f"{self.mapper.figures.summary()}, {lost} lost by the middleware")
