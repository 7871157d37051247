# SPDX-License-Identifier: BSD-3-Clause
"""Error rates, from scans held out."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ndtree._native import _core
from ndtree._native._core import is_held_out
from ndtree.tuning.calibration.beams import Beams, Source
from ndtree.tuning.calibration.figures import RESAMPLES, Estimate, Floats, estimated

HELD_OUT = 10
UPDATES = 25e6  # Of the maps that the error rates are from, about.
BLOCKS = 4  # Pieces of the log, most, where the whole is too much, ...
BLOCK_SCANS = 20  # ... of at least as many scans.
MARGIN_SIGMAS = 4.0
LEAST_TRIALS = 30  # Beams, below which there is no rate.
RATE_LIMITS = (0.001, 0.4)
CLEAR = 0.9  # Share of the largest and smallest log-odds from which a cell is clearly occupied or free.


@dataclass(frozen=True)
class Trial:
    """What the error rates are judged by: a map, and which beams count.

    `model`: Standard deviation of a range [m] and its growth with the squared range [1/m].
    """

    dim: int
    cell: float  # Of the map [m].
    model: tuple[float, float]
    max_range: float  # [m].
    ignores: bool  # Beams that did not return say nothing.


def error_rates(
    source: Source, lengths: list[float], trial: Trial, generator: np.random.Generator
) -> tuple[Estimate | None, Estimate | None]:
    dim, cell, model = trial.dim, trial.cell, trial.model
    blocks, share = _blocks(np.array(lengths), dim, cell)
    counts: list[tuple[int, int, int, int]] = []
    at, target, unseen = 0, None, []
    for i, beams in source.beams("error rates", trial.max_range):
        if i < blocks[at].start:
            continue
        if target is None:
            target = _core.FixedMap(
                dim=dim, min_cell_size=cell, range_sigma=model[0], range_sigma_quadratic=model[1]
            )
        use = beams.hit | (not trial.ignores)
        if share < 1:
            use &= generator.random(len(use)) < share
        beams = beams.only(use)
        if is_held_out(i, HELD_OUT):
            unseen.append(beams)
        elif len(beams.length):
            with source.naming(i):
                target.insert(beams.at(beams.length), beams.origin, returned=beams.hit)
        if i == blocks[at].stop - 1:
            counts += [_counts(target, one, cell, model) for one in unseen if len(one.length)]
            at, target, unseen = at + 1, None, []
            if at == len(blocks):
                break
    rows = np.array(counts, dtype=float).reshape(-1, 4)
    return _rate(rows[:, :2], generator), _rate(rows[:, 2:], generator)


def _blocks(lengths: Floats, dim: int, cell: float) -> tuple[list[range], float]:
    """Parts of the log to be mapped, each by itself, and the share of their beams: about `UPDATES` in all."""
    n = len(lengths)
    per_length = {2: 1.3, 3: 1.5}[dim] / cell
    affordable = int(n * min(1.0, UPDATES / max(lengths.sum() * per_length, 1.0)))
    if affordable >= n:
        return [range(n)], 1.0
    number = min(max(affordable // BLOCK_SCANS, 1), BLOCKS)
    size = min(max(affordable // number, BLOCK_SCANS), n // number)
    starts = [(2 * i + 1) * n // (2 * number) - size // 2 for i in range(number)]
    blocks = [range(max(start, 0), max(start, 0) + size) for start in starts]
    wanted = sum(lengths[block.start : block.stop].sum() for block in blocks) * per_length
    return blocks, min(1.0, UPDATES / max(wanted, 1.0))


def _counts(target: Any, beams: Beams, cell: float, model: tuple[float, float]) -> tuple[int, int, int, int]:
    """Beams that missed, and that met, something occupied; that hit, and that met, something free."""
    options = target.options
    occupied_from = 1 / (1 + math.exp(-CLEAR * options["log_odds_max"]))
    free_until = 1 / (1 + math.exp(-CLEAR * options["log_odds_min"]))
    margin = np.maximum(MARGIN_SIGMAS * (model[0] + model[1] * beams.length**2), cell)

    first = np.asarray(target.cast_rays(beams.origin, beams.direction, at="cell"))
    met = np.isfinite(first)
    met[met] = beams.length[met] > first[met] - margin[met]
    for depth in (0.1, 0.3, 0.5):
        part = beams.only(met)
        met[met] = target.probability(part.at(first[met] + depth * cell)) >= occupied_from
    part, enter, slack = beams.only(met), first[met], margin[met]
    missed = np.zeros(len(enter), dtype=bool)
    for step in range(2, 26):  # Half cells: where it comes out again.
        out = enter + 0.5 * step * cell
        open_ = ~missed & (part.length > out + slack)
        if not open_.any():
            break
        missed[open_] = target.state(part.only(open_).at(out[open_])) != 1

    # Which beams count must not depend on where they end.
    known = beams.hit & np.isfinite(first)
    hits, wall, slack = beams.only(known), first[known], margin[known]
    passed = target.probability(hits.at(0.5 * wall)) <= free_until
    tips = hits.at(hits.length)
    early = passed & (hits.length < wall - slack) & (target.probability(tips) <= free_until)
    around = np.ceil(slack / cell)
    for cells in np.unique(around[early]):
        those = np.flatnonzero(early & (around == cells))
        early[those] = ~target.occupied_within(tips[those], float(cells * cell))
    numbers = (missed, met, early, passed)
    return tuple(int(np.count_nonzero(one)) for one in numbers)  # type: ignore[return-value]


def _rate(counts: Floats, generator: np.random.Generator) -> Estimate | None:
    wrong, all_ = counts.sum(axis=0)
    if all_ < LEAST_TRIALS:
        return None
    n = len(counts)
    drawn = generator.multinomial(n, np.full(n, 1 / n), size=RESAMPLES) @ counts
    some = drawn[:, 1] > 0
    rates = np.clip(drawn[some, 0] / drawn[some, 1], *RATE_LIMITS)
    return estimated(float(np.clip(wrong / all_, *RATE_LIMITS)), rates, int(all_))
