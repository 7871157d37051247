# SPDX-License-Identifier: BSD-3-Clause
"""With which options the commands map a log: those that were given, and for the rest what the log says."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from ndtree.base.progress import Progress
from ndtree.base.scan import Scan
from ndtree.evaluation.no_returns import AUTO
from ndtree.logs import Log
from ndtree.logs.core.zeros import INVALID, NO_ECHO
from ndtree.tuning.first_look import FirstLook, first_look

#: What to say of a log whose map has no room.
BEYOND_MEMORY = "beams are so long that there is not enough memory, expected ranges in metres"

#: Of a log's beams, from which share on it is said what a range of 0 was taken for.
_FEW_ZEROS = 0.01


@dataclass(frozen=True)
class Settings:
    """How a log is mapped.

    Parameters
    ----------
    options : dict
        Of the map.
    max_range : float
        Infinite for no limit [m].
    no_return : {"free", "ignore"}
    chosen : tuple of str
        Flags that were not given, as one would type them.
    look : FirstLook or None
        What they are from.
    zeros : str or None
        What ranges of 0 were taken for, in one line, where there are many.
    """

    options: dict[str, Any]
    max_range: float
    no_return: str
    chosen: tuple[str, ...] = ()
    look: FirstLook | None = field(default=None, compare=False)
    zeros: str | None = field(default=None, compare=False)

    def usable(self, scan: Scan) -> Scan:
        """A scan without the beams that say nothing: with `no_return` "ignore", those without return."""
        return scan.returned_only() if self.no_return == "ignore" else scan

    def lines(self) -> list[str]:
        """What was chosen and why, for people."""
        if self.look is None:
            return []
        how = "measured on this log" if self.look.is_measured else "usual for such sensors"
        lines = [f"chosen: {' '.join(self.chosen)}"]
        if any(flag.startswith("--range-sigma ") for flag in self.chosen):
            lines[0] += f" (sigma is {how})"
        if any(flag.startswith("--no-return ") for flag in self.chosen):
            lines.append(str(self.look.no_returns))
        if self.zeros is not None:
            lines.append(self.zeros)
        if self.look.cut_off is not None:
            lines.append(
                f"readings of {self.look.cut_off:.4g} m, the log's largest range, are beams without return"
            )
        if self.look.disagreement is not None:
            lines.append(str(self.look.disagreement))
        elif self.look.drift is not None:
            lines.append(str(self.look.drift))
        return lines


def settle(
    log: Log,
    *,
    options: dict[str, Any],
    max_range: float,
    no_return: str,
    with_sigma: bool,
    progress: Progress | None = None,
) -> Settings:
    """Complete what a user said of mapping a log; the log is read for it where anything is left open.

    Parameters
    ----------
    log : Log
    options : dict
        Of the map, as they were given.
    max_range : float
        Infinite where it was not given [m].
    no_return : {"free", "ignore", "auto"}
        With "auto" the log decides.
    with_sigma : bool
        Whether the noise of the ranges, and how far beams without return are believed, are chosen, too, where
        they were not given and the log is as a robot recorded it.
    progress : callable, optional
        As for `first_look`.
    """
    if not log.has_sensor and "range_sigma" in options and "min_cell_size" not in options:
        options = {**options, "min_cell_size": 2 * options["range_sigma"]}
        log.notes.append(
            f"cells of {options['min_cell_size']:g} m, twice the noise; --min-cell-size says another"
        )
    choose_sigma = with_sigma and log.is_raw
    choose_sigma &= not {"range_sigma", "range_sigma_quadratic"} & options.keys()
    choose_no_return = no_return == AUTO and log.knows_no_returns
    if not (choose_sigma or choose_no_return):
        return Settings(options, max_range, "free" if no_return == AUTO else no_return)
    decides = choose_no_return and log.may_be_zero and log.zero_is is None
    if decides:
        log.zero_is = NO_ECHO
    look = first_look(log, progress=progress)
    zeros = min(1.0, log.zeros / look.beams) if look.beams else 0.0
    if decides and (look.no_returns.choice == "ignore" or not zeros):
        log.zero_is = INVALID
    flags = [f"--dim {look.dim}"]
    if choose_sigma:
        options = {**options, **look.options}
        flags += [f"--{name.replace('_', '-')} {value:g}" for name, value in look.options.items()]
    if choose_no_return:
        no_return = look.no_returns.choice
        flags.append(f"--no-return {no_return}")
        if with_sigma and log.is_raw and math.isinf(max_range) and math.isfinite(look.max_range):
            max_range = look.max_range
            flags.append(f"--max-range {max_range:g}")
    elif no_return == AUTO:
        no_return = "free"
    said = None
    if zeros >= _FEW_ZEROS:
        means = "no echo" if log.zero_is == NO_ECHO else "nothing"
        other = "invalid" if log.zero_is == NO_ECHO else "no-echo"
        said = f"range 0, of {100 * zeros:.0f} % of the beams, says {means}; else --zero-is {other}"
    return Settings(options, max_range, no_return, tuple(flags), look, said)
