# SPDX-License-Identifier: BSD-3-Clause
"""``ndtree fleet``: logs of several robots into one map in tiles, on an engine."""

import functools
from pathlib import Path
from typing import Annotated

import typer

from ndtree import distributed
from ndtree.base.words import number_of
from ndtree.cli.commands.flags import Call, command
from ndtree.cli.commands.logs import inspected, made
from ndtree.cli.commands.messages import indented
from ndtree.cli.commands.output import is_stdout, write_json
from ndtree.cli.commands.progress import progress
from ndtree.tiles import TileGrid
from ndtree.tiles.order import named, opened
from ndtree.tuning.config import MAPPING, OF_MAPS, Config


@command(
    "fleet",
    usual="min_cell_size max_range engine workers tile_size",
    examples=(
        "ndtree fleet monday.bag tuesday.bag -o depot.tiles",
        "ndtree fleet robots/*.bag -o s3://maps/depot --engine ray",
    ),
)
def fleet(
    logs: Annotated[list[Path], typer.Argument(metavar="LOG...", help="Files or folders, as of map.")],
    call: Call,
    given: Config,
) -> None:
    """Map logs of several robots into tiles, byte for byte as one machine would: by time, then by name.

    The first log chooses options that are not given. The same call continues a killed run.
    """
    sources = named([str(log) for log in logs])
    of_logs = given.values.keys() - {*OF_MAPS, *MAPPING, "fixed"}
    if of_logs:  # Workers read them as well.
        how = Config({name: given.values[name] for name in of_logs})
        sources = {name: functools.partial(how.read, log) for name, log in sources.items()}
    first = opened(next(iter(sources.values())))
    made(lambda: given.new_map(first.dim))
    _, config = inspected(first, given)
    target = config.new_map(first.dim)
    made(lambda: TileGrid.of(target, call.tile_size))
    with progress() as advance:
        report = distributed.map(
            sources,
            call.output,
            engine=call.engine,
            like=target,
            tile_size=call.tile_size,
            max_range=config.max_range,
            no_return=config.no_return,
            workers=call.workers,
            progress=advance,
        )
    if not is_stdout(call.json_file):
        beams = number_of(report.beams, "beam")
        print(f"{number_of(len(sources), 'log')}: {number_of(report.scans, 'scan')}, {beams}")
        for line in config.notes:
            print(indented(line))
        print(
            f"  {report.tiles} tiles in {number_of(report.blocks, 'block')}; {report.seconds:.3f} s on "
            f"{report.workers} workers, idle for {100 * report.idle:.0f} % of the time"
        )
        print(f"wrote {call.output}; look at it: ndtree view {call.output} --open")
    write_json(report.figures(), call.json_file)
