# SPDX-License-Identifier: BSD-3-Clause
"""How true maps are: on scans held out, of space that no beam has seen, and of probabilities."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndtree._native import _core
from ndtree._native._core import OccupancyMap
from ndtree.base.scan import Scan
from ndtree.evaluation.exact_truth import FOUND_WITHIN, NEAR_SURFACE
from ndtree.evaluation.sampling import beam_points
from ndtree.logs.core.log import Log
from ndtree.logs.formats.simulated import SimulatedLog

PROBABILITY_CLIP = 0.02  # As of the log score.


def held_out_truth(
    target: OccupancyMap, scans: Sequence[Scan], max_range: float, progress: Callable[[int, int], None]
) -> dict[str, Any] | None:
    if not scans:
        return None
    truth = _core.HeldOutTruth()
    for done, scan in enumerate(scans, start=1):
        truth += scan.evaluate_on(target, max_range=max_range)
        progress(done, len(scans))
    result = {key: finite_or_none(value) for key, value in truth.figures().items()}
    result["hit_log_score"] = finite_or_none(hit_log_score(target, scans, max_range))
    return result


def hit_log_score(target: OccupancyMap, scans: Sequence[Scan], max_range: float) -> float:
    """As the log score, of the probabilities of hits instead of those of occupied space.

    The log score asks how probable an end point is where as many points are end points as are free. A cell's
    rate of hits is the probability among all beams that reach it; of the points that are asked about, r are
    free for each end point. So the odds of the rate, times r, are those that the score asks for.

    Returns: [nats]; nan without points of both kinds.
    """
    kinds: tuple[list[NDArray[np.float32]], ...] = ([], [])
    for scan in scans:
        for points, rates in zip(beam_points(scan, max_range), kinds):
            if len(points):
                rates.append(np.asarray(target.probability(points, of="hit")))
    if not all(kinds):
        return math.nan
    free, ends = (np.concatenate(rates).astype(np.float64) for rates in kinds)
    ratio = len(free) / len(ends)

    def balanced(rate: NDArray[np.float64]) -> NDArray[np.float64]:
        p = np.where(np.isnan(rate), 0.5, ratio * rate / (ratio * rate + 1.0 - rate))
        return np.clip(p, PROBABILITY_CLIP, 1.0 - PROBABILITY_CLIP)

    return 0.5 * float(np.log1p(-balanced(free)).mean() + np.log(balanced(ends)).mean())


def seen_space(
    log: Log | Iterable[Scan], scans: Sequence[Scan], max_range: float, progress: Callable[[int, int], None]
) -> _core.SeenSpace:
    progress(0, len(scans))
    of = log.seen_space if isinstance(log, SimulatedLog) else _core.SeenSpace
    space = of(scans, max_range=max_range)
    progress(len(scans), len(scans))
    return space


def claims_of(target: OccupancyMap, space: _core.SeenSpace) -> dict[str, Any]:
    return {key: finite_or_none(value) for key, value in asdict(target.claims(space)).items()}


def truth_by_size(
    maps: Mapping[str, OccupancyMap], scans: Sequence[Scan], max_range: float
) -> dict[str, Any] | None:
    """Held-out truth of all maps, by the size of the first adaptive map's cells: where errors live.

    One point of each beam is drawn from the free space before its end, beside the end point itself.
    """
    ours = next((name for name, one in maps.items() if isinstance(one, _core.AdaptiveMap)), None)
    if ours is None or not scans:
        return None
    generator = np.random.default_rng(0)
    sizes: dict[float, dict[str, Any]] = {}

    def count(
        points: NDArray[np.float64],
        is_right: Callable[[OccupancyMap], NDArray[np.bool_]],
        total: str,
        right: str,
    ) -> None:
        size_here = np.nan_to_num(maps[ours].cell_size(points), nan=math.inf)  # type: ignore[attr-defined]
        answers = {name: is_right(one) for name, one in maps.items()}
        for size in np.unique(size_here):
            here = size_here == size
            row = sizes.setdefault(float(size), _no_counts(maps))
            row[total] += int(np.count_nonzero(here))
            for name, answer in answers.items():
                row[right][name] += int(np.count_nonzero(answer[here]))

    for scan in scans:
        start, way, far = scan.returned_beams(max_range)
        if not len(far):
            continue
        ends = start + far[:, None] * way
        count(ends, lambda m, p=ends: m.occupied_within(p, FOUND_WITHIN), "endpoints", "endpoints_near")
        long = far > 2 * NEAR_SURFACE
        along = generator.uniform(NEAR_SURFACE, far[long] - NEAR_SURFACE)
        free = start[long] + along[:, None] * way[long]
        if len(free):
            count(free, lambda m, p=free: np.asarray(m.state(p)) == 0, "samples", "free")
    rows = [{"size": finite_or_none(size), **sizes[size]} for size in sorted(sizes, reverse=True)]
    return {"of": ours, "sizes": rows}


def _no_counts(maps: Iterable[str]) -> dict[str, Any]:
    none = dict.fromkeys(maps, 0)
    return {"samples": 0, "free": dict(none), "endpoints": 0, "endpoints_near": dict(none)}


def finite_or_none(value: float | None) -> float | None:
    """None for what JSON has no number for."""
    return None if value is None or not math.isfinite(value) else value


BINS = 20
_STATES = {"free": 0, "occupied": 1}


def reliability_of(
    target: OccupancyMap,
    scans: Sequence[Scan],
    max_range: float,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> dict[str, Any]:
    """How often beams of scans that were held out end where the map says that they would.

    Returns: "beams", "ends_at_unknown"; "all", "free" and "occupied", by what cells are called, "by_size" and
    "by_beams", lists of those whose "size" [m] or "beams_from" is the same, each with "pairs", "ece" and
    "bins": of each twentieth of [0, 1] in which there are pairs, their number, mean "probability" and share
    of "ends".
    """
    counts = _core.Reliability()
    for done, scan in enumerate(scans, start=1):
        counts = target.reliability(
            scan.endpoints, scan.origin, returned=scan.returned, max_range=max_range, counts=counts
        )
        progress(done, len(scans))
    state, size, power = counts.state, counts.size, counts.power
    result: dict[str, Any] = {
        "beams": counts.beams,
        "ends_at_unknown": counts.ends_at_unknown,
        "all": _summary(counts, state >= 0),
    }
    result.update({name: _summary(counts, state == number) for name, number in _STATES.items()})
    result["by_size"] = [
        {"size": float(one), **_summary(counts, (state >= 0) & (size == one))}
        for one in np.unique(size)[::-1]
    ]
    result["by_beams"] = [
        {"beams_from": int(2**one - 1), **_summary(counts, (state >= 0) & (power == one))}
        for one in np.unique(power)
        if one >= 0
    ]
    return result


def _summary(counts: _core.Reliability, which: NDArray[np.bool_]) -> dict[str, Any]:
    pairs = counts.pairs[which].astype(np.float64)
    said = counts.probability[which] * pairs
    ends = counts.ends[which].astype(np.float64)
    number = np.minimum((counts.probability[which] * BINS).astype(np.int64), BINS - 1)
    sums = [np.bincount(number, weights=values, minlength=BINS) for values in (pairs, said, ends)]
    filled = np.flatnonzero(sums[0])
    bins = [
        {
            "pairs": int(sums[0][i]),
            "probability": float(sums[1][i] / sums[0][i]),
            "ends": float(sums[2][i] / sums[0][i]),
        }
        for i in filled
    ]
    return {"pairs": int(pairs.sum()), "ece": expected_calibration_error(bins), "bins": bins}


def expected_calibration_error(bins: Iterable[dict[str, Any]]) -> float | None:
    """Mean distance between the probability and the share of ends, weighted by pairs; None of none."""
    rows = list(bins)
    total = sum(row["pairs"] for row in rows)
    if not total:
        return None
    return math.fsum(row["pairs"] * abs(row["probability"] - row["ends"]) for row in rows) / total
