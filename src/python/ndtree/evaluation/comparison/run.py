# SPDX-License-Identifier: BSD-3-Clause
"""Maps of one log, built and judged alike."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from ndtree._errors import WrongValue, key
from ndtree._native import _core
from ndtree._native._checked import checked
from ndtree._native._core import OccupancyMap, is_held_out
from ndtree.base.progress import Progress, no_progress
from ndtree.base.scan import Scan
from ndtree.evaluation.certificate import certify as make_certificate
from ndtree.evaluation.comparison.building import OUTCOMES, Built, Maps, build_once, figures_of, makers_of
from ndtree.evaluation.comparison.table import Comparison
from ndtree.evaluation.comparison.truth import (
    claims_of,
    finite_or_none,
    held_out_truth,
    reliability_of,
    seen_space,
    truth_by_size,
)
from ndtree.evaluation.exact_truth import ExactTruth
from ndtree.evaluation.sampling import AUTO, believed
from ndtree.logs.core.log import Log, require_log
from ndtree.logs.formats.simulated import SimulatedLog

DEFAULT_MAPS = ("adaptive", "fixed", "octomap") if _core.has_octomap else ("adaptive", "fixed")
NO_RETURN = ("free", "ignore", AUTO)
NEEDED = ("cells", "nodes", "updates", "memory_bytes", "resident_bytes")


@checked
def compare(
    log: Log | Iterable[Scan],
    maps: Maps | None = None,
    *,
    progress: Progress | None = None,
    calibration: bool = False,
    certify: bool = False,
    held_out: int = 10,
    max_range: float = math.inf,
    no_return: str = AUTO,
    repeat: int = 1,
    **options: Any,
) -> Comparison:
    """Map a log in several ways, and say what each map costs and how true it is.

    Parameters
    ----------
    log : Log or iterable of Scan
        Read once, and kept in memory.
    maps : sequence of str, or mapping of str to callable, optional
        Names are "adaptive", "paper" (refined exactly as the paper has it), "fixed", "octomap" and
        "octomap-scan" (updated once a scan), with @ and a cell size [m] where it is not the common one, as
        in "fixed@0.1". A mapping has own names with functions that make the maps. Left out: adaptive, fixed
        and, where there is one, OctoMap.
    progress : callable, optional
        Called as ``progress(what, done, total)`` with numbers of scans.
    calibration : bool
        Whether to say how often beams that were held out end where each map says: "calibration", of pairs of
        a beam and a cell that it reaches, has the expected calibration error "ece" and the "bins" of a
        reliability diagram for "all" cells, those called "free" and "occupied", and "by_size" and "by_beams".
    certify : bool
        Whether to bound the share of what each map calls free that is occupied: "certificate", see
        `OccupancyMap.certify`.
    held_out, max_range, no_return, repeat
        As of `Turns`: each held_out-th scan is not mapped, and tells how true the maps are, 0 maps all;
        longer beams are cut [m]; "auto", "free" or "ignore"; how often each map is made, for the times.
    **options
        As in `AdaptiveMap`; each map gets those that it knows.

    Returns
    -------
    Comparison
        A dict. "cells" are leaves that at least one beam updated, "updates" pairs of a beam and a leaf,
        "seconds" the insertion alone. "truth" is about the scans held out: of "samples", points every 0.1 m
        along the beams up to 0.1 m before their end, how many the map calls free, occupied and unknown; how
        many end points are within 0.05 m of an occupied cell; how many ray casts end within 0.1 m of the
        measured range, and their median error [m], and the same of casts at="surface"; "balanced_accuracy",
        the mean of the shares of free space and end points that are right; and "log_score", the mean
        log-likelihood [nats] of both under the map's probabilities, clipped to [0.02, 0.98]; "hit_log_score"
        is that of the probabilities of hits, as odds times the number of samples of free space for each end
        point. "claims" is about space that no beam has seen, and the scans that were mapped: of "points"
        drawn uniformly around the log's end points, how many were "seen" by some beam's share of its scan's
        view (`SeenSpace`; on simulated logs by the exact line of sight), and what the map says of them.
        "free_unseen" is the share of the space called free that was not seen, "seen_unknown" the share of the
        space seen that is called unknown, and "wrong_volume" both volumes over the volume seen. "exact", on
        simulated logs, compares with the world itself. "ratios" say what the adaptive map needs of the fixed
        one.

    Raises
    ------
    ValueError
        If an option is out of its limits, or the log is damaged or empty.
    """
    turns = Turns(held_out, max_range, no_return, repeat)
    trial = map_in_turns(log, maps, turns, progress=progress, **options)
    return trial.judged(progress, calibration=calibration, certify=certify)


@dataclass(frozen=True)
class Turns:
    """How maps are made in turns.

    Attributes
    ----------
    held_out : int
        Each held_out-th scan is not mapped, and tells how true the maps are; 0 maps all.
    max_range : float
        Longer beams are free up to there and have no end point [m].
    no_return : str
        What a beam without return says: "free", that space is free up to its end point; "ignore", nothing;
        "auto": what `ndtree.evaluation.sampling.judge` finds.
    repeat : int
        How often each map is made, in turns, for the times. Updates and cells do not depend on it.
    """

    held_out: int = 10
    max_range: float = math.inf
    no_return: str = AUTO
    repeat: int = 1


def map_in_turns(
    log: Log | Iterable[Scan],
    maps: Maps | None,
    turns: Turns,
    *,
    progress: Progress | None = None,
    **options: Any,
) -> Trial:
    """The first half of `compare`: makes the maps, quicker than judging them."""
    held_out, no_return = turns.held_out, turns.no_return
    for name, value, least in (("held_out", held_out, 0), ("repeat", turns.repeat, 1)):
        if value < least:
            raise WrongValue.of(name, value, f">= {least}")
    if held_out == 1:
        raise WrongValue.of("held_out", 1, "0 or at least 2, or nothing is left to map")
    if no_return not in NO_RETURN:
        raise WrongValue.of("no_return", f"{no_return!r}", f"one of {', '.join(NO_RETURN)}")
    if maps is None:
        maps = DEFAULT_MAPS
    require_log(log)
    progress = progress or no_progress
    scans = _loaded(log, progress)
    if no_return == AUTO:
        no_return = believed(log, scans)
    if no_return == "ignore":
        scans = [scan.returned_only() for scan in scans]
    dim = scans[0].dim
    makers = makers_of(maps, dim, options)
    mapped = {i: scan for i, scan in enumerate(scans) if not is_held_out(i, held_out)}
    if not mapped:
        raise WrongValue(f"{key('held_out')}: no scan is left to map")
    unseen = [scan for i, scan in enumerate(scans) if is_held_out(i, held_out)]

    built = {name: Built() for name in makers}
    for run in range(turns.repeat):
        for name, make in makers.items():
            label = name if turns.repeat == 1 else f"{name}, run {run + 1}"
            build_once(built[name], make, mapped, turns.max_range, partial(progress, label))
    return Trial(log, scans, mapped, unseen, built, replace(turns, no_return=no_return))


@dataclass(frozen=True)
class Trial:
    """Maps of one log, which have not been judged yet."""

    log: Log | Iterable[Scan]
    scans: list[Scan]  # All of them, without the beams that say nothing.
    mapped: dict[int, Scan]  # Those that were mapped, by their numbers.
    unseen: list[Scan]  # Those that were held out.
    built: dict[str, Built]  # The maps, by name.
    turns: Turns  # In which "auto" is decided.

    @property
    def map_objects(self) -> dict[str, OccupancyMap]:
        """The maps, by name."""
        return {name: one.map for name, one in self.built.items()}

    def judged(
        self, progress: Progress | None = None, *, calibration: bool = False, certify: bool = False
    ) -> Comparison:
        """What each map costs and how true it is; `calibration` and `certify` as of `compare`."""
        progress = progress or no_progress
        log, max_range, built = self.log, self.turns.max_range, self.built
        space = seen_space(
            log, list(self.mapped.values()), max_range, partial(progress, "what the scans saw")
        )
        rows = []
        for name, one in built.items():
            row = figures_of(name, one)
            row["truth"] = held_out_truth(
                one.map, self.unseen, max_range, partial(progress, f"{name}, truth")
            )
            row["claims"] = claims_of(one.map, space)
            if calibration:
                row["calibration"] = reliability_of(
                    one.map, self.unseen, max_range, partial(progress, f"{name}, calibration")
                )
            if certify:
                row["certificate"] = asdict(make_certificate(one.map, self.unseen, max_range=max_range))
                row["certificate"]["worst"] = finite_or_none(row["certificate"]["worst"])
            rows.append(row)
        if isinstance(log, SimulatedLog):
            exact = ExactTruth(log, self.scans, max_range)
            for row in rows:
                row["exact"] = exact.of(built[row["map"]].map)

        first = next(iter(built.values()))
        map_objects = self.map_objects
        result = Comparison(
            log=getattr(log, "name", "scans"),
            dim=self.scans[0].dim,
            branching=first.map.branching,
            scans=len(self.scans),
            scans_mapped=len(self.mapped),
            beams={outcome: first.beams[outcome] for outcome in OUTCOMES},
            parameters={
                **_plain(first.map.options),
                **asdict(self.turns),
                "max_range": finite_or_none(max_range),
                "maps": {name: _plain(one.map.options) for name, one in built.items()},
            },
            maps=rows,
            truth_by_cell_size=truth_by_size(map_objects, self.unseen, max_range),
            ratios=_ratios(rows),
        )
        result.map_objects = map_objects
        return result


def _loaded(log: Log | Iterable[Scan], progress: Progress) -> list[Scan]:
    total = len(log) if hasattr(log, "__len__") else 0
    scans: list[Scan] = []
    for scan in log:
        scans.append(scan)
        if scan.dim != scans[0].dim:
            raise ValueError(f"scan {len(scans) - 1} is {scan.dim}-D: must be {scans[0].dim}-D as the first")
        progress("reading", len(scans), total)
    if not scans:
        raise ValueError(f"{getattr(log, 'path', None) or 'log'}: no scans, expected at least one")
    return scans


def _ratios(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """What the adaptive map, or else the first, needs of the fixed one, and of others under their names."""
    ours = next((row for row in rows if row["map"] == "adaptive"), rows[0])
    result: dict[str, Any] = {}
    for row in rows:
        if row is ours:
            continue
        pairs = {key: (ours[key], row[key]) for key in NEEDED}
        pairs["seconds"] = (ours["seconds"]["median"], row["seconds"]["median"])
        if "cells_pruned" in row:
            pairs["cells_pruned"] = (ours["cells"], row["cells_pruned"])
        of_map = {key: one / other if one and other else None for key, (one, other) in pairs.items()}
        result.update(of_map if row["map"] == "fixed" else {row["map"]: of_map})
    return result


def _plain(options: Mapping[str, Any]) -> dict[str, Any]:
    return {
        key: finite_or_none(float(value)) if isinstance(value, (float, np.floating)) else value
        for key, value in options.items()
    }
