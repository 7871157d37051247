# SPDX-License-Identifier: BSD-3-Clause
"""``ndtree info``: what is in a map or a log, and what another file is."""

from pathlib import Path
from typing import Annotated, Any, Optional

import typer

from ndtree.base.exit_status import WrongCall
from ndtree.base.words import number_of
from ndtree.cli.commands.figures import (
    FIRST_BEAMS,
    log_figures,
    map_figures,
    point,
    print_contents,
    print_log,
    print_map,
)
from ndtree.cli.commands.flags import Call, command, contents_of, opened, require_none
from ndtree.cli.commands.logs import load_map, skipped, warn_of_skipped
from ndtree.cli.commands.messages import in_words, indented, laid_out
from ndtree.cli.commands.output import is_stdout, write_json
from ndtree.cli.commands.progress import progress
from ndtree.logs import Log, NotALog
from ndtree.maps.open import is_map
from ndtree.tuning.config import Config

_LOOK_CLOSER = "to see what mapping will choose, and how long it takes:\n  ndtree info {} --look"


@command(
    "info",
    usual="look topic dim format json_file",
    examples=(
        "ndtree info drive.bag",
        "ndtree info drive.bag --look",
        "ndtree info office.ndt --json",
    ),
)
def info(
    path: Annotated[Path, typer.Argument(metavar="FILE", help="A map, or a log: a file or a folder.")],
    call: Call,
    given: Config,
) -> None:
    """Describe a map or a log.

    It answers at once: from a bag's index and first messages, from other logs' first million beams.
    """
    if is_map(path):
        require_none(given, "a map")
        if call.look or call.write_config is not None:
            raise WrongCall(f"--look: is for a LOG, and {path} is a map")
        loaded = load_map(path)
        figures = {"map": str(path), **map_figures(loaded)}
        if not is_stdout(call.json_file):
            low, high = loaded.min_cell_size, loaded.max_cell_size
            sizes = f"{low:g} m" if low == high else f"{low:g} to {high:g} m"
            print(f"{path}: {type(loaded).__name__}, {loaded.dim}-D, cells of {sizes}")
            print_map(figures)
        write_json(figures, call.json_file)
        return
    says = not is_stdout(call.json_file)
    look = call.look or call.write_config is not None or bool(given.values.keys() - {"format"})
    try:
        held = contents_of(given, path, whole=look)
        if held and says:
            print_contents(path, held)
        if held and not look:
            if says:
                print(_LOOK_CLOSER.format(path))
            write_json({"log": str(path), "format": "rosbag", "contents": held}, call.json_file)
            return
        log = opened(given, path)
        looks = (log.has_sensor and look) or call.write_config
        prospect = _prospect(log, given, call.write_config) if looks else None
        figures = {**log_figures(log, most=None if look else FIRST_BEAMS), "contents": held}
        figures["skipped"] = skipped(log)
        if says:
            print_log(figures)
        if log.has_sensor and not look and says:
            print(_LOOK_CLOSER.format(path))
        if prospect is not None:
            figures["prospect"] = prospect.figures()
        if prospect is not None and says:
            for line in prospect.lines():
                print(indented(line))
            for line in prospect.config.toml().splitlines():
                print(f"  {line}".rstrip())
        warn_of_skipped(log)
    except NotALog as found:
        held = _points_of(path, given) if found.has_points else {}
        figures = {"file": str(path), "kind": found.kind, "try": list(found.help), **held}
        if not is_stdout(call.json_file):
            print(laid_out(f"{path}: {found.kind}").removeprefix("ndtree: "))
            if held:
                lower, upper = (point(held["bounds"][name]) for name in ("lower", "upper"))
                print(f"  {number_of(held['points'], 'point')} from {lower} to {upper} m")
            for way in found.help:
                print(f"  try {in_words(way)}")
    write_json(figures, call.json_file)


def _prospect(log: Log, given: Config, write_config: Optional[Path]) -> Any:
    """What mapping will choose and cost; what is decided is written."""
    from ndtree.tuning.inspection import prospect_of  # Loads much; and most calls do not look.

    with progress() as advance:
        prospect = prospect_of(log, given, progress=advance)
    if write_config is not None:
        prospect.config.save(write_config)
    return prospect


def _points_of(path: Path, given: Config) -> dict[str, Any]:
    """How many points a file without poses has, and where they are; nothing where a library is missing."""
    try:
        log = opened(Config.of(points_only=True).overridden(given.values), path)
        figures = log_figures(log)
    except (ImportError, NotALog):
        return {}
    warn_of_skipped(log)
    if figures["bounds"] is None:
        return {}
    return {"points": figures["beams"]["returned"], "bounds": figures["bounds"]}
