# SPDX-License-Identifier: BSD-3-Clause
"""``ndtree explore``: a simulated robot explores a world by several strategies."""

import math
from enum import Enum
from pathlib import Path
from typing import Annotated, Any

import typer

from ndtree.base.exit_status import WrongCall
from ndtree.base.files import replaced
from ndtree.cli.commands.flags import Call, command
from ndtree.cli.commands.output import check_picture, is_stdout, write_json
from ndtree.cli.commands.pictures import plotting
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
    if call.picture is not None and world != "office":
        raise WrongCall(f"--picture {call.picture}: of 2-D maps alone, and {world} is 3-D")
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
        _print(world, figures)
    write_json({"world": world, "seed": call.seed, "strategies": figures}, call.json_file)
    if plot is not None and call.picture is not None:
        _draw(plot, done, call.picture)


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


def _print(world: str, figures: dict[str, dict[str, Any]]) -> None:
    unit = "m2" if world == "office" else "m3"
    print(
        f"{'strategy':<12} {'path to 95 %':>12} {'whole path':>10} {'scans':>6} {'seen':>10} {'computed':>9}"
    )
    for name, row in figures.items():
        way = "never" if row["way_to_95_percent"] is None else f"{row['way_to_95_percent']:.1f} m"
        end = "" if row["done"] else ", not done"
        if row["shut_in"]:
            end = ", nothing can be reached from here"
        print(
            f"{name:<12} {way:>12} {row['way']:>8.1f} m {row['looks']:>6} {row['volume']:>7.1f} {unit} "
            f"{row['seconds']:>7.1f} s{end}"
        )


def _draw(plot: Any, done: dict[str, Exploration], picture: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.0 * len(done), 4.0), layout="constrained")
    for ax, (name, each) in zip(figure.subplots(1, len(done), squeeze=False)[0], done.items()):
        plot.occupancy(each.map, ax)
        ax.plot(*each.track.T, color="tab:red", linewidth=1.0)
        ax.set_title(f"{name}: {each.way[-1]:.0f} m", fontsize=10)
    with replaced(picture) as path:
        figure.savefig(path, format=picture.suffix[1:], dpi=90, bbox_inches="tight")
