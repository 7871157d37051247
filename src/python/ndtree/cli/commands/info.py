# SPDX-License-Identifier: BSD-3-Clause
"""``ndtree info``: what is in a map or a log, and what another file is."""

from pathlib import Path
from typing import Annotated, Any

import typer

from ndtree.cli.commands.app import command, examples, reports_errors
from ndtree.cli.commands.figures import (
    log_figures,
    map_figures,
    point,
    print_contents,
    print_log,
    print_map,
)
from ndtree.cli.commands.flags import in_flags, reading_options
from ndtree.cli.commands.logs import load_map, skipped, warn_of_skipped
from ndtree.cli.commands.options import Dim, Json
from ndtree.cli.commands.output import check_target, is_stdout, write_json
from ndtree.cli.commands.progress import progress
from ndtree.logs import NotALog
from ndtree.maps.open import is_map
from ndtree.tuning.prospect import prospect_of


@command(
    "info",
    epilog=examples("ndtree info office.npz", "ndtree info drive.bag", "ndtree info office.ndt --json -"),
)
@reports_errors
@reading_options
def info(
    path: Annotated[Path, typer.Argument(help="A map, or a log.")],
    dim: Dim = None,
    json_file: Json = None,
    reading: Any = None,
) -> None:
    """Say what is in a map or a log."""
    check_target(json_file)
    if is_map(path):
        reading.require_none("a map")
        loaded = load_map(path)
        figures = {"map": str(path), **map_figures(loaded)}
        if not is_stdout(json_file):
            print(f"{path}: {loaded!r}")
            print_map(loaded)
        write_json(figures, json_file)
        return
    try:
        held = reading.contents(path)
        if held and not is_stdout(json_file):
            print_contents(path, held)
        opened = reading.open(path, dim)
        figures = {**log_figures(opened), "contents": held, "skipped": skipped(opened)}
        if not is_stdout(json_file):
            print_log(figures)
        if opened.is_raw:
            with progress() as advance:
                prospect = prospect_of(opened, progress=advance)
            figures["prospect"] = prospect.figures()
            if not is_stdout(json_file):
                for line in prospect.lines():
                    print(f"  {line}")
        warn_of_skipped(opened)
    except NotALog as found:
        held = _points_of(path, reading) if found.has_points else {}
        figures = {"file": str(path), "kind": found.kind, "try": list(found.help), **held}
        if not is_stdout(json_file):
            print(f"{path}: {found.kind}")
            if held:
                lower, upper = (point(held["bounds"][name]) for name in ("lower", "upper"))
                print(f"  {held['points']:,} points from {lower} to {upper} m")
            for way in found.help:
                print(f"  try {in_flags(way)}")
    write_json(figures, json_file)


def _points_of(path: Path, reading: Any) -> dict[str, Any]:
    """How many points a file without poses has, and where they are; nothing where they cannot be read."""
    try:
        figures = log_figures(reading.with_default("points_only", True).open(path, None))
    except (ImportError, OSError, ValueError):
        return {}
    if figures["bounds"] is None:
        return {}
    return {"points": figures["beams"]["returned"], "bounds": figures["bounds"]}
