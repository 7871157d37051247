# SPDX-License-Identifier: BSD-3-Clause
"""The commands of the command line, one file each.

Imports run one way: app, options, output ← logs ← figures, pictures, comparing ← the commands. A command's
module is loaded when the command is called, so that the help comes at once.
"""

from __future__ import annotations

from typing import Any

from ndtree.cli.commands.app import announce, app, loaded

__all__ = ["COMMANDS", "app", "every"]

#: In the order of the help: a command's module, and what the help says of it, which is how its own begins.
COMMANDS = {
    "demo": (
        "demo",
        "Map a log in several ways, draw the maps, and report their cost and accuracy.",
    ),
    "simulate": (
        "simulate",
        "Simulate a drive through a world, and write its log to a file that can be mapped.",
    ),
    "map": (
        "map_log",
        "Build a map from a log, and write it to a file. Several logs make a map each, or with --merge one.",
    ),
    "align": ("align", "Find the poses of a log that has none, or whose poses drift."),
    "clean": ("clean", "Write a log's points without moving things: people, cars, doors."),
    "live": (
        "live",
        "Map a recording as a robot would: message by message, at its own pace, and say what was dropped.",
    ),
    "fleet": (
        "fleet",
        "Map logs of several robots into tiles, byte for byte as one machine would: by time, then by name.",
    ),
    "compare": (
        "compare",
        "Compare maps of the same log: cells, updates, time, memory, and accuracy on held-out scans.",
    ),
    "study": ("study", "Map several logs with several sets of options, and write tables and a picture."),
    "calibrate": (
        "calibrate",
        "Estimate the options of the sensor from a log: the noise of its ranges, and its error rates.",
    ),
    "view": ("view", "Show a map in the browser until Ctrl-C, or draw it into a file."),
    "plan": ("plan", "Find a short path for a robot through a map."),
    "explore": ("explore", "Let a simulated robot explore a world by several strategies."),
    "convert": ("convert", "Write a map as a file of another kind."),
    "info": ("info", "Say what is in a map or a log."),
}

for _name, (_module, _summary) in COMMANDS.items():
    announce(_name, f"{__name__}.{_module}", _summary)


def every() -> dict[str, Any]:
    """All commands by name; their modules are loaded."""
    return {name: loaded(name, f"{__name__}.{module}") for name, (module, _) in COMMANDS.items()}
