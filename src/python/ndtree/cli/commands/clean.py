# SPDX-License-Identifier: BSD-3-Clause
"""``ndtree clean``: the points of a log without what moved."""

import time

import numpy as np

from ndtree.base.words import listed, number_of, percent
from ndtree.cli.commands.flags import Call, GivenLog, command, opened
from ndtree.cli.commands.logs import inspected, made, skipped, warn_of_skipped
from ndtree.cli.commands.messages import indented
from ndtree.cli.commands.output import check_picture, is_stdout, write_json
from ndtree.cli.commands.pictures import plotting
from ndtree.cli.commands.progress import progress
from ndtree.evaluation.cleaned import Cleaned, writer_of
from ndtree.evaluation.moved import MovedPoints, moved_scores
from ndtree.tuning.config import Config


@command(
    "clean",
    usual="mark picture max_range topic trajectory",
    examples=(
        "ndtree clean drive.npz -o clean.npz",
        "ndtree clean drive.bag -o clean.ply --picture clean.png",
        "ndtree clean clouds/ -o clean/",
        "ndtree clean clouds/ -o marked/ --mark",
    ),
)
def clean(log: GivenLog, call: Call, given: Config) -> None:
    """Write a log's points without moving things: people, cars, doors.

    A point moved if other scans surely saw its place empty, before or after.
    """
    begin = time.perf_counter()
    source = opened(given, log)
    plot = plotting() if call.picture else None
    made(lambda: given.new_map(source.dim))
    writer = made(lambda: writer_of(source, call.output, call.mark))
    if call.picture is not None:
        check_picture(plot, call.picture)
    source, config = inspected(source, given)
    writer.log = source
    writer.check()
    points = MovedPoints(source, config.options, config.max_range, config.no_return)
    cleaned = Cleaned(points, writer, keeps_points=call.picture is not None)
    with progress() as advance:
        points.look(advance)
        looked = time.perf_counter() - begin
        cleaned.write(advance)
    figures = {
        "log": source.name,
        "format": source.format,
        "scans": cleaned.scans,
        "points": cleaned.points,
        "moved": cleaned.moved,
        "unknown": cleaned.unknown,
        "poses": points.noise.figures(),
        "seconds": time.perf_counter() - begin,
        "looking_seconds": looked,
        "skipped": skipped(source),
        "written": str(call.output),
    }
    scores = None
    if cleaned.truth:
        scores = moved_scores(np.concatenate(cleaned.removed), np.concatenate(cleaned.truth))
        figures["scores"] = scores.figures()
    if plot and call.picture:
        cleaned.draw(call.picture)
    if not is_stdout(call.json_file):
        share = cleaned.moved / max(cleaned.points, 1)
        points_read = number_of(cleaned.points, "point")
        print(f"{source.name}: {number_of(cleaned.scans, 'scan')}, {points_read}")
        for line in config.notes:
            print(indented(line))
        moved = f"{number_of(cleaned.moved, 'point')} moved ({percent(share)})"
        unsure = f"; {cleaned.unknown:,} were seen too rarely to tell" if cleaned.unknown else ""
        print(f"  {moved}{unsure}")
        if points.noise.is_notable:
            print(indented(str(points.noise)))
        if scores is not None:
            print(f"  compared with the log's array 'moving': {scores}")
        print(f"in {figures['seconds']:.3f} s; wrote {listed([call.output, *filter(None, [call.picture])])}")
    write_json(figures, call.json_file)
    warn_of_skipped(source)
