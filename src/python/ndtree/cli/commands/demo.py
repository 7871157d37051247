# SPDX-License-Identifier: BSD-3-Clause
"""``ndtree demo``: a log mapped in several ways, and drawn."""

import os
import shlex
import shutil
import sys
from pathlib import Path
from typing import Optional

import typer

from ndtree._native import _core
from ndtree._native._core import OccupancyMap
from ndtree.base.words import aligned
from ndtree.cli.commands.comparing import compared
from ndtree.cli.commands.flags import Call, LogArgument, command, typed
from ndtree.cli.commands.logs import open_log
from ndtree.cli.commands.output import is_stdout, write_json
from ndtree.cli.commands.pictures import plotting
from ndtree.tuning.config import Config


@command(
    "demo",
    usual="min_cell_size max_range no_return every json_file",
    examples=(
        "ndtree demo",
        "ndtree demo drive.bag --output pictures",
    ),
)
def demo(context: typer.Context, call: Call, given: Config, log: LogArgument = None) -> None:
    """Map a log in several ways, draw the maps, and report their cost and accuracy.

    Without LOG it simulates an office.
    """
    opened = open_log(log, "office" if log is None else None, given, call.scans, call.seed)
    size = given.get("min_cell_size", _core.default_options()["min_cell_size"])
    maps = ["adaptive", "fixed", f"fixed@{2 * size:g}"]
    if _core.has_octomap:
        maps.append("octomap")
    plot = plotting()
    say = sys.stderr if is_stdout(call.json_file) else sys.stdout
    pictures = [call.output / f"adaptive-{name.replace('@', '-')}.png" for name in maps[1:3]]

    def show(made: dict[str, OccupancyMap]) -> None:
        call.output.mkdir(parents=True, exist_ok=True)
        for name, path in zip(maps[1:3], pictures):
            draw = plot.close_up if opened.dim == 2 else plot.side_by_side_3d
            draw(made["adaptive"], made[name], path)
        print(*_first_lines(made, pictures[0]), sep="\n", file=say, flush=True)

    comparison = compared(opened, maps, given, json_file=call.json_file, made_maps=show)
    if not is_stdout(call.json_file):
        print(f"\n{comparison}")
    write_json(comparison, call.json_file)
    print(f"\nPictures: {', '.join(str(path) for path in pictures)}", file=say)
    print(*_next_lines(context, log, opened.dim), sep="\n", file=say)


def _first_lines(maps: dict[str, OccupancyMap], picture: Path) -> list[str]:
    """What the maps need, before they are judged, and the picture of it."""
    stats = {name: one.stats() for name, one in maps.items()}
    rows = [
        [name, f"{one.observed_leaves:,} cells", f"{one.memory_bytes / 2**20:.2f} MiB"]
        for name, one in stats.items()
    ]
    return [
        "",
        *aligned(rows),
        "",
        f"See {picture}. Measuring how true each of them is takes a little longer ...",
    ]


def _next_lines(context: typer.Context, log: Optional[Path], dim: int) -> list[str]:
    """Three commands to try next: on the same log if it is the user's own."""
    program = _program()
    if log is None:
        return [
            "",
            "Next, with a log of your own (a bag, a folder of clouds or depth images, CARMEN, .npz ...):",
            f"  {program} info drive.bag                      # can it be read, and what is in it?",
            f"  {program} map drive.bag -o drive.ndt --watch  # its map, which grows on a page",
            f"  {program} demo drive.bag                      # this comparison of it",
        ]
    given = shlex.join([str(log), *_flags_of(context)])
    stem = log.name.split(".")[0] or "map"
    target = shlex.quote(f"{stem}.ndt")
    if dim == 2:
        converted = f"{shlex.quote(stem + '.yaml')}  # for nav2; or .bt, .ply, .png, a bag ..."
    else:
        converted = f"{shlex.quote(stem + '.bt')}  # for OctoMap; or .ply, .pcd, .glb, .vtu, a bag ..."
    return [
        "",
        "Next, with the same log:",
        f"  {program} map {given} -o {target}  # its map; --watch shows how it grows",
        f"  {program} view {target}  # the map on a page in the browser",
        f"  {program} convert {target} {converted}",
    ]


def _program() -> str:
    """How this program is called from here: by its name, if the shell finds it, or by its place."""
    here = Path(sys.argv[0])
    found = shutil.which("ndtree")
    if found is None and here.name == "ndtree" and here.is_file():
        return shlex.quote(os.path.relpath(here) if here.is_relative_to(Path.cwd()) else str(here))
    return "ndtree"


def _flags_of(context: typer.Context) -> list[str]:
    """The flags that were given and that mapping the log takes, too."""
    flags = []
    for parameter in typed(context):
        if parameter.name not in ("log", "output", "seed", "json_file"):
            value, flag = context.params[parameter.name], parameter.opts[0]
            several = value if isinstance(value, (list, tuple)) else [value]
            flags += [flag if one is True else f"{flag}={getattr(one, 'value', one)}" for one in several]
    return flags
