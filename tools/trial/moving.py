# SPDX-License-Identifier: BSD-3-Clause
"""Judges of what moved: points that a map, or the scans themselves, say do not stand."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

import ndtree
from trial import faults, maps
from trial.command import Done, run
from trial.maps import Truth, count_near, judge_lost, judge_map, mapped
from trial.outcome import Case, Outcome, limit
from trial.robots import Recording


def recorded(case: Case) -> tuple[Recording, float, int | None]:
    r, cell, last = maps.recorded(case, (40, 70), (12, 20), "drives")
    if case.fault == "pitch":
        r = faults.pitch(r, case.rng)
    return r, cell, last


def _judge_moved(probability: np.ndarray, r: Recording, truth: Truth, outcome: Outcome) -> None:
    """`probability` has an entry for each beam of each scan.

    A point whose probability is about one half is not said to stand: it is kept, and doubted.
    """
    hit = np.isfinite(r.ranges)
    removed, stands = hit & (probability > 0.5), probability < 0.5 - limit("no claim")
    ends = truth.origins[:, None] + truth.directions * np.where(hit, r.exact, 0.0)[..., None]
    standing = hit & ~r.moving
    if standing.sum() >= 200:
        outcome.expect("standing removed", 100 * removed[standing].mean())
        outcome.drawn["standing removed"] = ends[standing & removed]
        undecided = 100 * (~removed & ~stands)[standing].mean()
        outcome.figures["standing undecided"] = round(float(undecided), 2)
        if undecided > limit("standing undecided") and not outcome.faults:
            outcome.words.append(f"does not tell of {undecided:.0f} % of what stands")
    scan, beam = np.nonzero(r.moving)
    if len(scan) < 20:
        return
    points = ends[scan, beam]
    chosen = truth.rng.choice(len(points), min(300, len(points)), replace=False)
    clear = truth.is_clear(points[chosen])
    centers = truth.centers(points[chosen])
    passed = np.zeros(len(chosen), int)
    for later in range(len(r)):
        passed += truth.passing(centers, [later]) * (later > scan[chosen])
    # Of a thing that stood, as many scans must pass as found it there, or a dozen.
    found = count_near(points[chosen], points, truth.cell) / np.maximum(
        _once(points, scan, chosen, truth.cell), 1
    )
    counted = chosen[clear & (passed >= np.minimum(found + 1, 12))]
    if len(counted) >= 20:
        kept, said = ~removed[scan[counted], beam[counted]], stands[scan[counted], beam[counted]]
        if not outcome.faults and 100 * said.mean() <= limit("moved kept") < 100 * kept.mean():
            outcome.words.append(f"does not tell of {100 * (kept & ~said).mean():.0f} % of what moved")
        if 100 * said.mean() > limit("moved kept"):
            outcome.words.clear()
        outcome.expect("moved kept", 100 * kept.mean())
        outcome.drawn["moved kept"] = points[counted][kept]


def _once(points: np.ndarray, scan: np.ndarray, chosen: np.ndarray, cell: float) -> np.ndarray:
    """How many points a scan has around each of the chosen."""
    result = np.zeros(len(chosen), int)
    for one in np.unique(scan[chosen]):
        own = scan[chosen] == one
        result[own] = count_near(points[chosen][own], points[scan == one], cell)
    return result


def moved_trial(case: Case) -> tuple[Recording, Outcome]:
    """What a map says of the points that it was made of."""
    r, cell, _ = recorded(case)
    outcome, truth = Outcome(), Truth(case.world, r, cell, case.rng)
    m = mapped(r, cell, is_fixed=case.is_fixed)
    probability = np.array([np.asarray(m.moved(r.beams(i)[0])) for i in range(len(r))])
    _judge_moved(probability, r, truth, outcome)
    outcome.drawn["map"] = m
    return r, outcome


def _made(case: Case, r: Recording, cell: float, call: str, target: Path, outcome: Outcome) -> Done:
    """What ``ndtree`` makes of a recording; doubts and refusals go to `outcome`."""
    command, how = call.split()
    sizes = ["--range-sigma", f"{max(r.sensor.sigma, 0.01):g}", "--min-cell-size", f"{cell:g}"]
    log, figures = r.save(target.with_name("log.npz")), target.with_name("f.json")
    done = run(command, log, "-o", target, how, *sizes, "--json", figures)
    outcome.words, outcome.may_doubt = done.doubts, case.fault == "pitch"
    outcome.refused = done.error if done.status else ""
    return done


def clean_trial(case: Case) -> tuple[Recording, Outcome]:
    """What ``ndtree clean`` leaves out."""
    r, cell, _ = recorded(case)
    outcome, truth = Outcome(), Truth(case.world, r, cell, case.rng)
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "marked.npz"
        if _made(case, r, cell, "clean --mark", target, outcome).status:
            return r, outcome
        with np.load(target) as marked:
            probability = marked["moved"].reshape(r.ranges.shape)
    _judge_moved(probability, r, truth, outcome)
    return r, outcome


def static_trial(case: Case) -> tuple[Recording, Outcome]:
    """The map of ``ndtree map --static``: what stands is there, what moved is not."""
    world, fault, rng = case.world, case.fault, case.rng
    r, cell, last = recorded(case)
    outcome, truth = Outcome(), Truth(world, r, cell, rng)
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "map.ndt"
        done = _made(case, r, cell, "map --static", target, outcome)
        if done.status:
            return r, outcome
        m = ndtree.load(target)
    met = count_near(truth.ends, truth.ends, 0.5 * cell) >= 5
    ends = truth.ends[met]
    if len(ends) >= 100 and fault != "pitch":
        ends = ends[rng.choice(len(ends), min(2000, len(ends)), replace=False)]
        judge_lost(m, truth, outcome, ends)
    if fault != "pitch":
        judge_map(m, truth, outcome, last)
    outcome.excuse(done.unknown)
    outcome.drawn["map"] = m
    return r, outcome
