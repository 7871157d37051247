# SPDX-License-Identifier: BSD-3-Clause
"""A map of a robot that drives: scans and poses as they come, a map that others see change.

`LiveMapper` is the mapper; `FramesIntake` takes arrays with transforms, `MessagesIntake` messages of ROS, and
`ScansIntake` scans in the map's frame. Nothing here needs ROS.
"""

from __future__ import annotations

from ndtree.live.figures import LiveFigures
from ndtree.live.frames import FramesIntake
from ndtree.live.intake import Intake, ScansIntake, Verdict
from ndtree.live.mapper import LiveMapper, Sink
from ndtree.live.messages import MessagesIntake
from ndtree.live.play import play
from ndtree.live.saver import Saver
from ndtree.live.window import Window

__all__ = [
    "FramesIntake",
    "Intake",
    "LiveFigures",
    "LiveMapper",
    "MessagesIntake",
    "Saver",
    "ScansIntake",
    "Sink",
    "Verdict",
    "Window",
    "play",
]
