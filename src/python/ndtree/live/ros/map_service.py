# SPDX-License-Identifier: BSD-3-Clause
"""The map of a node: what its parameters make of it, and what its services do."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from enum import IntEnum
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseWithCovarianceStamped

from ndtree._native._core import OccupancyMap
from ndtree.live.corrections import Corrections
from ndtree.live.fading import Fading
from ndtree.live.localizing import ODOMETRY, Localization, Localizer, place_of
from ndtree.live.mapper import LiveMapper
from ndtree.live.messages import MessagesIntake
from ndtree.live.passing import Passing
from ndtree.live.robot import Robot
from ndtree.live.ros.messages import header, optional_class, pose_with_covariance, transform
from ndtree.live.ros.middleware import Level, Middleware
from ndtree.live.ros.parameters import config_of, in_parameters, layers_of
from ndtree.live.ros.plans import Plans
from ndtree.live.ros.sinks import CellsSink, ChangesSink, FrontiersSink, GridSink, OctomapSink
from ndtree.live.saver import Saver
from ndtree.live.serving import MapServer, address_of
from ndtree.live.session import Session
from ndtree.live.slam import Slam, scans_beside
from ndtree.live.window import Window
from ndtree.logs.poses.transforms import plain
from ndtree.logs.ros.storage import Raw
from ndtree.maps.open import open_map
from ndtree.maps.writers import write
from ndtree.tuning.config import Config

#: How often a node looks around for topics, and lets measurements give up [s].
TICK = 0.1
#: The frame of a map that the robot is found in, and how far ahead its transform is dated, as others need it
#: for times that are a little later [s].
MAP, AHEAD = "map", 0.1
#: For so long it is said again where scans wait [s].
REPEATS = 10.0
#: For so long nothing is said of a clock that does not begin [s].
WAITS = 3.0
#: Types of octomap_server's services, which are offered where octomap_msgs is installed.
OCTOMAP_SERVICES = "GetOctomap", "BoundingBoxQuery"
#: How often it is said why nothing is mapped [s].
SAYS = 5.0


class Loaded(IntEnum):
    """What nav_msgs/LoadMap answers."""

    success = 0
    no_such_file = 1
    no_map = 2


class MapService:
    """A live map as the parameters of a node have it, with sinks that publish it.

    Raises ValueError, OSError, WrongOption if no map can be made of the parameters.
    """

    def __init__(self, node: Middleware) -> None:
        self._node = node
        value = node.value
        given = config_of(value, node.map_options())
        target = None
        file = value("map_file")
        self._slam = _slam(value)
        if self._slam is not None:
            given = given.overridden({**Config.of(**self._slam.options).values, **Config.of(dim=2).values})
        elif value("resume") and file and Path(file).exists():
            target = _loaded(file)
            given = given.overridden(Config.of(**target.options).values)
        localizer = None
        if value("localize"):
            for name in ("resume", "window", "fade", "follow", "slam"):
                if value(name):
                    raise ValueError(f"{name}: not with localize, which makes no map")
            target = _loaded(value("localize"))
            given = given.overridden(Config.of(**target.options, dim=2).values)
            place = place_of(value("initial_pose")) if value("initial_pose") else None
            localizer = Localizer(target, place)
        self._localizer = localizer
        if (localizer is not None or self._slam is not None) and plain(given.get("fixed_frame", "")) == MAP:
            raise ValueError(f"fixed_frame: must be the odometry's with slam and localize, which tell {MAP}")
        if target is None:
            given.new_map(given.get("dim", 3))  # Refuses what no map can be made of.
        self._intake = MessagesIntake(
            node.name,
            given,
            look=value("look"),
            follow=value("follow"),
            body=value("follow_frame"),
            poses_are_found=self._slam is not None,
        )
        self._announced: list[str] = []
        self._began = time.monotonic()
        self._waits_for_clock = True
        self._before = 0, 0.0
        self._said = -math.inf
        self._failed: dict[str, str] = {}
        robot = Robot(self._intake)
        layers = [None, *layers_of(value("grid_layers"))]
        passing = Passing(lambda: value("grid_stays"), lambda: _heights(value))
        self._grids = [GridSink(node, self._frame, robot, passing, layer) for layer in layers]
        octomap = optional_class("octomap_msgs/msg/Octomap")
        self._octomap = None if octomap is None else OctomapSink(node, self._frame, octomap)
        self._server: MapServer | None = None
        if value("serve"):
            host, port = address_of(value("serve"))
            self._server = MapServer(port, host=host)
        if localizer is not None or self._slam is not None:
            self._transforms = optional_class("tf2_msgs/msg/TFMessage")
            if self._transforms is None:
                what = "localize" if self._slam is None else "slam"
                raise ValueError(f"{what}: needs the package tf2_msgs, to publish where the robot is")
            self._tf = node.publisher(self._transforms, "/tf", depth=100)
            self._poses = node.publisher(PoseWithCovarianceStamped, "~/pose", depth=10)
        self._told: Localization | None = None
        self._verdict = "too early"
        self._status = node.publisher(DiagnosticArray, "/diagnostics", depth=10)
        self.mapper = LiveMapper(
            self._intake,
            target=target,
            make=given.new_map,
            queue=value("queue"),
            patience=value("patience"),
            threads=value("threads"),
            window=Window(value("window")) if value("window") > 0 else None,
            fading=Fading(value("fade")) if value("fade") > 0 else None,
            corrections=_corrections(value),
            localizer=localizer,
            localized=self._localized,
            slam=self._slam,
            sinks=self._sinks(),
            way=robot,
            passing=passing,
        )
        self._plans = Plans(node, self.mapper)

    def _sinks(self) -> list[Any]:
        """What is done with the map."""
        node = self._node
        sinks: list[Any] = [*self._grids]
        sinks += [kind(node, self._frame) for kind in (CellsSink, ChangesSink, FrontiersSink)]
        sinks += [] if self._octomap is None else [self._octomap]
        file, period = node.value("map_file"), node.value("save_period")
        if file and period > 0:
            sinks.append(Saver(file, period, None if self._slam is None else self._session))
        if self._server is not None:
            sinks.append(self._server)
            node.say(Level.info, f"ndtree view {self._server.url} shows the map as it grows")
        return sinks

    def _session(self) -> Session:
        return self.mapper.session()

    def _localized(self, found: Localization) -> None:
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

    def _repeat(self) -> None:
        """Say it again by slam, where scans wait: while a loop moves the map, others need it all the same."""
        told, now = self._told, self._node.now()
        if self._slam is not None and told is not None and AHEAD < now - told.stamp < REPEATS:
            self._send_odometry(told, now)

    def _frame(self) -> str:
        if self._localizer is not None or self._slam is not None:
            return MAP
        log = self._intake.log
        return (self._node.value("fixed_frame") or "map") if log is None else log.fixed_frame

    def put(self, raw: Raw) -> None:
        """Take a message."""
        self.mapper.put(raw, 1e-9 * raw.received)

    def tick(self) -> set[str] | None:
        """What is to be done every `TICK` seconds.

        Returns set of str or None: Topics that are used, without the slash, when that was decided since the
            last time.
        """
        intake, mapper = self._intake, self.mapper
        mapper.advance(self._node.now())
        self._repeat()
        chosen = None
        if intake.log is not None and self._announced != intake.notes:
            for line in intake.said():
                if line not in self._announced:
                    self._node.say(Level.info, in_parameters(line))
            self._announced = list(intake.notes)
            chosen = {plain(one) for one in (*intake.sensors, *intake.pose_topics)}
        elif intake.log is None and mapper.undecided and time.monotonic() - self._said >= SAYS:
            self._said = time.monotonic()
            self._node.say(Level.warning, in_parameters(mapper.undecided))
        if self._waits_for_clock and time.monotonic() - self._began >= WAITS:
            self._waits_for_clock = False
            if self._node.now() == 0:
                self._node.say(
                    Level.warning, "use_sim_time is set, and nothing comes on /clock: no time passes"
                )
        self._say_failures()
        self._say_doubts()
        for grid in self._grids:
            grid.welcome()
        return chosen

    def _say_failures(self) -> None:
        """Say what has gone wrong since the last time in a sink; the map goes on."""
        failures = dict(self.mapper.failures)
        for sink, error in failures.items():
            if self._failed.get(sink) != error:
                self._node.say(Level.error, f"{sink}: {error}")
        self._failed = failures

    def _say_doubts(self, *, again: bool = False) -> None:
        """Say whether poses are to be trusted where that is another than before."""
        if self._slam is None or (self._slam.verdict == self._verdict and not again):
            return
        self._verdict, doubts = self._slam.verdict, self._slam.doubts
        level = Level.warning if doubts else Level.info
        self._node.say(level, "; ".join([f"poses are {self._verdict}", *doubts]))

    def close(self, lost: int) -> None:
        """Map what has arrived, publish and save it, and say what became of scans.

        `lost`: As for `diagnose`.
        """
        file = self._node.value("map_file")
        try:
            self.mapper.close()
            if file and self.mapper.has_map and self._localizer is None:
                self._write(file)
        except (ValueError, OSError) as error:
            self._node.say(Level.error, in_parameters(error))
        if self._server is not None:
            self._server.close()
        self._say_failures()
        self._say_doubts(again=True)
        self.diagnose(lost)
        self._node.say(Level.info, f"{self.mapper.figures.summary()}, {lost} lost by the middleware")

    def _write(self, file: str) -> None:
        write(self.mapper.snapshot(), Path(file))
        if self._slam is not None:
            self.mapper.session().save(scans_beside(file))

    def diagnose(self, lost: int) -> None:
        """Publish how the map does.

        `lost`: Messages that the middleware says it has lost.
        """
        mapper, figures = self.mapper, self.mapper.figures
        now = self._node.now()
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
            "lost by the middleware": lost,
            "late poses": figures.late_poses,
            "corrections": figures.corrections,
            "waiting": figures.waiting,
            **{f"left out, {kind}": count for kind, count in figures.left_out.items()},
            **{f"{sink} failed": error for sink, error in mapper.failures.items()},
        }
        if self._localizer is not None:
            values |= {"lost now": self._localizer.is_lost, "times lost": self._localizer.times_lost}
        doubts = [] if self._slam is None else self._slam.doubts
        if self._slam is not None:
            said = self._slam.figures()
            values |= {"poses": said["verdict"], "loops": said.get("loops", 0), "doubts": "; ".join(doubts)}
        name = self._node.name.rpartition("/")[2]
        status = DiagnosticStatus(name=f"{name}: map", hardware_id="", level=DiagnosticStatus.OK)
        if mapper.has_map:
            stats = mapper.snapshot().stats()
            values["cells"] = stats.observed_leaves
            values["memory [MiB]"] = f"{stats.memory_bytes / 2**20:.1f}"
            status.message = f"{rate:.1f} scans/s"
        else:
            status.level = DiagnosticStatus.WARN
            status.message = in_parameters(mapper.undecided) or "nothing to map yet"
        if mapper.has_map and (rate == 0 or mapper.failures):
            status.level = DiagnosticStatus.WARN
            status.message = next(iter(mapper.failures.values()), "no scans are mapped")
        if self._localizer is not None and self._localizer.is_lost:
            status.level, status.message = DiagnosticStatus.WARN, "lost in the map"
        if doubts and status.level == DiagnosticStatus.OK:
            status.level, status.message = DiagnosticStatus.WARN, doubts[0]
        status.values = [KeyValue(key=key, value=str(one)) for key, one in values.items()]
        self._status.publish(DiagnosticArray(header=header("", now), status=[status]))

    def save(self) -> tuple[bool, str]:
        """Write the map to its file; whether that was done, and the file or what went wrong."""
        file = self._node.value("map_file")
        try:
            if not file:
                raise ValueError("map_file is not set, expected the name of a file")
            self._write(file)
        except (ValueError, OSError, RuntimeError, ImportError) as error:
            return False, str(error)
        return True, file

    def load(self, url: str) -> Loaded:
        """Go on with a map of a file."""
        try:
            self.mapper.replace(_loaded(url[len("file://") :] if url.startswith("file://") else url))
        except FileNotFoundError:
            return Loaded.no_such_file
        except (ValueError, OSError, RuntimeError) as error:
            self._node.say(Level.error, str(error))
            return Loaded.no_map
        return Loaded.success

    def reset(self) -> None:
        """Forget everything."""
        self.mapper.replace(None)

    def clear_around(self) -> tuple[bool, str]:
        """Forget the box around the sensor; whether that was done, and where or what went wrong."""
        radius = self._node.value("clear_radius")
        try:
            position = self.mapper.position
            if position is None:
                raise RuntimeError("nothing was mapped yet")
            with self.mapper.locked() as m:
                m.clear(np.stack([position - radius, position + radius]))
        except (ValueError, RuntimeError) as error:
            return False, str(error)
        return True, f"within {radius:g} m of {position.tolist()}"

    def octomap(self, *, binary: bool) -> Any:
        """The map as it is now as an Octomap; None if there is none, or it is none in space."""
        try:
            m = self.mapper.snapshot()
            if self._octomap is None or m.dim != 3:
                raise ValueError("expected a 3-D map" if self._octomap else "octomap_msgs is not installed")
            return self._octomap.message(m, self.mapper.stamp, binary=binary)
        except (ValueError, RuntimeError) as error:
            self._node.say(Level.warning, f"octomap: {error}")
            return None

    def clear_box(self, frame: str, points: Sequence[Any]) -> None:
        """Forget the box around points in a frame: in 2-D of x and y alone."""
        if frame not in ("", self._frame()):
            self._node.say(Level.error, f"clear_box: is in {frame}, expected {self._frame()}")
            return
        corners = np.array([[one.x, one.y, one.z] for one in points])
        try:
            with self.mapper.locked() as m:
                m.clear(np.stack([corners.min(axis=0), corners.max(axis=0)])[:, : m.dim])
        except (ValueError, RuntimeError) as error:
            self._node.say(Level.error, f"clear_box: {error}")

    def plan(self, request: Any) -> Any:
        """The answer to a nav_msgs/GetPlan."""
        return self._plans.path(request, self._frame())

    def grid(self) -> Any:
        """The grid of the map as it is now; None if nothing is known."""
        try:
            self._grids[0].update(self.mapper.snapshot(), self.mapper.stamp)
            return self._grids[0].whole()
        except (ValueError, RuntimeError) as error:
            self._node.say(Level.warning, f"get_map: {error}")
            return None


def _heights(value: Callable[[str], Any]) -> tuple[float, float]:
    """Between which points may be obstacles of some grid [m]."""
    if value("grid_above") != "map":
        return -math.inf, math.inf
    layers = layers_of(value("grid_layers"))
    lows, highs = (
        [value("grid_low"), *(one.low for one in layers)],
        [value("grid_high"), *(one.high for one in layers)],
    )
    return min(lows), max(highs)


def _corrections(value: Callable[[str], Any]) -> Corrections | None:
    how = "slam" if value("slam") else "follow"
    if not value(how):
        return None
    if value("fixed_cells"):
        raise ValueError(f"fixed_cells: not with {how}, whose map has adaptive cells")
    return Corrections(memory=int(value("follow_memory") * 2**20), threads=value("threads"))


def _slam(value: Callable[[str], Any]) -> Slam | None:
    """What makes poses, if a user wants it; it goes on with the saved drive, if that is there."""
    if not value("slam"):
        return None
    for name in ("window", "fade", "follow"):
        if value(name):
            raise ValueError(f"{name}: not with slam")
    file = scans_beside(value("map_file")) if value("map_file") else None
    goes_on = value("resume") and file is not None and file.exists()
    place = place_of(value("initial_pose")) if value("initial_pose") else None
    return Slam(earlier=Session.load(file) if goes_on and file is not None else None, guess=place)


def _loaded(path: str) -> OccupancyMap:
    placed = open_map(path)
    return placed.resampled()
