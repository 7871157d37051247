# SPDX-License-Identifier: BSD-3-Clause
"""``ndtree align``: poses of a log from what its scans saw."""

from pathlib import Path
from typing import Optional, Union

from ndtree._errors import marked
from ndtree.alignment import (
    MAX_RANGE,
    MAX_RANGE_IN_SPACE,
    Alignment,
    SpatialAlignment,
    align,
    align_in_space,
)
from ndtree.base.words import listed, number_of
from ndtree.cli.commands.flags import Call, GivenLog, check_ranges, command, opened
from ndtree.cli.commands.logs import inspected, warn_of_skipped
from ndtree.cli.commands.mapping import mapped, written
from ndtree.cli.commands.messages import indented
from ndtree.cli.commands.output import check_dim, check_picture, is_stdout, write_json
from ndtree.cli.commands.pictures import plotting
from ndtree.cli.commands.progress import progress
from ndtree.logs import Log
from ndtree.logs.core.failures import NowhereKnown
from ndtree.tuning.config import Config


@command(
    "align",
    usual="map_file picture max_range loops every",
    examples=(
        "ndtree align drive.log -o poses.txt",
        "ndtree align drive.log -o poses.txt --map drive.ndt --picture before-after.png",
        "ndtree align lidar.bag -o poses.txt --map lidar.ndt",
        "ndtree map drive.log --align -o drive.ndt",
    ),
)
def align_(log: GivenLog, call: Call, given: Config) -> None:
    """Find the poses of a log that has none, or whose poses drift.

    Each scan is matched with earlier ones, and loops are closed. For 3-D lidars this takes the libraries of
    the extra lidar.
    """
    if call.max_range is not None:
        check_ranges(given, call.max_range)
    source = opened_at_rest(given, log)
    if call.map_file is not None:
        check_dim("--map", call.map_file, source.dim)
    if call.picture is not None:
        check_picture(plotting(), call.picture)
    found = aligned(source, call.max_range, call.loops)
    found.save(call.output)
    if call.picture is not None:
        found.draw(call.picture)
    if call.map_file is not None:
        written(mapped(*inspected(found.log, given)), call.map_file)
    if not is_stdout(call.json_file):
        print_alignment(source, found)
        files = listed([path for path in (call.output, call.map_file, call.picture) if path])
        print(f"in {found.seconds:.3f} s; wrote {files} (poses: t x y z qx qy qz qw)")
    write_json({"log": source.name, "format": source.format, **found.figures()}, call.json_file)
    warn_of_skipped(found.source)


def opened_at_rest(given: Config, path: Path) -> Log:
    """The log; where nothing says how its sensor moved, as if it stood, since scans will say."""
    try:
        return opened(given, path)
    except NowhereKnown as error:
        if given.says_poses:
            raise
        why = marked(error).partition(", expected one of")[0].removeprefix(f"{path}: ")
    log = opened(given.overridden(Config.of(still=True).values), path)
    log.uses = f"{log.uses.rpartition(', ')[0]}, poses from its scans"
    return log.noted(f"{why}: its scans alone say where it was")


def aligned(
    log: Log, max_range: Optional[float] = None, loops: bool = True
) -> Union[Alignment, SpatialAlignment]:
    """The alignment of a log, with its progress shown."""
    with progress() as advance:
        if log.dim == 3:
            farthest = max_range or MAX_RANGE_IN_SPACE
            return align_in_space(log, max_range=farthest, close_loops=loops, progress=advance)
        return align(log, max_range=max_range or MAX_RANGE, close_loops=loops, progress=advance)


def print_alignment(log: Log, found: Union[Alignment, SpatialAlignment]) -> None:
    """How far poses moved, and whether to trust them."""
    print(f"{log.name}: {number_of(len(found.poses), 'scan')} aligned")
    print(indented(str(found)))
