# SPDX-License-Identifier: BSD-3-Clause
"""Maps of one log, compared with what the log says of its beams."""

import functools
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Callable, Optional

from ndtree._errors import located
from ndtree._native import _core
from ndtree._native._core import OccupancyMap
from ndtree.base.exit_status import WrongCall
from ndtree.cli.commands.logs import inspected, made, print_lines, warn_of_skipped
from ndtree.cli.commands.messages import in_words
from ndtree.cli.commands.output import is_stdout
from ndtree.cli.commands.progress import progress
from ndtree.evaluation.comparison import DEFAULT_MAPS, Comparison, Turns, map_in_turns
from ndtree.logs import Log
from ndtree.maps.kinds import make_map
from ndtree.tuning.config import Config
from ndtree.tuning.first_look import Scale


def compared(
    log: Log,
    maps: Optional[Sequence[str]],
    given: Config,
    *,
    json_file: Optional[Path],
    turns: Optional[Turns] = None,
    made_maps: Callable[[dict[str, OccupancyMap]], None] = lambda maps: None,
    **judging: bool,
) -> Comparison:
    """Maps of the log, compared; `made_maps` gets them before they are judged, which takes longer."""
    turns = turns or Turns()
    if turns.held_out == 1:
        raise WrongCall("--held-out 1: must be 0, or at least 2, or nothing is left to map")
    maps = maps or DEFAULT_MAPS
    if len(set(maps)) != len(maps):
        raise WrongCall(f"--maps {','.join(maps)}: must be different")
    options = given.options
    size = options.get("min_cell_size", _core.default_options()["min_cell_size"])
    for name in maps:
        made(functools.partial(make_map, name, dim=log.dim, **options))
    log, config = inspected(log, given, with_sigma=False)
    with progress() as advance:
        try:
            turns = replace(turns, max_range=config.max_range, no_return=config.no_return)
            trial = map_in_turns(log, maps, turns, progress=advance, **options)
        except ValueError as error:
            if str(error).startswith(log.name):
                raise
            raise located(log.name, error) from None
    if not is_stdout(json_file):
        print_lines(log, config)
        sample = config.look.sample if config.look else ()
        absurd = Scale.of(sample, size, config.get("max_range", math.inf)).warning()
        if absurd:
            print(f"{log.name}: {in_words(absurd)}")
    made_maps(trial.map_objects)
    with progress() as advance:
        comparison = trial.judged(advance, **judging)
    warn_of_skipped(log)
    return comparison
