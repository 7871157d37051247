# SPDX-License-Identifier: BSD-3-Clause
"""Arguments and flags that several commands have."""

from dataclasses import MISSING, field
from enum import Enum
from pathlib import Path
from typing import Annotated, Any, Optional

import typer

from ndtree.logs import FORMATS


def flag(default: Any, help: str, *names: str, **more: Any) -> Any:
    """A field of a call that is typed behind a flag: of its own name, or of these; see `flags.takes`."""
    return _typed(default, typer.Option(*names, help=help.replace("[", r"\["), **more))


def argument(help: str, *, default: Any = MISSING, **more: Any) -> Any:
    """A field of a call that is typed without a flag."""
    return _typed(default, typer.Argument(help=help.replace("[", r"\["), **more))


def _typed(default: Any, how: Any) -> Any:
    return field(default=default, metadata={"typed": how})


class World(str, Enum):
    """Worlds to simulate."""

    office = "office"
    apartment = "apartment"
    street = "street"


class NoReturnKind(str, Enum):
    """What a beam without return says."""

    auto = "auto"
    free = "free"
    ignore = "ignore"


class CellColor(str, Enum):
    """What the colors of cells say."""

    height = "height"
    size = "size"
    probability = "probability"


LogArgument = Annotated[
    Optional[Path], typer.Argument(metavar="LOG", help=f"File or folder: {', '.join(FORMATS)}.")
]
GivenLogs = Annotated[
    list[Path], typer.Argument(metavar="LOG...", help=f"Files or folders: {', '.join(FORMATS)}.")
]
GivenLog = Annotated[Path, typer.Argument(metavar="LOG", help=f"File or folder: {', '.join(FORMATS)}.")]
Dim = Annotated[Optional[int], typer.Option(min=2, max=3, help="2 or 3; else what the log says.")]
MaxRange = Annotated[
    Optional[float],
    typer.Option(help="Longer beams are cut off here, and free up to it \\[m]; else no limit."),
]
NoReturnOption = Annotated[
    Optional[NoReturnKind],
    typer.Option(help="A beam without return is free up to its end point, or ignored; auto: see."),
]
Port = Annotated[
    Optional[int], typer.Option(min=0, max=65535, help="Of the page; else 8080. 0: any free one.")
]
Json = Annotated[Optional[Path], typer.Option("--json", help="Write all figures; - for standard output.")]
WriteConfig = Annotated[Optional[Path], typer.Option(help="Write what was decided, and why, as TOML.")]
Scans = Annotated[Optional[int], typer.Option(min=1, help="Simulate this many scans.")]
Seed = Annotated[int, typer.Option(min=0, help="Of the simulated log.")]
HeldOut = Annotated[int, typer.Option(min=0, help="Keep each N-th scan for the truth; 0: none.")]
Repeat = Annotated[int, typer.Option(min=1, help="Runs in turns, for the times.")]
