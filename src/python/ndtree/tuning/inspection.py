# SPDX-License-Identifier: BSD-3-Clause
"""With which options a log is mapped: by what was given, and for the rest by what the log says."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, replace
from typing import Any

from ndtree._errors import Text, key
from ndtree._native._checked import checked
from ndtree.base.progress import Progress
from ndtree.base.words import percent
from ndtree.evaluation.sampling import AUTO
from ndtree.logs import Log
from ndtree.logs.core.rules import INVALID, MEASURED, NO_ECHO, UNSEARCHED, USUAL, Decision
from ndtree.tuning.config import Config
from ndtree.tuning.first_look import FirstLook, Scale, first_look

#: What to say of a log whose map has no room.
BEYOND_MEMORY = "beams are so long that there is not enough memory, expected ranges in metres"

#: Of a log's beams, from which share on it is said what a range of 0 was taken for.
_FEW_ZEROS = 0.01
#: Of the largest range: what is so near to it is called equal.
_NOISY = 1e-3


@checked
def inspect(
    source: Log | str | os.PathLike[str],
    given: Config | None = None,
    *,
    with_sigma: bool = True,
    progress: Progress | None = None,
    **more: Any,
) -> Config:
    """Decide how a log is read and mapped, where that was not given; it is read once.

    Parameters
    ----------
    source : Log or path
        What is opened here is opened again to be read.
    given : Config, optional
        What is decided already; with all of it, nothing is read.
    with_sigma : bool
        Whether the noise of the ranges, where the log does not tell it, and how far beams without return are
        believed, are chosen, too, where they were not given.
    progress : callable, optional
        As for `first_look`.
    **more
        Other values, as of `Config.of`.

    Returns
    -------
    Config
        For `Config.read`, the maps' constructors and `Scan.insert_into`.
    """
    given = (given or Config()).overridden(Config.of(**more).values)
    log = given.ruled(source) if isinstance(source, Log) else given.read(source)
    values = {**log.decisions, **given.values}
    values.setdefault("dim", Decision(log.dim, MEASURED, f"the log is {log.dim}-D"))
    options = given.options
    notes: list[str] = []
    if not log.has_sensor and "range_sigma" in options and "min_cell_size" not in options:
        size = 2 * options["range_sigma"]
        values["min_cell_size"] = Decision(size, MEASURED, "twice the noise")
        notes.append(f"cells of {size:g} m, twice the noise; {key('min_cell_size')} sets another")
    choose_sigma = with_sigma and log.has_sensor and "range_sigma" not in options
    may_end = log.has_sensor and log.rules.cut_off is UNSEARCHED
    choose_no_return = given.no_return == AUTO and (log.knows_no_returns or may_end)
    if given.no_return == AUTO:
        values["no_return"] = Decision("free", USUAL, "the log has no such beams, or tells what they mean")
    if not (choose_sigma or choose_no_return):
        return Config(values, None, tuple(map(Text, notes)))
    decides = choose_no_return and log.may_be_zero and log.rules.zero_is is None
    may_be_cut_off = log.may_be_cut_off and log.rules.cut_off is UNSEARCHED
    looked_at = log.ruled(zero_is=NO_ECHO) if decides else log
    look = first_look(looked_at, with_sigma=choose_sigma, progress=progress)
    choose_no_return = choose_no_return and (log.knows_no_returns or look.limit is not None)
    zeros = min(1.0, look.zeros / look.beams) if look.beams else 0.0
    if decides:
        says_nothing = look.no_returns.choice == "ignore" or not zeros
        word = "invalid" if says_nothing else "no echo"
        why = f"{percent(zeros)} of the ranges are 0, taken as {word}" if zeros else "no range is 0"
        values["zero_is"] = Decision(INVALID if says_nothing else NO_ECHO, MEASURED, why)
    if look.limit is not None or may_be_cut_off:
        limit = [] if look.limit is None else [look.limit.at, look.limit.tolerance]
        why = "where many ranges of a scan end, and how exactly [m]" if limit else "no range ends many beams"
        values["cut_off"] = Decision(limit, MEASURED, why)
    choose_sigma = choose_sigma and not look.has_own_noise
    if choose_sigma:
        how = (MEASURED, "on flat surfaces") if look.is_measured else (USUAL, "for such sensors")
        for name, value in look.options.items():
            values.setdefault(name, Decision(value, *how))
    if choose_no_return:
        values["no_return"] = Decision(look.no_returns.choice, MEASURED, str(look.no_returns))
        if with_sigma and math.isinf(given.max_range) and math.isfinite(look.max_range):
            why = "how far beams without return are believed [m]"
            values["believed_range"] = Decision(look.max_range, MEASURED, why)
    config = Config(values, look)
    means = values["zero_is"].value if "zero_is" in values else log.rules.zero_is
    return replace(
        config, notes=(*map(Text, notes), *_said(config, look, choose_sigma, choose_no_return, zeros, means))
    )


def _said(
    config: Config, look: FirstLook, sigma: bool, no_return: bool, zeros: float, means: str | None
) -> list[str]:
    """What was chosen and why, for people."""
    how = "measured on this log" if look.is_measured else "usual for such sensors"
    chosen = f"chosen: {' '.join(config.chosen)}" + (f" (sigma is {how})" if sigma else "")
    lines = [chosen] if sigma or no_return else []
    lines += [str(look.no_returns)] if no_return else []
    if zeros >= _FEW_ZEROS:
        word, other = ("no echo", INVALID) if means == NO_ECHO else ("invalid", NO_ECHO)
        lines.append(
            f"{100 * zeros:.0f} % of the ranges are 0, taken as {word}; "
            f"if that is wrong: {key('zero_is')} {other}"
        )
    if look.cut_off is not None:
        noise = 0.0 if look.limit is None else look.limit.tolerance
        least = f"{look.cut_off - noise:.4g} to " if noise > _NOISY * look.cut_off else ""
        lines.append(
            f"readings of {least}{look.cut_off:.4g} m, the log's largest range, are beams without return"
        )
    lines += [look.unsure_end] if look.unsure_end else []
    return list(map(Text, lines if look.doubt is None else [*lines, look.doubt]))


@dataclass(frozen=True)
class Prospect:
    """What was decided of a log, when its scans and poses were [s], and what mapping costs [s, bytes]."""

    config: Config
    spans: dict[str, tuple[float, float]]
    cost: tuple[float, float] | None

    def figures(self) -> dict[str, Any]:
        """All of it as plain numbers, ready for JSON."""
        look = self.config.look
        return {
            "chosen": None if look is None else look.figures(),
            "flags": self.config.chosen,
            "spans": {name: list(span) for name, span in self.spans.items()},
            "cost": None if self.cost is None else dict(zip(("seconds", "memory_bytes"), self.cost)),
        }

    def lines(self) -> list[str]:
        """For people."""
        lines = []
        scans, poses = self.spans.get("scans"), self.spans.get("poses")
        if scans is not None and poses is not None:
            begin, end = (one - other for one, other in zip(scans, poses))
            times = "{} from {:.3f} to {:.3f} s".format
            away = f" (scans begin {_away(begin)} and end {_away(end)})"
            is_apart = max(abs(begin), abs(end)) >= 0.005  # As it is written.
            lines.append(f"{times('scans', *scans)}, {times('poses', *poses)}{away if is_apart else ''}")
        lines += self.config.notes
        if self.cost is not None:
            seconds, memory = self.cost
            lines.append(f"mapping will take about {_rounded(seconds)} s and {_rounded(memory / 2**20)} MiB")
        return lines


def prospect_of(log: Log, given: Config | None = None, *, progress: Progress | None = None) -> Prospect:
    """What `inspect` decides of a log, what that will cost, and whether its poses drift."""
    config = inspect(log, given, progress=progress)
    look = config.look
    if look is None and log.has_sensor:  # Nothing had to be decided.
        look = first_look(log, progress=progress)
        more = [Text(one) for one in (look.unsure_end, look.doubt) if one]
        config = replace(config, notes=(*config.notes, *more))
    if look is not None:
        size = config.new_map(log.dim).options["min_cell_size"]
        absurd = Scale.of(look.sample, size, config.get("max_range", math.inf)).warning()
        config = replace(config, notes=(*config.notes, *([absurd] if absurd else [])))
    try:
        cost = None if look is None else look.cost()
    except MemoryError:
        raise ValueError(f"{log.name}: {BEYOND_MEMORY}") from None
    return Prospect(config, log.spans, cost)


def _away(seconds: float) -> str:
    return f"{abs(seconds):.2f} s {'earlier' if seconds < 0 else 'later'}"


def _rounded(value: float) -> str:
    return f"{value:.1g}" if value < 1 else f"{value:.2g}" if value < 100 else f"{value:.0f}"
