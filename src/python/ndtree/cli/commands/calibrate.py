# SPDX-License-Identifier: BSD-3-Clause
"""``ndtree calibrate``: the options of the sensor, or where it sits."""

from pathlib import Path
from typing import Optional

from ndtree.base.exit_status import WrongCall
from ndtree.base.words import in_full
from ndtree.cli.commands.flags import Call, GivenLog, command, opened
from ndtree.cli.commands.logs import inspected, print_lines, warn_of_skipped
from ndtree.cli.commands.output import is_stdout, write, write_json
from ndtree.cli.commands.progress import progress
from ndtree.logs import WrongOption
from ndtree.tuning import calibration
from ndtree.tuning.config import Config


@command(
    "calibrate",
    usual="max_range no_return limit find_mount json_file",
    examples=(
        "ndtree calibrate office.npz --max-range 20 --no-return ignore",
        "ndtree calibrate room.npz --json room.json",
    ),
)
def calibrate(log: GivenLog, call: Call, given: Config) -> None:
    """Estimate the options of the sensor from a log: the noise of its ranges, and its error rates."""
    if call.find_mount:
        _find_mount(log, given, call.json_file)
        return
    source, config = inspected(opened(given, log), given, with_sigma=False)
    with progress() as advance:
        figures = calibration.calibrate(
            source, max_range=config.max_range, no_return=config.no_return, limit=call.limit, progress=advance
        )
    warn_of_skipped(source)
    if not is_stdout(call.json_file):
        print_lines(source, config)
        print(figures)
        flags = [
            f"--{name.replace('_', '-')} {in_full(value, 3)}" for name, value in figures.options().items()
        ]
        if flags:
            print(f"\nfor ndtree map and ndtree compare:\n  {' '.join(flags)}")
    write(figures.to_json, call.json_file)


def _find_mount(path: Path, given: Config, json_file: Optional[Path]) -> None:
    """Where the sensor of a bag sits, by what it and its base moved."""
    from ndtree.logs.ros.rosbag import RosbagLog
    from ndtree.tuning.calibration.mount import find_mount

    if given.selection:
        raise WrongCall("--find-mount: looks at the whole log, expected no part of it")
    try:
        log = opened(Config.of(mount="0,0,0").overridden(given.values), path)
    except WrongOption as error:
        if "mount" in given.values or "takes no such option" not in str(error):
            raise
        raise WrongCall(f"--find-mount: {path} is not a ROS bag") from None
    assert isinstance(log, RosbagLog)
    with progress() as advance:
        found = find_mount(log, progress=advance)
    if not is_stdout(json_file):
        print(f"{path}: {found}")
    write_json(found.figures(), json_file)
