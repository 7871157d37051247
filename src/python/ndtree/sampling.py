# SPDX-License-Identifier: BSD-3-Clause
"""A few scans from all over a log, in one pass and without knowing how many there are."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from ndtree.scan import Scan

#: Scans in a row, so that some of them see the same, and so many of these runs at least.
RUN, RUNS = 4, 40
#: Beams kept of a scan.
MOST_BEAMS = 4000


def spread(
    scans: Iterable[Scan], progress: Callable[[int], None] | None = None
) -> tuple[list[list[Scan]], int, int]:
    """Runs of scans, evenly over a log.

    Of each run the scans follow each other. Where there are twice as many runs as wanted, every second is
    dropped, and from then on half as many are taken: the result depends on nothing but the log.

    Returns
    -------
    runs : list of list of Scan
        40 to 80 runs of four scans; fewer only of a short log. Of long scans every second, third, ... beam.
    scans, beams : int
        How many the log has.
    """
    runs: list[list[Scan]] = []
    step = 1  # Of the runs that the log could be cut into, every so manieth is kept.
    number = beams = 0
    for scan in scans:
        beams += len(scan)
        run, place = divmod(number, RUN)
        number += 1
        if progress is not None:
            progress(number)
        if run % step:
            continue
        if place == 0:
            if len(runs) == 2 * RUNS:
                runs, step = runs[::2], 2 * step
                if run % step:
                    continue
            runs.append([])
        stride = -(-len(scan) // MOST_BEAMS)
        if len(runs) * step > run:  # Else the run began before it was dropped.
            runs[-1].append(scan.only(slice(None, None, stride)) if stride > 1 else scan)
    return runs, number, beams
