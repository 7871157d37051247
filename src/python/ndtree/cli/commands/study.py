# SPDX-License-Identifier: BSD-3-Clause
"""``ndtree study``: several logs with several sets of parameters."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from ndtree.base.exit_status import BAD_INPUT
from ndtree.cli.commands.app import print_error
from ndtree.cli.commands.flags import Call, command
from ndtree.cli.commands.output import check_no_input, is_stdout, write_json
from ndtree.cli.commands.progress import progress
from ndtree.study import load, run


@command(
    "study",
    usual="processes json_file quiet",
    examples=(
        "ndtree study sizes.toml",
        "ndtree study sizes.toml --processes 1 --json -",
    ),
)
def study(
    config: Annotated[Path, typer.Argument(metavar="CONFIG", help="A TOML file: logs, maps, output.")],
    call: Call,
) -> None:
    """Map several logs with several sets of options, and write tables and a picture.

    Finished jobs are kept: the same call goes on where the last one ended, and maps nothing twice.
    """
    planned = load(config)
    if call.output is not None:
        planned = replace(planned, output=call.output)
    check_no_input("-o", planned.output, planned.inputs)
    if call.json_file is not None and not is_stdout(call.json_file):
        check_no_input("--json", call.json_file, planned.inputs)
    with progress() as advance:
        table = run(planned, processes=call.processes, progress=advance)
    if not is_stdout(call.json_file):
        print(table)
        print(f"wrote {planned.output}")
    write_json(table.figures(), call.json_file)
    for row in table.failed:
        print_error(f"{row['log']}: {row['map']}: {row['error']}", has_flags=False)
    if table.failed:
        raise typer.Exit(BAD_INPUT)
