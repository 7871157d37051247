# SPDX-License-Identifier: BSD-3-Clause
"""``ndtree demo``: a log mapped in several ways, and drawn."""

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from ndtree._native import _core
from ndtree.cli.commands.app import command, examples, reports_errors
from ndtree.cli.commands.comparing import compared
from ndtree.cli.commands.flags import map_options, reading_options
from ndtree.cli.commands.logs import open_log, warn_of_skipped
from ndtree.cli.commands.options import (
    Dim,
    Json,
    LogArgument,
    MaxRange,
    NoReturnKind,
    NoReturnOption,
    Scans,
    Seed,
    World,
)
from ndtree.cli.commands.output import check_target, is_stdout, write_json
from ndtree.cli.commands.pictures import draw_side_by_side, plotting


@command("demo", epilog=examples("ndtree demo", "ndtree demo drive.bag --output pictures"))
@reports_errors
@reading_options
@map_options
def demo(
    log: LogArgument = None,
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for the pictures.")] = Path(
        "ndtree-demo"
    ),
    dim: Dim = None,
    max_range: MaxRange = None,
    no_return: NoReturnOption = NoReturnKind.auto,
    scans: Scans = None,
    seed: Seed = 1,
    json_file: Json = None,
    options: Any = None,
    reading: Any = None,
) -> None:
    """Map a log in several ways, print what each map costs and how true it is, and draw them.

    Without LOG it simulates an office.
    """
    opened = open_log(log, World.office if log is None else None, dim, reading, scans, seed, max_range)
    size = options.get("min_cell_size", _core.default_options()["min_cell_size"])
    maps = ["adaptive", "fixed", f"fixed@{2 * size:g}"]
    if _core.has_octomap:
        maps.append("octomap")
    plot = plotting()
    check_target(json_file)
    comparison = compared(
        opened, maps, options, max_range=max_range, no_return=no_return.value, json_file=json_file
    )
    warn_of_skipped(opened)
    if not is_stdout(json_file):
        print(comparison)
    write_json(comparison, json_file)
    objects = comparison.map_objects
    output.mkdir(parents=True, exist_ok=True)
    pictures = [output / f"adaptive-{name.replace('@', '-')}.png" for name in maps[1:3]]
    for name, path in zip(maps[1:3], pictures):
        draw_side_by_side(plot, objects["adaptive"], objects[name], path)
    say = sys.stderr if is_stdout(json_file) else sys.stdout
    print(file=say)
    for path in pictures:
        print(path, file=say)
