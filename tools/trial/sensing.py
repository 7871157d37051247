# SPDX-License-Identifier: BSD-3-Clause
"""Judges of what is found out about a sensor: its noise, and what beams without echo say."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

import ndtree
from trial import bag
from trial.maps import Truth, count_in, judge_lost, judge_map, mover_of
from trial.outcome import Case, Outcome, limit
from trial.robots import Recording, poses_along, record, sensor_of, small_sensor_of
from trial.scene import Floats


def noise_trial(case: Case) -> tuple[Recording, Outcome]:
    """The standard deviation of ranges that a first look measures."""
    rng, outcome = case.rng, Outcome()
    sensor = sensor_of(rng, case.dim)
    scans = int(rng.integers(60, 100)) if case.dim == 2 else 16
    mover, _ = mover_of(case, scans)
    r = record(case.world.scene, sensor, poses_along(case.world, rng, scans, "drives"), rng, mover)
    with tempfile.TemporaryDirectory() as folder:
        try:
            look = ndtree.first_look(ndtree.read(r.save(Path(folder) / "log.npz")))
        except ValueError as error:
            outcome.refused = str(error)
            return r, outcome
    far = np.median(r.exact[np.isfinite(r.exact)]) if np.isfinite(r.exact).any() else 1.0
    told = look.range_sigma + look.range_sigma_quadratic * far**2
    outcome.figures.update(told=round(float(told), 4), true=sensor.sigma)
    if not look.is_measured:
        outcome.words, outcome.may_doubt = ["sigma is usual for such sensors"], True
    elif abs(told - sensor.sigma) > 0.005:
        outcome.expect("noise", max(told / max(sensor.sigma, 0.005), sensor.sigma / told))
    return r, outcome


def readings_of(r: Recording, fault: str, rng: np.random.Generator) -> Floats:
    """Ranges as a sensor says them, with one way to say that there is no echo.

    Those of a depth camera end with a depth: what lies deeper has no echo in `r` from then on.
    """
    far, depths = r.sensor.max_range, 1.0
    if r.sensor.name == "depth":
        depths = r.sensor.directions[:, 0]
        far *= depths.min()
        r.ranges[r.exact * depths > far] = np.inf
        r.exact[~np.isfinite(r.ranges)] = np.inf
    none = ~np.isfinite(r.ranges)
    readings = r.ranges.copy()
    if fault in ("largest", "dark_largest"):
        readings[none] = far
    elif fault == "largest_noisy":
        readings[none] = far + np.minimum(rng.normal(0, 0.02, none.sum()), 0.0)
    elif fault == "beyond":
        readings[none] = far + 1.0
    elif fault in _SAYS:
        readings[none] = _SAYS[fault]
    return np.where(none, readings / depths, readings)


_SAYS = {"zero": 0.0, "nan": np.nan, "left_out": bag.LEFT_OUT}


def no_return_trial(case: Case) -> tuple[Recording, Outcome]:
    """The map of a bag whose sensor says "no echo" in one of many ways, or of dark walls, too."""
    rng, outcome, d = case.rng, Outcome(), case.dim
    sensor, cell = small_sensor_of(rng, d), 0.05 if d == 2 else 0.1
    r = record(case.world.scene, sensor, poses_along(case.world, rng, 60 if d == 2 else 24, "drives"), rng)
    if case.fault.startswith("dark"):  # Of half of the walls, by place, most beams do not return.
        length = np.where(np.isfinite(r.exact), r.exact, 0.0)[..., None]
        ends = (
            r.true[:, None, :d, 3] + np.einsum("sij,bj->sbi", r.true[:, :d, :d], sensor.directions) * length
        )
        is_dark = np.sin(2 * ends[..., 0] + rng.uniform(0, 6)) > 0.2
        r.ranges[is_dark & (rng.random(r.ranges.shape) < rng.uniform(0.5, 0.9))] = np.inf
    readings = readings_of(r, case.fault, rng)
    truth = Truth(case.world, r, cell, rng)
    m, chosen = bag.mapped(r, readings, outcome, cell=cell)
    if m is None:
        return r, outcome
    outcome.figures["no_return"] = chosen.get("no_return")
    _judge_erased(m, truth, outcome)
    outcome.drawn["map"] = m
    return r, outcome


def _judge_erased(m: ndtree.OccupancyMap, truth: Truth, outcome: Outcome) -> None:
    """Walls that are gone, and surfaces where there are none; what is not known may be so."""
    beams: Outcome = Outcome()
    judge_map(m, truth, beams)
    r = truth.recording
    returned = np.isfinite(r.ranges) & np.isfinite(r.exact)
    ends = truth.origins[:, None] + truth.directions * np.where(returned, r.exact, 0.0)[..., None]
    ends = ends[returned]
    met = ends[count_in(ends, ends, truth.cell) >= 5]
    if len(met) >= 100:
        met = met[truth.rng.choice(len(met), min(2000, len(met)), replace=False)]
        judge_lost(m, truth, outcome, met)
    for name in ("false occupied", "free but hidden"):
        if name in beams.figures:
            outcome.expect(name, beams.figures[name], most=limit(name))
            outcome.drawn[name] = beams.drawn[name]
