# SPDX-License-Identifier: BSD-3-Clause
"""Whether the poses of a planar laser fit what it saw from one scan to the next.

Strategy: of each run of consecutive scans, the last is matched with the first, as visits of a place are in
`ndtree.tuning.revisits`, along directions that the surroundings tell. What it has to be moved is the
error of the poses over the run. Good poses err by centimetres and now and then; where wheels slip or poses
jump, the errors are large run after run, and from some run on much larger than before.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ndtree._errors import Text, key
from ndtree.tuning.pairs import Pairs

Floats = NDArray[np.float64]

#: An error [m] below which a run agrees, whatever the way, and the share of the way from which it does not:
#: wheels spin. SPIN_RUNS of SPIN_AMONG runs in a row must not agree, or it is by chance.
SPIN_ERROR, SPIN_SHARE, SPIN_RUNS, SPIN_AMONG = 0.03, 0.4, 3, 4
#: Thresholds for wheels that slip a little, or poses that jump about.
SLIP_ERROR, SLIP_SHARE, SLIP_RUNS, SLIP_AMONG = 0.1, 0.04, 5, 6
#: From some run on to the end errors are above WORSE_ERROR [m], and TIMES_WORSE times those before, with
#: WORSE_RUNS runs on either side; WORSE_SHARE of them are above half of that.
WORSE_ERROR, TIMES_WORSE, WORSE_RUNS, WORSE_SHARE = 0.04, 4.0, 8, 0.75


@dataclass(frozen=True)
class Disagreement:
    """From when on poses do not fit the scans, from `disagreement`.

    `since`: Time of the first run that disagrees, from the log's first scan on [s]; nan where scans have no
        times.
    """

    since: float
    error: float  # Median of what scans of a run have to be moved [m], over the runs that disagree.
    moved: float  # Median way of the robot over these runs by its poses [m].

    def __str__(self) -> str:
        """What was found and what helps, in one line."""
        when = f"from {self.since:.1f} s on" if math.isfinite(self.since) else "from some scan on"
        return Text(
            f"{when}, consecutive scans disagree by {self.error:.2f} m while the poses move "
            f"{self.moved:.2f} m: wheels slip or poses drift; use {key('align')} or the poses of a SLAM "
            f"system, or stop before it with {key('stop')}"
        )


def disagreement(matched: Pairs) -> Disagreement | None:
    """Find from when on the poses of a 2-D log do not fit its scans.

    Returns: None where they fit, or nothing can be told.
    """
    runs = matched.runs
    found = [
        (runs[pair.run][0].stamp, pair.shift, float(np.hypot(*pair.told[:2])))
        for pair in matched.near
        if pair.is_whole_run and pair.shift is not None
    ]
    if not found:
        return None
    errors, moved = np.array(found)[:, 1:].T
    spins = errors > np.maximum(SPIN_ERROR, SPIN_SHARE * moved)
    slips = errors > np.maximum(SLIP_ERROR, SLIP_SHARE * moved)
    begins = [
        _first(spins, SPIN_RUNS, SPIN_AMONG), _first(slips, SLIP_RUNS, SLIP_AMONG), _worse_from(errors)
    ]  # fmt: skip
    known = [begin for begin in begins if begin is not None]
    if not known:
        return None
    begin = min(known)
    wrong = (spins | slips)[begin:]
    if not wrong.any() or begin == begins[2]:
        wrong[:] = True
    has_times = found[-1][0] != found[0][0]
    since = found[begin][0] - matched.begin if has_times else math.nan
    return Disagreement(
        since, float(np.median(errors[begin:][wrong])), float(np.median(moved[begin:][wrong]))
    )


def _first(wrong: NDArray[np.bool_], least: int, among: int) -> int | None:
    """The first from which at least that many are wrong."""
    for i in np.flatnonzero(wrong):
        if np.count_nonzero(wrong[i : i + among]) >= least:
            return int(i)
    return None


def _worse_from(errors: Floats) -> int | None:
    """From where on errors are much larger than before, up to the end."""
    best: tuple[int, int] | None = None
    for i in range(WORSE_RUNS, len(errors) - WORSE_RUNS + 1):
        limit = max(WORSE_ERROR, TIMES_WORSE * float(np.median(errors[:i])))
        large = errors > limit / 2
        if large[i] and np.median(errors[i:]) > limit and np.mean(large[i:]) >= WORSE_SHARE:
            on_wrong_side = int(np.count_nonzero(large[:i]) + np.count_nonzero(~large[i:]))
            best = min(best or (on_wrong_side, i), (on_wrong_side, i))
    return None if best is None else best[1]
