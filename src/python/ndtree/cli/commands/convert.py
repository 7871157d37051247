# SPDX-License-Identifier: BSD-3-Clause
"""``ndtree convert``: a map as a file of another kind."""

from pathlib import Path
from typing import Annotated, Any

import typer

from ndtree._errors import naming
from ndtree.base.files import require_no_input
from ndtree.cli.commands.flags import Call, MapArgument, command
from ndtree.cli.commands.logs import made, placed_map
from ndtree.maps.conversion import convert
from ndtree.maps.writers import FORMATS as MAP_FORMATS
from ndtree.maps.writers import format_of

_ENDINGS = ", ".join(dict.fromkeys(suffix for one in MAP_FORMATS for suffix in one.suffixes))
_OUT = f"Its ending decides the format: {_ENDINGS}."


@command(
    "convert",
    usual="cell_size height states faces format",
    examples=(
        "ndtree convert hall.ndt hall.bt",
        "ndtree convert hall.ndt hall.yaml --height 0.1 1.8",
        "ndtree convert hall.ndt hall.ply --states occupied,frontier",
    ),
)
def convert_(
    source: MapArgument,
    output: Annotated[Path, typer.Argument(metavar="OUT", help=_OUT)],
    call: Call,
) -> None:
    """Write a map as a file of another kind."""
    given: dict[str, Any] = {name: getattr(call, name) for name in ("cell_size", "height", "wall_depth")}
    given["states"] = None if call.states is None else call.states.split(",")
    given["faces"] = call.faces or None
    options = {name: value for name, value in given.items() if value is not None}
    made(lambda: format_of(output, call.format, options))
    require_no_input(output, [source])
    placed = placed_map(source, is_moved=call.cell_size is None)
    try:
        convert(placed, output, format=call.format, **options)
    except ValueError as error:
        raise naming(error, "cell_size", "height") from None
    print(f"{source}: wrote {output}")
