# SPDX-License-Identifier: BSD-3-Clause
"""Logs and maps that commands open, and with which options they go on."""

import math
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Callable, Optional

from ndtree._native import _core
from ndtree._native._core import OccupancyMap
from ndtree.base.exit_status import WrongCall
from ndtree.base.scan import Scan
from ndtree.cli.commands.flags import Reading
from ndtree.cli.commands.messages import laid_out
from ndtree.cli.commands.options import World
from ndtree.cli.commands.progress import progress
from ndtree.logs import Log, simulate
from ndtree.maps.open import open_map

if TYPE_CHECKING:  # It loads all that looks into logs, for which `info` has no use.
    from ndtree.tuning.settings import Settings


def load_map(path: Path) -> OccupancyMap:
    """A map of any kind; an image that does not begin at a whole number of pixels from 0 is sampled anew."""
    placed = open_map(path)
    return placed.resampled(placed.cell_size)


def open_log(
    path: Optional[Path],
    world: Optional[World],
    dim: Optional[int],
    reading: Reading,
    scans: Optional[int] = None,
    seed: int = 1,
    max_range: Optional[float] = None,
) -> Log:
    if path is not None:
        if scans is not None:
            raise WrongCall("--scans: is for simulated logs only")
        return reading.open(path, dim, max_range)
    if world is None:
        raise WrongCall("expected a LOG")
    reading.require_none(f"the simulated {world.value}")
    simulated = simulate(world.value, seed=seed, scans=scans)
    if dim not in (None, simulated.dim):
        raise WrongCall(f"--dim {dim}: the {world.value} is {simulated.dim}-D")
    return simulated


def timed(log: Log) -> Iterator[tuple[Scan, float]]:
    """Scans, and how long it took to read each [s]."""
    scans = iter(log)
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
        print(laid_out(f"passed over {one.count} {kind}, the first: {first}"), file=sys.stderr)


def length_of(log: Log) -> int:
    return len(log) if hasattr(log, "__len__") else 0


def limit_of(max_range: Optional[float]) -> float:
    if max_range is None:
        return math.inf
    if not max_range > 0:
        raise WrongCall(f"--max-range {max_range:g}: must be > 0 m")
    return max_range


def made(make: Callable[[], Any]) -> Any:
    """What `make` makes; options that it refuses are a wrong call, not bad input."""
    try:
        return make()
    except (ValueError, TypeError, RuntimeError) as error:
        raise WrongCall(str(error)) from None


def new_map(dim: int, fixed: bool, options: dict[str, Any]) -> OccupancyMap:
    if not fixed:
        return _core.AdaptiveMap(dim=dim, **options)
    return _core.FixedMap(
        dim=dim,
        **{("cell_size" if name == "min_cell_size" else name): value for name, value in options.items()},
    )


def settled(
    log: Log, options: dict[str, Any], max_range: float, no_return: str, *, with_sigma: bool = False
) -> "Settings":
    from ndtree.tuning.settings import settle

    with progress() as advance:
        return settle(
            log,
            options=options,
            max_range=max_range,
            no_return=no_return,
            with_sigma=with_sigma,
            progress=advance,
        )


def print_settings(log: Log, settings: "Settings") -> None:
    """What was chosen, before what it was chosen for."""
    for line in settings.lines():
        print(laid_out(f"{log.name}: {line}").removeprefix("ndtree: "))
