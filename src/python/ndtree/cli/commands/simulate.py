# SPDX-License-Identifier: BSD-3-Clause
"""``ndtree simulate``: a log of a world that is known exactly, as a file."""

from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from ndtree import logs
from ndtree.base.exit_status import WrongCall
from ndtree.base.words import number_of
from ndtree.cli.commands.flags import Call, command
from ndtree.cli.commands.messages import in_words
from ndtree.cli.commands.progress import progress


class World(str, Enum):
    """Worlds to simulate."""

    office = "office"
    apartment = "apartment"
    street = "street"


@command(
    "simulate",
    usual="scans seed people doors cars",
    examples=(
        "ndtree simulate office -o office.npz",
        "ndtree simulate apartment --scans 50 --seed 2",
        "ndtree simulate street --people 8 --cars 6 -o traffic.npz",
    ),
)
def simulate(
    world: Annotated[World, typer.Argument(help="A laser in an office, a depth camera, or a lidar.")],
    call: Call,
) -> None:
    """Simulate a drive through a world, and write its log to a file that can be mapped."""
    target = Path(f"{world}.npz") if call.output is None else call.output
    if call.output is None and target.exists():
        raise WrongCall(f"{target}: is there already, expected -o LOG; to replace it:\n  -o {target}")
    if target.suffix != ".npz":
        raise WrongCall(f"-o {target}: the name must end in .npz")
    moving = {kind: getattr(call, kind) for kind in ("people", "doors", "cars")}
    given = {kind: count for kind, count in moving.items() if count is not None}
    try:
        log = logs.simulate(world, seed=call.seed, scans=call.scans, **given)
    except ValueError as error:
        raise WrongCall(in_words(error)) from None
    with progress() as advance:
        count = log.save(target, progress=advance)
    print(f"wrote {target}: {number_of(count, 'scan')}, {log.dim}-D")
    print(f"map it: ndtree map {target} --picture {target.stem}.png")
