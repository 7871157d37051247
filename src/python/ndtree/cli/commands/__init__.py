# SPDX-License-Identifier: BSD-3-Clause
"""The commands of the command line, one file each, in the order of the help.

Imports run one way: app, options, output ← logs ← figures, pictures, comparing ← the commands.
"""

# isort: off
from ndtree.cli.commands import demo, simulate, map_log, fleet, compare, study, calibrate, view, convert, info
from ndtree.cli.commands.app import app
# isort: on

__all__ = [
    "app",
    "calibrate",
    "compare",
    "convert",
    "demo",
    "fleet",
    "info",
    "map_log",
    "simulate",
    "study",
    "view",
]
