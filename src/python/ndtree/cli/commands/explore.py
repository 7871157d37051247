# SPDX-License-Identifier: BSD-3-Clause
"""``ndtree explore``: a simulated robot explores a world by several strategies."""

import math
from enum import Enum
from typing import Annotated, Any

import typer

from ndtree.base.words import aligned
from ndtree.cli.commands.flags import Call, command
from ndtree.cli.commands.output import check_picture, is_stdout, write_json
from ndtree.cli.commands.pictures import draw_tracks, plotting
from ndtree.cli.commands.progress import progress
from ndtree.evaluation.exploring import STRATEGIES, Exploration, explore

#: Of the most volume that any strategy has seen: the way that each takes to so much of it.
PART = 0.95
_MOST_LOOKS = 1000


class ExploredWorld(str, Enum):
    """Worlds with a robot that explores them."""

    office = "office"
    apartment = "apartment"


@command(
    "explore",
    usual="strategy scans seed picture json_file",
    examples=(
        "ndtree explore office",
        "ndtree explore office --strategy information --picture explored.png",
        "ndtree explore apartment --seed 2 --json explored.json",
    ),
)
def explore_world(
    world: Annotated[ExploredWorld, typer.Argument(help="office: a laser; apartment: a depth camera.")],
    call: Call,
) -> None:
    """Let a simulated robot explore a world by several strategies.

    It drives to where it sees the most per metre, to the nearest frontier, or to a random one. In the
    office it has a laser; in the apartment a depth camera at 1.4 m, which turns around at each stop. A
    strategy takes a minute or more.
    """
    plot = plotting() if call.picture is not None else None
    check_picture(plot, call.picture)
    names = call.strategy or STRATEGIES
    done: dict[str, Exploration] = {}
    for name in dict.fromkeys(names):
        with progress() as advance:
            done[name] = explore(
                world,
                name,
                seed=call.seed,
                start=call.from_scan,
                max_looks=call.scans or _MOST_LOOKS,
                progress=lambda what, done, total, name=name: advance(f"{name}, {what}", done, total),
            )
    figures = _figures(done)
    if not is_stdout(call.json_file):
        print(*_table(world, figures), sep="\n")
    write_json({"world": world, "seed": call.seed, "strategies": figures}, call.json_file)
    if plot is not None and call.picture is not None:
        tracks = {f"{name}: {each.way[-1]:.0f} m": (each.map, each.track) for name, each in done.items()}
        draw_tracks(plot, tracks, call.picture)


def _figures(done: dict[str, Exploration]) -> dict[str, dict[str, Any]]:
    most = max(float(each.volume[-1]) for each in done.values())
    figures = {}
    for name, each in done.items():
        way = each.way_to(PART * most)
        figures[name] = {
            "way": float(each.way[-1]),
            "way_to_95_percent": way if math.isfinite(way) else None,
            "looks": len(each.way),
            "volume": float(each.volume[-1]),
            "seconds": float(each.seconds.sum()),
            "done": each.done,
            "shut_in": each.shut_in,
        }
    return figures


def _table(world: str, figures: dict[str, dict[str, Any]]) -> list[str]:
    unit = "m2" if world == "office" else "m3"
    rows = [["strategy", "path to 95 %", "whole path", "scans", "seen", "computed"]]
    for name, row in figures.items():
        way = "never" if row["way_to_95_percent"] is None else f"{row['way_to_95_percent']:.1f} m"
        seen, took = f"{row['volume']:.1f} {unit}", f"{row['seconds']:.1f} s"
        rows.append([name, way, f"{row['way']:.1f} m", str(row["looks"]), seen, took])
    ends = [
        ", nothing can be reached from here" if row["shut_in"] else "" if row["done"] else ", not done"
        for row in figures.values()
    ]
    return [line + end for line, end in zip(aligned(rows), ["", *ends])]
