# SPDX-License-Identifier: BSD-3-Clause
"""Memory and counts of a live mapper over hours with faults, played as fast as they are mapped.

    python tools/bench/live_day.py [--hours 8] [--bag BAG] [--window 30] [--seed 0] [--json]

Two lasers in the simulated office with all that goes wrong on robots (`tests/python/day.py`), or the messages
of a bag in a loop. A sink keeps a grid, as the node does.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator
from itertools import takewhile
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "python"))

from day import Day, looped

from ndtree.live import GridFollower, LiveMapper, MessagesIntake, Window, play
from ndtree.logs.ros.storage import Raw
from ndtree.tuning.config import Config

#: How often memory is looked at.
LOOKS = 20


def resident() -> float:
    """Memory of this process [MiB]."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 2**20


class Grid:
    """A sink that keeps a grid."""

    period = 0.0

    def __init__(self) -> None:
        self._grid = GridFollower()

    def update(self, m: Any, stamp: float) -> None:
        self._grid.follow(m)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--hours", type=float, default=8.0)
    parser.add_argument("--bag", type=Path)
    parser.add_argument("--window", type=float, default=30.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    seconds = 3600 * given.hours
    memory: list[float] = []

    def messages() -> Iterator[tuple[Raw, float]]:
        raws = Day(given.seed).messages(seconds) if given.bag is None else looped(given.bag, float("inf"))
        first = next(raws)
        begin = 1e-9 * first.received
        yield first, begin
        for raw in takewhile(lambda raw: 1e-9 * raw.received < begin + seconds, raws):
            at = 1e-9 * raw.received
            if at - begin >= len(memory) * seconds / LOOKS:
                memory.append(round(resident(), 1))
                if not given.json:
                    print(f"{(at - begin) / 3600:6.2f} h: {memory[-1]:.0f} MiB resident", flush=True)
            yield raw, at

    options = {"range_sigma": 0.02}
    intake = MessagesIntake("day", Config.of(**options, sweep="stamp", no_return="free"))
    begin = time.perf_counter()
    with LiveMapper(intake, window=Window(given.window), sinks=[Grid()], threads=1) as mapper:
        play(messages(), mapper, rate=0)
    memory.append(round(resident(), 1))
    figures = mapper.figures
    said = {
        "received": figures.received,
        "mapped": figures.mapped,
        "dropped": figures.dropped,
        "left out": sum(figures.left_out.values()),
        "why": figures.left_out,
        "late poses": figures.late_poses,
        "map [MiB]": round(mapper.snapshot().stats().memory_bytes / 2**20, 2),
        "resident [MiB]": memory,
        "seconds": round(time.perf_counter() - begin, 1),
    }
    print(json.dumps(said) if given.json else "\n".join(f"{name}: {value}" for name, value in said.items()))


if __name__ == "__main__":
    main()
