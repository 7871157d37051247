# SPDX-License-Identifier: BSD-3-Clause
"""``ndtree simulate``: a log of a world that is known exactly, as a file."""

from dataclasses import dataclass
from pathlib import Path
from typing import Optional

from ndtree import logs
from ndtree.base.exit_status import WrongCall
from ndtree.base.words import number_of
from ndtree.cli.commands.app import command, examples, reports_errors
from ndtree.cli.commands.flags import takes
from ndtree.cli.commands.messages import in_words
from ndtree.cli.commands.options import Scans, Seed, World, argument, flag
from ndtree.cli.commands.progress import progress


@dataclass(frozen=True)
class _Call:
    world: World = argument("A laser in an office, a depth camera, or a lidar.")
    output: Optional[Path] = flag(None, "An .npz file; else the world's name, here.", "--output", "-o")
    scans: Scans = None
    seed: Seed = 1
    people: Optional[int] = flag(None, "That walk, one ahead of the sensor.", min=0, max=1000)
    doors: Optional[int] = flag(None, "Of the office that open and close.", min=0, max=1000)
    cars: Optional[int] = flag(None, "In the street that drive.", min=0, max=1000)


@command(
    "simulate",
    epilog=examples(
        "ndtree simulate office -o office.npz",
        "ndtree simulate apartment --scans 50 --seed 2",
        "ndtree simulate street --people 8 --cars 6 -o traffic.npz",
    ),
)
@reports_errors
@takes(_Call)
def simulate(call: _Call) -> None:
    """Simulate a drive through a world, and write its log to a file that can be mapped."""
    target = Path(f"{call.world.value}.npz") if call.output is None else call.output
    if call.output is None and target.exists():
        raise WrongCall(f"{target}: is there already, expected -o LOG; to replace it:\n  -o {target}")
    if target.suffix != ".npz":
        raise WrongCall(f"-o {target}: the name must end in .npz")
    moving = {"people": call.people, "doors": call.doors, "cars": call.cars}
    given = {kind: count for kind, count in moving.items() if count is not None}
    try:
        log = logs.simulate(call.world.value, seed=call.seed, scans=call.scans, **given)
    except ValueError as error:
        raise WrongCall(in_words(error)) from None
    with progress() as advance:
        count = log.save(target, progress=advance)
    print(f"wrote {target}: {number_of(count, 'scan')}, {log.dim}-D")
    print(f"map it: ndtree map {target} --picture {target.stem}.png")
