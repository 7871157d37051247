# SPDX-License-Identifier: BSD-3-Clause
"""``ndtree compare``: maps of one log, or two maps."""

from pathlib import Path
from typing import Annotated, Optional

import typer

from ndtree.base.exit_status import WrongCall
from ndtree.cli.commands.comparing import compared
from ndtree.cli.commands.flags import Call, command, typed
from ndtree.cli.commands.logs import open_log, placed_map
from ndtree.cli.commands.output import check_picture, is_stdout, write, write_json
from ndtree.cli.commands.pictures import plotting
from ndtree.evaluation.comparison import Turns
from ndtree.evaluation.map_comparison import compare_maps
from ndtree.maps.open import is_map
from ndtree.tuning.config import Config

_A = "A log, or the first of two maps."
_B = "The second: .ndt, .bt, .ot or map_server's .yaml."


@command(
    "compare",
    usual="world maps min_cell_size max_range picture",
    examples=(
        "ndtree compare office.npz --max-range 20 --no-return ignore --json office.json",
        "ndtree compare --world apartment --maps adaptive,fixed,fixed@0.1,octomap --picture rooms.png",
        "ndtree compare office.npz --calibration --certify --reliability office.png",
        "ndtree compare hall.ndt hall.bt --picture differences.png",
    ),
)
def compare_(
    context: typer.Context,
    call: Call,
    given: Config,
    log: Annotated[Optional[Path], typer.Argument(metavar="LOG | A", help=_A)] = None,
    other: Annotated[Optional[Path], typer.Argument(metavar="B", help=_B)] = None,
) -> None:
    """Compare maps of the same log: cells, updates, time, memory, and accuracy on held-out scans.

    Or two maps A and B of any kind: their states cell by cell, and how far their surfaces are apart.
    """
    if log is not None and (other is not None or is_map(log)):
        _compare_two(context, log, other, call.json_file, call.picture)
        return
    if (log is None) == (call.world is None):
        raise WrongCall("compare: expected either LOG or --world")
    opened = open_log(log, call.world, given, call.scans, call.seed)
    names = [name.strip() for name in call.maps.split(",")] if call.maps is not None else None
    plot = plotting() if call.picture or call.reliability else None
    for path in (call.picture, call.reliability):
        check_picture(plot, path)
    if call.held_out == 0 and (call.calibration or call.reliability or call.certify):
        raise WrongCall("--held-out 0: must be at least 2 for --calibration, --reliability and --certify")
    if call.picture and names is not None and len(names) < 2:
        raise WrongCall("--picture: expected at least two maps")
    comparison = compared(
        opened,
        names,
        given,
        turns=Turns(held_out=call.held_out, repeat=call.repeat),
        json_file=call.json_file or call.csv_file,
        calibration=call.calibration or call.reliability is not None,
        certify=call.certify,
    )
    if plot and call.picture:
        one, other = list(comparison.map_objects.values())[:2]
        (plot.side_by_side if one.dim == 2 else plot.side_by_side_3d)(one, other, call.picture)
    if plot and call.reliability:
        plot.reliability(comparison, call.reliability)
    if not (is_stdout(call.json_file) or is_stdout(call.csv_file)):
        print(comparison)
    write(comparison.to_csv, call.csv_file)
    write_json(comparison, call.json_file)


def _compare_two(
    context: typer.Context, a: Path, b: Optional[Path], json_file: Optional[Path], picture: Optional[Path]
) -> None:
    if b is None:
        raise WrongCall(f"compare: {a} is a map, expected a second one")
    for parameter in typed(context):
        if parameter.name not in ("log", "other", "json_file", "picture"):
            raise WrongCall(f"{parameter.opts[0]}: is for a LOG, and {a} is a map")
    check_picture(plotting() if picture else None, picture)
    comparison = compare_maps(placed_map(a, is_moved=False), placed_map(b, is_moved=False))
    if picture:
        comparison.draw(picture)
    if not is_stdout(json_file):
        print(comparison)
    write(comparison.to_json, json_file)
