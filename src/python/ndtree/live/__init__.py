# SPDX-License-Identifier: BSD-3-Clause
"""A map of a robot that drives: scans and poses as they come, a map that others see change.

`LiveMapper` is the mapper; `FramesIntake` takes arrays with transforms, `MessagesIntake` messages of ROS, and
`ScansIntake` scans in the map's frame. Nothing here needs ROS.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ndtree.live.corrections import Correction, Corrections
    from ndtree.live.fading import Fading
    from ndtree.live.figures import LiveFigures
    from ndtree.live.frames import FramesIntake, Reading, Transform
    from ndtree.live.grid import GridFollower, GridPart
    from ndtree.live.intake import Intake, ScansIntake, Verdict
    from ndtree.live.localizing import Localization, Localizer
    from ndtree.live.mapper import LiveMapper, Sink
    from ndtree.live.messages import MessagesIntake
    from ndtree.live.obstacles import ObstacleDistance, ObstacleSink, obstacle_distance
    from ndtree.live.playing import play
    from ndtree.live.saver import Saver
    from ndtree.live.serving import MapServer
    from ndtree.live.session import Session
    from ndtree.live.slam import Slam
    from ndtree.live.to_foxglove import FoxgloveSink
    from ndtree.live.to_rerun import RerunSink
    from ndtree.live.way import Way
    from ndtree.live.window import Window

#: Where each public name is; its module loads when it is asked for.
_MODULES = {
    "Correction": "corrections",
    "Corrections": "corrections",
    "Fading": "fading",
    "FoxgloveSink": "to_foxglove",
    "FramesIntake": "frames",
    "GridFollower": "grid",
    "GridPart": "grid",
    "Intake": "intake",
    "LiveFigures": "figures",
    "LiveMapper": "mapper",
    "Localization": "localizing",
    "Localizer": "localizing",
    "MapServer": "serving",
    "MessagesIntake": "messages",
    "ObstacleDistance": "obstacles",
    "ObstacleSink": "obstacles",
    "Reading": "frames",
    "RerunSink": "to_rerun",
    "Saver": "saver",
    "ScansIntake": "intake",
    "Session": "session",
    "Sink": "mapper",
    "Slam": "slam",
    "Transform": "frames",
    "Verdict": "intake",
    "Way": "way",
    "Window": "window",
    "obstacle_distance": "obstacles",
    "play": "playing",
}

__all__ = [
    "Correction",
    "Corrections",
    "Fading",
    "FoxgloveSink",
    "FramesIntake",
    "GridFollower",
    "GridPart",
    "Intake",
    "LiveFigures",
    "LiveMapper",
    "Localization",
    "Localizer",
    "MapServer",
    "MessagesIntake",
    "ObstacleDistance",
    "ObstacleSink",
    "Reading",
    "RerunSink",
    "Saver",
    "ScansIntake",
    "Session",
    "Sink",
    "Slam",
    "Transform",
    "Verdict",
    "Way",
    "Window",
    "obstacle_distance",
    "play",
]


def __getattr__(name: str) -> Any:
    """A name of the package."""
    if name not in _MODULES:
        raise AttributeError(f"module 'ndtree.live' has no attribute {name!r}")
    value = getattr(import_module(f"ndtree.live.{_MODULES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
