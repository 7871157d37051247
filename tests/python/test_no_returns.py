# SPDX-License-Identifier: BSD-3-Clause
"""Beams without return are believed where the world is open, and not where walls swallow them."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import arrays_of

import ndtree
from ndtree.base.scan import Scan
from ndtree.evaluation.sampling import RUN, RUNS, judge, spread
from ndtree.tuning.first_look import NEGLIGIBLE, first_look


def room(silent: float, seed: int = 1, scans: int = 60, gate: bool = False) -> list[Scan]:
    """A laser that walks in a square room of 8 m; some beams get lost, those through a gate rightly so."""
    generator = np.random.default_rng(seed)
    angles = np.linspace(-np.pi, np.pi, 180, endpoint=False)
    made = []
    for i in range(scans):
        origin = np.array([2 * np.cos(0.1 * i), 2 * np.sin(0.1 * i)])
        way = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        with np.errstate(divide="ignore"):
            length = np.min(np.where(way > 0, 4 - origin, -4 - origin) / way, axis=1)
        end = origin + length[:, None] * way
        lost = generator.random(180) < silent
        if gate:
            lost |= (end[:, 0] > 3.99) & (abs(end[:, 1]) < 2)
        length = np.where(lost, 12.0, length + generator.normal(0, 0.01, 180))
        made.append(Scan(origin + length[:, None] * way, origin, ~lost, stamp=0.1 * i))
    return made


@pytest.mark.parametrize("silent, gate, choice", [
    (0.0, False, "ignore"), (0.0, True, "free"), (0.1, False, "ignore"), (0.5, False, "ignore"),
    (0.2, True, "ignore"), (0.01, True, "free"),
])  # fmt: skip
def test_what_others_hit_decides(silent: float, gate: bool, choice: str) -> None:
    found = judge(room(silent, gate=gate))
    assert found.choice == choice, str(found)
    assert (found.beams > 0) == (silent > 0 or gate)
    assert ("are left out" in str(found)) == (choice == "ignore" and found.share > 0)


def test_a_simulated_laser_that_loses_beams_is_judged_as_any_other() -> None:
    log = ndtree.simulate("office", scans=100, no_return_rate=0.1)
    assert first_look(log).no_returns.choice == "ignore"
    found = ndtree.compare(log, ["fixed"], held_out=0)
    assert found["parameters"]["no_return"] == "ignore"
    clean = ndtree.simulate("street", scans=20, no_return_rate=0.0)
    assert first_look(clean).no_returns.choice == "free"


def test_scans_with_an_origin_of_each_beam_are_judged_alike() -> None:
    """Also where the first scan has no beams, and the first beam of the others an unknown origin."""
    scans = room(0.1)
    each = [Scan(np.empty((0, 2)), np.empty((0, 2)), np.empty(0, bool))]
    for scan in scans[1:]:
        origins = np.vstack([[np.nan, np.nan], np.tile(scan.origin, (len(scan), 1))])
        endpoints = np.vstack([[1.0, 1.0], scan.endpoints])
        each.append(Scan(endpoints, origins, np.append(True, scan.returned)))
    scans[0] = scans[0].only(slice(0, 0))
    found, expected = judge(each), judge(scans)
    assert found.choice == expected.choice == "ignore" and found.crossing == expected.crossing
    assert found.beams == expected.beams > 100 and found.expected == expected.expected


def plain_count(scans: list[Scan]) -> tuple[int, float, float, float]:
    """The rule beam by beam: beams without return that tell something, how many cross, and would rightly; and
    the share of surfaces that fewer returned from than did not."""
    cell = {2: 0.1, 3: 0.2}[scans[0].dim]
    surfaces = ndtree.FixedMap(dim=scans[0].dim, min_cell_size=cell, range_sigma=cell / 4)
    hits: dict[tuple[int, ...], list[int]] = {}
    points: dict[tuple[int, ...], list[np.ndarray]] = {}
    met: dict[tuple[int, ...], list[int]] = {}
    for number, scan in enumerate(scans[::2]):
        only = scan.returned_only()
        surfaces.insert(only.endpoints, only.origin)
        for point in only.endpoints:
            hits.setdefault(tuple(np.floor(point / cell).astype(int)), []).append(number)
            points.setdefault(tuple(np.floor(point / cell).astype(int)), []).append(point)
    counts = {True: [0, 0, 0.0], False: [0, 0, 0.0]}
    for number, scan in enumerate(scans[1::2]):
        length = np.linalg.norm(scan.endpoints - scan.origin, axis=1)
        ways = (scan.endpoints - scan.origin) / length[:, None]
        casts = surfaces.cast_rays(np.broadcast_to(scan.origin, ways.shape), ways, at="cell")
        for way, end, cast, returned in zip(ways, length - 3 * cell, casts, scan.returned):
            count = counts[bool(returned)]
            if cast < end + 6 * cell and (cast < end) != returned:
                where = tuple(np.floor((scan.origin + (cast + 0.001 * cell) * way) / cell).astype(int))
                seen = hits.get(where, [])
                to = np.array(points.get(where, np.empty((0, 2)))) - scan.origin
                aside = way[0] * to[:, 1] - way[1] * to[:, 0]
                if any(one <= number for one in seen) and any(one > number for one in seen):
                    if aside.min() < 0 < aside.max():
                        met.setdefault(where, [0, 0])[int(returned)] += 1
            if not cast < end:
                count[0] += 1
                count[2] += max(end, 0.0)
                continue
            where = tuple(np.floor((scan.origin + (cast + 0.001 * cell) * way) / cell).astype(int))
            seen = hits.get(where, [])
            if any(one <= number for one in seen) and any(one > number for one in seen):
                count[0] += 1
                count[1] += 1
                count[2] += cast
    (beams, crossing, metres), (_, wrong, clear) = counts[False], counts[True]
    erased = np.mean([silent > others for silent, others in met.values()])
    return beams, crossing / beams, 1 - np.exp(-wrong / clear * metres / beams), float(erased)


@pytest.mark.parametrize("silent, gate", [(0.1, False), (0.01, True), (0.3, True)])
@pytest.mark.parametrize("shift", [0.0, 0.3])
def test_beams_are_counted_as_one_by_one(silent: float, gate: bool, shift: float) -> None:
    generator = np.random.default_rng(8)
    scans = []
    for scan in room(silent, gate=gate, scans=40):
        by = generator.normal(0, shift, 2)
        scan = scan.only(np.isfinite(scan.endpoints).all(axis=1))
        scans.append(Scan(scan.endpoints + by, scan.origin + by, scan.returned))
    beams, crossing, expected, erased = plain_count(scans)
    found = judge(scans)
    assert found.beams == beams > 10 and found.crossing == crossing
    assert found.expected == pytest.approx(expected, rel=1e-9)
    assert found.erased == pytest.approx(erased, abs=1e-12) and found.surfaces > 10
    # That a fifth or more of all cross is less probable than three standard deviations: Wilson's interval
    # solves this for the fraction.
    deviations = (0.2 - crossing) / np.sqrt(0.2 * 0.8 / beams)
    assert found.choice == ("free" if deviations > 3 and erased <= 0.02 else "ignore")


def test_samples_are_runs_from_all_over() -> None:
    for n in (1, 5, RUN * RUNS * 2, 1000, 5003):
        scans = [Scan(np.ones((1, 2)), np.zeros(2), stamp=float(i)) for i in range(n)]
        runs, count, beams = spread(scans)
        assert (count, beams) == (n, n)
        assert len(runs) <= 2 * RUNS and (len(runs) >= RUNS or n < RUN * RUNS)
        starts = np.array([run[0].stamp for run in runs])
        assert starts[0] == 0 and (n - starts[-1]) <= 2 * max(np.diff(starts), default=n)
        for run in runs[:-1]:
            assert [scan.stamp - run[0].stamp for scan in run] == [0, 1, 2, 3]


def test_only_some_beams_of_a_large_scan_are_sampled() -> None:
    points = np.random.default_rng(3).normal(size=(9000, 3)).astype(np.float32)
    points[3, 1], points[6, 0], points[7] = -2e9, np.nan, np.inf
    returned = np.arange(9000) % 5 > 0
    scan = Scan(points, np.zeros(3), returned, range_sigma=np.full(9000, 0.1))
    [[one]], _, beams = spread([scan])
    kept = [i for i in range(0, 9000, 3) if i != 3]
    assert beams == 9000 and len(one) == len(kept) == 2999
    assert one.endpoints.dtype == np.float32
    np.testing.assert_array_equal(one.endpoints, points[kept])
    np.testing.assert_array_equal(one.returned, returned[kept])
    assert len(one.range_sigma) == 2999


def written(scans: list[Scan], path: Path) -> Path:
    np.savez(path, **arrays_of(scans))
    return path


def test_logs_of_any_format_decide_and_an_option_overrules(tmp_path: Path) -> None:
    log = ndtree.read(written(room(0.3), tmp_path / "a.npz"))
    assert first_look(log).no_returns.choice == "ignore"
    for asked, chosen in (("auto", "ignore"), ("free", "free"), ("ignore", "ignore")):
        found = ndtree.compare(log, ["adaptive"], no_return=asked, held_out=0)
        assert found["parameters"]["no_return"] == chosen


def test_what_mapping_costs_is_told_of_logs_with_an_absurd_beam(tmp_path: Path) -> None:
    scans = room(0.3)
    scans[0].endpoints[0] = 4e8
    cost = first_look(ndtree.read(written(scans, tmp_path / "far.npz"))).cost()
    assert cost[0] > 0 and cost[1] > 0


@pytest.mark.parametrize("share, is_kept", [(0.5 * NEGLIGIBLE, False), (2.0 * NEGLIGIBLE, True)])
def test_noise_that_grows_counts_by_what_it_adds_at_the_longest_range(
    share: float, is_kept: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = ndtree.read(written(room(0.0), tmp_path / "a.npz"))
    longest = max(float(scan.returned_beams()[2].max(initial=0.0)) for scan in log)
    assert longest > 3.0, "range and squared range are not the same"
    quadratic = share * 0.02 / longest**2
    noise = (SimpleNamespace(value=0.02), SimpleNamespace(value=quadratic))
    monkeypatch.setattr("ndtree.tuning.first_look.range_noise", lambda scans: noise)
    found = first_look(log).range_sigma_quadratic
    assert found == (pytest.approx(quadratic, rel=0.05) if is_kept else 0.0)


def test_the_first_look_measures_the_sensor(tmp_path: Path) -> None:
    look = first_look(ndtree.read(written(room(0.0, gate=True), tmp_path / "a.npz")))
    assert look.is_measured and 0.006 < look.range_sigma < 0.015
    assert look.no_returns.choice == "free" and 8 < look.max_range < 10
