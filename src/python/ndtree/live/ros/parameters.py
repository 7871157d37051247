# SPDX-License-Identifier: BSD-3-Clause
"""The parameters of the nodes, with their defaults, limits and descriptions: one table."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from ndtree._errors import WrongValue, leading_key, marked, spelled
from ndtree.live.corrections import MEMORY
from ndtree.live.messages import LOOK
from ndtree.live.options import LiveOptions
from ndtree.live.passing import STAYS
from ndtree.live.settings import PATIENCE, QUEUE
from ndtree.live.slam import scans_beside
from ndtree.maps.ground import SLOPE
from ndtree.maps.kinds import MAP_OPTIONS
from ndtree.tuning.config import WORDS, Config


@dataclass(frozen=True)
class Row:
    """A parameter; `changes` is whether it may be set while the node maps, `words` all that it may be."""

    name: str
    default: Any
    text: str
    limits: tuple[float, float] | None = None
    changes: bool = False
    words: tuple[str, ...] = ()

    def check(self, value: Any) -> None:
        """Refuse what is none of the words; raises ValueError."""
        if self.words and value not in self.words:
            expected = " or ".join([", ".join(self.words[:-1]), self.words[-1]])
            raise WrongValue.of(self.name, value, expected)


ROWS = (
    Row("config", "", "A file of ndtree info --write-config: what holds where no parameter says more."),
    Row("autostart", True, "Configure and activate at once; else a lifecycle manager does."),
    Row("topics", [""], "Topics of sensors, @SIGMA [m] may follow; none: of those that there are, the best."),
    Row("fixed_frame", "", "Frame of the map; else map, odom, world or a root of /tf."),
    Row("base_frame", "", "Frame of the mount, or that poses are of."),
    Row("sensor_frame", "", "The sensor's frame, whatever its messages say."),
    Row("mount", "", "Sensor on its base: X,Y,Z,ROLL,PITCH,YAW or X,Y,YAW."),
    Row("odometry", "", "Topic with Odometry, for poses instead of /tf."),
    Row("poses", "", "Topic with poses, instead of /tf."),
    Row("still", False, "The sensor stands still."),
    Row("time_offset", 0.0, "Added to the times of scans [s]."),
    Row("deskew", True, "Each beam from the pose of its own time."),
    Row("sweep", "", "When beams were measured: stamp, end, reversed, reversed-end or said."),
    Row("camera", "", "Of depth images without CameraInfo: fx,fy,cx,cy."),
    Row("pixel_stride", 1, "Of depth images, each n-th pixel of each n-th row.", (1, 64)),
    Row("zero_is", "", "What ranges of 0 say: no-echo or invalid."),
    Row("body", "", "The robot, no obstacle: box:LX,LY,LZ[,X,Y,Z], sphere:, capsule:, footprint:, @FRAME."),
    Row("pose_covariance", "", "Covariances of poses widen beams: auto, ignore or use."),
    Row("colors", False, "Colours of clouds become a layer of the map; cells are shown in them."),
    Row("dim", 0, "2 or 3; 0: what the sensors say.", (0, 3)),
    Row("fixed_cells", False, "All cells of one size."),
    Row("max_range", 0.0, "Longer beams are free up to here [m]; 0: no limit.", (0.0, 1e6)),
    Row("min_range", 0.0, "Shorter beams are left out [m].", (0.0, 1e6)),
    Row("box", "", "X0,Y0,Z0,X1,Y1,Z1 (X0,Y0,X1,Y1 in 2-D) in the map [m]: nothing is mapped outside."),
    Row("stride", 1, "Of each scan, every n-th beam.", (1, 1000)),
    Row("every", 1, "Every n-th scan.", (1, 100000)),
    Row("no_return", "auto", "What a beam without return says: free, ignore, or auto.",
        words=("auto", "free", "ignore")),
    Row("look", LOOK, "Messages that decide what is mapped and how [s].", (0.0, 1e3)),
    Row("queue", QUEUE, "Scans that wait at most; of more, the oldest is dropped.", (1, 100000)),
    Row("patience", PATIENCE, "A scan waits for its pose at most [s].", (0.0, 1e3)),
    Row("threads", 1, "That insert; 0: as many as there are cores.", (0, 256)),
    Row("reliable", False, "Ask sensors for lost messages again: reliable, not best effort."),
    Row("window", 0.0, "What is farther from the sensor is forgotten [m]; 0: nothing.", (0.0, 1e6)),
    Row("fade", 0.0, "What was not seen for this long is forgotten [s]; 0: nothing.", (0.0, 1e6)),
    Row("slam", False, "Find poses of a planar laser by its scans and odometry: publishes map to odom."),
    Row("localize", "", "A saved 2-D map to find the robot in, instead of mapping: publishes map to odom."),
    Row("initial_pose", "", "Of the sensor in a saved map: X,Y,YAW; else it is looked for everywhere."),
    Row("follow", "", "Topic with a SLAM's nav_msgs/Path, or tf: scans move when their poses are corrected."),
    Row("follow_frame", "", "The frame that the poses of follow are of; else the robot's base."),
    Row("follow_memory", MEMORY / 2**20, "Of scans that can move [MiB]; then the oldest stay.", (1.0, 1e6)),
    Row("map_file", "", "Where the map is saved; its ending says as what."),
    Row("resume", False, "Go on with the map in map_file, if it is there."),
    Row("save_period", 0.0, "From one saving to the next [s]; 0: only at the end.", (0.0, 1e6)),
    Row("serve", "", "[HOST:]PORT for ndtree view http://HOST:PORT; 0.0.0.0 as the HOST: all that reach it."),
    Row("robot_radius", 0.3, "Of the ball that ~/get_plan plans for [m].", (0.0, 1e3), True),
    Row("plan_unknown", "blocked", "Unknown space on ways of ~/get_plan: blocked or free.",
        words=("blocked", "free")),
    Row("grid_cell_size", 0.0, "Of the grid [m]; 0: that of the smallest cells.", (0.0, 1e3)),
    Row("grid_low", 0.1, "Of a 3-D map, the grid is of cells between this height", (-1e6, 1e6), True),
    Row("grid_high", 1.8, "and this one [m].", (-1e6, 1e6), True),
    Row("grid_above", "map", "What these count from: map, its z = 0; robot, its base; or ground, below each.",
        changes=True, words=("map", "robot", "ground")),
    Row("ground_slope", SLOPE, "The steepest ground [m/m].", (0.0, 1e3), True),
    Row("grid_wall_depth", 0.0, "Depth of the larger occupied cells [m]; 0: 2 sigma and a cell.",
        (0.0, 1e6), True),
    Row("grid_layers", [""], "More grids of other heights, each NAME:LOW,HIGH, on map_NAME."),
    Row("grid_clear", 0.0, "The grid is free within this of the robot's base [m].", (0.0, 1e3), True),
    Row("grid_stays", STAYS, "What comes into free space is in the grid after this long [s]; 0: at once.",
        (0.0, 1e3), True),
    Row("grid_period", 0.0, "From one grid or update to the next [s]; 0: after each scan.", (0.0, 1e3), True),
    Row("cells_period", 1.0, "Of occupied cells, as points and markers [s].", (0.0, 1e3), True),
    Row("filter_speckles", False, "Leave out occupied cells that have no occupied neighbour.", changes=True),
    Row("frontiers_period", 2.0, "Of frontiers [s].", (0.0, 1e3), True),
    Row("frontier_cells", 8.0, "Smaller frontiers are left out [faces of smallest cells].", (0.0, 1e6)),
    Row("octomap_period", 2.0, "Of Octomaps [s].", (0.0, 1e3), True),
    Row("octomap_cell_size", 0.0, "Of Octomaps [m]; 0: that of the smallest cells.", (0.0, 1e3)),
    Row("diagnostics_period", 1.0, "Of diagnostics [s].", (0.01, 1e3)),
    Row("clear_radius", 1.0, "What clear_around forgets around the sensor [m].", (0.0, 1e6), True),
)  # fmt: skip
_OTHER_NAMES = {"topic": "topics", "fixed": "fixed_cells"}
#: Nothing where they are 0 or empty.
_MAY_BE_NONE = {"window", "fade", "localize"}
CHANGING = {row.name for row in ROWS if row.changes}


@dataclass(frozen=True)
class Layer:
    """A grid of cells between two heights [m]."""

    name: str
    low: float
    high: float

    @staticmethod
    def of(text: str) -> Layer:
        """Of NAME:LOW,HIGH; ValueError if it is none."""
        name, _, heights = text.partition(":")
        try:
            low, high = (float(one) for one in heights.split(","))
        except ValueError:
            low = high = math.nan
        if not (re.fullmatch("[A-Za-z0-9_]+", name) and -math.inf < low < high < math.inf):
            raise WrongValue.of("grid_layers", text, "NAME:LOW,HIGH with heights in m")
        return Layer(name, low, high)


def layers_of(texts: Sequence[str]) -> list[Layer]:
    """Of a list of NAME:LOW,HIGH; ValueError if one is none, or comes twice."""
    layers = [Layer.of(text) for text in texts if text]
    names = [layer.name for layer in layers]
    if len(set(names)) < len(names):
        raise WrongValue.of("grid_layers", ", ".join(texts), "of different names")
    return layers


def check(name: str, value: Any) -> None:
    """Refuse a value that is none of a parameter's words; raises ValueError."""
    for row in ROWS:
        if row.name == name:
            row.check(value)


def config_of(value: Callable[[str], Any], options: dict[str, Any] | None = None) -> Config:
    """What a user said, of a function that tells the value of a parameter, and of the options of the map.

    A parameter that is at its default leaves what the file says.
    """
    rows = [row for row in ROWS if row.name in WORDS]
    given = {row.name: value(row.name) for row in rows if value(row.name) != row.default}
    topics = [topic for topic in value("topics") if topic]
    if topics:
        given["topic"] = topics
    for row in ROWS:
        row.check(value(row.name))
    whole = Config.load(value("config")) if value("config") else Config()
    return whole.overridden(Config.of(**given, **(options or {})).values)


def in_parameters(text: str | Exception) -> str:
    """A text of the library with its options named as parameters, without ways that are no parameter's."""
    names = {row.name for row in ROWS} | {option.name for option in MAP_OPTIONS}

    def name_of(option: str) -> str:
        return _OTHER_NAMES.get(option, option)

    def is_way(line: str) -> bool:
        option = leading_key(line.lstrip())
        return not option or name_of(option) in names

    lines = filter(is_way, marked(text).split("\n"))
    return "\n".join(spelled(line, name_of) for line in lines)


def live_options_of(value: Callable[[str], Any]) -> LiveOptions:
    """What a user said of the map, of a function that tells the value of a parameter."""
    names = {one.name for one in fields(LiveOptions)} & {row.name for row in ROWS}
    given = {name: value(name) or None if name in _MAY_BE_NONE else value(name) for name in names}
    file = value("map_file")
    kept = scans_beside(file) if value("slam") and file else Path(file)
    is_there = bool(file) and kept.exists()
    given["resume"] = (file or "map_file") if value("resume") and (is_there or value("localize")) else None
    return LiveOptions(**given, fixed=value("fixed_cells"))


def followed(follow: str) -> dict[str, Any]:
    """The topic with a Path that a node listens to beside sensors and transforms, if any."""
    return {"follow": follow} if follow not in ("", "tf") else {}
