# SPDX-License-Identifier: BSD-3-Clause
"""The commands of the command line, one file each.

Imports run one way: app, options, output ← logs ← figures, pictures, comparing ← the commands. A command's
module is loaded when the command is called, so that the help comes at once.
"""

from __future__ import annotations

from typing import Any

from ndtree.cli.commands.app import announce, app, loaded

__all__ = ["COMMANDS", "app", "every"]

#: In the order of the help: the commands, and their modules.
_NAMES = "demo simulate map align clean live fleet compare study calibrate view plan explore convert info"
COMMANDS = {name: "map_log" if name == "map" else name for name in _NAMES.split()}

for _name, _module in COMMANDS.items():
    announce(_name, f"{__name__}.{_module}")


def every() -> dict[str, Any]:
    """All commands by name; their modules are loaded."""
    return {name: loaded(name, f"{__name__}.{module}") for name, module in COMMANDS.items()}
