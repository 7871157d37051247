# SPDX-License-Identifier: BSD-3-Clause
"""Logs and maps that commands open, and with which options they go on."""

import sys
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Callable, Optional

from ndtree._native._core import OccupancyMap
from ndtree.base.exit_status import WrongCall
from ndtree.base.scan import Scan
from ndtree.cli.commands.flags import opened, require_none
from ndtree.cli.commands.messages import in_words, indented, laid_out
from ndtree.cli.commands.progress import progress
from ndtree.logs import Log, simulate
from ndtree.maps.open import PlacedMap, open_map
from ndtree.tuning.config import Config


def load_map(path: Path) -> OccupancyMap:
    """A map of any kind; an image that begins at no whole number of pixels from 0 is moved to the nearest."""
    return placed_map(path).resampled()


def placed_map(path: Path, *, is_moved: bool = True) -> PlacedMap:
    """A map of any kind; what a user should know of it is said, also where it `is_moved`."""
    placed = open_map(path)
    for note in (*placed.notes, *([placed.moved_note] if is_moved and placed.moved_note else [])):
        print(laid_out(f"{path}: {note}"), file=sys.stderr)
    return placed


def open_log(
    path: Optional[Path], world: Optional[str], given: Config, scans: Optional[int] = None, seed: int = 1
) -> Log:
    if path is not None:
        if scans is not None:
            raise WrongCall("--scans: is for simulated logs only")
        return opened(given, path)
    if world is None:
        raise WrongCall("LOG is missing, expected one, or --world NAME")
    require_none(given, f"the simulated {world}")
    simulated = simulate(world, seed=seed, scans=scans)  # type: ignore[arg-type]
    if given.get("dim", simulated.dim) != simulated.dim:
        raise WrongCall(f"--dim {given.get('dim')}: the {world} is {simulated.dim}-D")
    return simulated


def timed(source: Iterable[Scan]) -> Iterator[tuple[Scan, float]]:
    """Scans, and how long it took to read each [s]."""
    scans = iter(source)
    while True:
        begin = time.perf_counter()
        scan = next(scans, None)
        if scan is None:
            return
        yield scan, time.perf_counter() - begin


def skipped(log: Log) -> dict[str, Any]:
    return {kind: {"count": one.count, "first": one.first} for kind, one in log.skipped.items()}


def warn_of_skipped(log: Log) -> None:
    """One line for each thing that the reader decided, and each kind of what was passed over."""
    for note in log.notes:
        print(laid_out(note), file=sys.stderr)
    for kind, one in log.skipped.items():
        if one.summary is not None:
            print(laid_out(one.summary), file=sys.stderr)
            continue
        first = " ".join(one.first.split())
        print(laid_out(f"skipped {one.count} {kind}, the first: {first}"), file=sys.stderr)


def length_of(log: Log) -> int:
    return len(log) if hasattr(log, "__len__") else 0


def made(make: Callable[[], Any]) -> Any:
    """What `make` makes; options that it refuses are a wrong call, not bad input."""
    try:
        return make()
    except (ValueError, TypeError, RuntimeError) as error:
        raise WrongCall(in_words(error)) from None


def inspected(log: Log, given: Config, *, with_sigma: bool = True) -> tuple[Log, Config]:
    """What was decided of a log, and the log as it is read then."""
    from ndtree.tuning.inspection import inspect  # It loads all that looks into logs.

    with progress() as advance:
        config = inspect(log, given, with_sigma=with_sigma, progress=advance)
    return config.ruled(log), config


def print_lines(log: Log, config: Config) -> None:
    """What was chosen, before what it was chosen for."""
    if config.notes:
        print(f"{log.name}:")
    for line in config.notes:
        print(indented(line))
