# SPDX-License-Identifier: BSD-3-Clause
"""A map of a robot that drives: scans and poses as they come, a map that others see change.

`LiveMapper` is the mapper; `FramesIntake` takes arrays with transforms, `MessagesIntake` messages of ROS, and
`ScansIntake` scans in the map's frame. Nothing here needs ROS.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ndtree import _lazy

if TYPE_CHECKING:
    from ndtree.live.canvas import GridPart as GridPart
    from ndtree.live.corrections import Correction as Correction
    from ndtree.live.corrections import Corrections as Corrections
    from ndtree.live.fading import Fading as Fading
    from ndtree.live.fading import Window as Window
    from ndtree.live.figures import LiveFigures as LiveFigures
    from ndtree.live.frames import FramesIntake as FramesIntake
    from ndtree.live.frames import Reading as Reading
    from ndtree.live.frames import Transform as Transform
    from ndtree.live.grid import GridFollower as GridFollower
    from ndtree.live.intake import Intake as Intake
    from ndtree.live.intake import ScansIntake as ScansIntake
    from ndtree.live.intake import Verdict as Verdict
    from ndtree.live.localizing import Localization as Localization
    from ndtree.live.localizing import Localizer as Localizer
    from ndtree.live.mapper import LiveMapper as LiveMapper
    from ndtree.live.messages import MessagesIntake as MessagesIntake
    from ndtree.live.obstacles import ObstacleDistance as ObstacleDistance
    from ndtree.live.obstacles import ObstacleSink as ObstacleSink
    from ndtree.live.obstacles import obstacle_distance as obstacle_distance
    from ndtree.live.playing import play as play
    from ndtree.live.saver import Saver as Saver
    from ndtree.live.serving import MapServer as MapServer
    from ndtree.live.session import Session as Session
    from ndtree.live.settings import LiveSettings as LiveSettings
    from ndtree.live.settings import Sink as Sink
    from ndtree.live.slam import Slam as Slam
    from ndtree.live.to_foxglove import FoxgloveSink as FoxgloveSink
    from ndtree.live.to_rerun import RerunSink as RerunSink
    from ndtree.live.way import Way as Way

#: The public names, by the module that has them; it loads when one is asked for.
_NAMES = {
    "canvas": "GridPart",
    "corrections": "Correction Corrections",
    "fading": "Fading Window",
    "figures": "LiveFigures",
    "frames": "FramesIntake Reading Transform",
    "grid": "GridFollower",
    "intake": "Intake ScansIntake Verdict",
    "localizing": "Localization Localizer",
    "mapper": "LiveMapper",
    "messages": "MessagesIntake",
    "obstacles": "ObstacleDistance ObstacleSink obstacle_distance",
    "playing": "play",
    "saver": "Saver",
    "serving": "MapServer",
    "session": "Session",
    "settings": "LiveSettings Sink",
    "slam": "Slam",
    "to_foxglove": "FoxgloveSink",
    "to_rerun": "RerunSink",
    "way": "Way",
}
__all__, __getattr__, __dir__ = _lazy.names(__name__, _NAMES)
