# SPDX-License-Identifier: BSD-3-Clause
"""``ndtree convert``: a map as a file of another kind."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Optional

from ndtree.base.files import require_no_input
from ndtree.cli.commands.app import command, examples, reports_errors
from ndtree.cli.commands.flags import takes
from ndtree.cli.commands.logs import made, placed_map
from ndtree.cli.commands.options import argument, flag
from ndtree.maps.conversion import convert
from ndtree.maps.writers import FORMATS as MAP_FORMATS
from ndtree.maps.writers import STATES as CELL_STATES
from ndtree.maps.writers import format_of

_ENDINGS = ", ".join(dict.fromkeys(suffix for one in MAP_FORMATS for suffix in one.suffixes))


@dataclass(frozen=True)
class _Call:
    source: Path = argument(".ndt, .bt, .ot, or map_server's .yaml.", metavar="MAP")
    output: Path = argument(f"Its ending says what is written: {_ENDINGS}.", metavar="OUT")
    format: Optional[str] = flag(
        None, f"Where the ending does not say: {', '.join(one.name for one in MAP_FORMATS)}."
    )
    cell_size: Optional[float] = flag(None, "Of the cells in all files but .ndt [m]; else the map's own.")
    height: Optional[tuple[float, float]] = flag(None, "Of an image of a 3-D map: cells within [m].")
    wall_depth: Optional[float] = flag(
        None, "In an image, what of large occupied cells: up to so far behind free space [m]."
    )
    states: Optional[str] = flag(None, f"Which cells, of {', '.join(CELL_STATES)}.")
    faces: bool = flag(False, "A mesh in a .ply, instead of points.", "--faces")


@command(
    "convert",
    epilog=examples(
        "ndtree convert hall.ndt hall.bt",
        "ndtree convert hall.ndt hall.yaml --height 0.1 1.8",
        "ndtree convert hall.ndt hall.ply --states occupied,frontier",
    ),
)
@reports_errors
@takes(_Call)
def convert_(call: _Call) -> None:
    """Write a map as a file of another kind."""
    given: dict[str, Any] = {
        "cell_size": call.cell_size,
        "height": call.height,
        "wall_depth": call.wall_depth,
        "states": call.states.split(",") if call.states is not None else None,
        "faces": call.faces or None,
    }
    options = {name: value for name, value in given.items() if value is not None}
    made(lambda: format_of(call.output, call.format, options))
    require_no_input(call.output, [call.source])
    convert(
        placed_map(call.source, is_moved=call.cell_size is None), call.output, format=call.format, **options
    )
    print(f"{call.source}: wrote {call.output}")
