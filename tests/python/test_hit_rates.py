# SPDX-License-Identifier: BSD-3-Clause
"""Probabilities that beams end in cells, their bounds, reliability and certificates, by beams held out."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import ndtree
from ndtree.evaluation.certificate import conformal_bound, free_and_wrong
from ndtree.evaluation.comparison.truth import expected_calibration_error, hit_log_score, reliability_of
from ndtree.evaluation.sampling import beam_points

DATA = Path(os.environ.get("NDTREE_DATA", Path(__file__).parents[2] / ".." / "shared" / "data"))
OFFICE = {"max_range": 20.0}
KINDS = ("adaptive", "fixed")


def scans_of(seed: int, scans: int = 120) -> list[ndtree.Scan]:
    return [scan.returned_only() for scan in ndtree.simulate("office", seed=seed, scans=scans)]


def map_of(kind: str, scans: list[ndtree.Scan]) -> ndtree.OccupancyMap:
    m = ndtree.AdaptiveMap(dim=2) if kind == "adaptive" else ndtree.FixedMap(dim=2)
    for scan in scans:
        scan.insert_into(m, **OFFICE)
    return m


def split(scans: list[ndtree.Scan], every: int = 3) -> tuple[list[ndtree.Scan], list[ndtree.Scan]]:
    held_out = [scan for i, scan in enumerate(scans) if i % every == every - 1]
    return [scan for i, scan in enumerate(scans) if i % every != every - 1], held_out


@pytest.mark.parametrize("kind", KINDS)
def test_bounds_hold_the_value_and_widen_with_the_interval(kind: str) -> None:
    m = map_of(kind, scans_of(1, 20))
    points = np.random.default_rng(0).uniform(-8.0, 8.0, (400, 2))
    value = m.probability(points, of="hit")
    unknown = m.state(points) == -1
    np.testing.assert_array_equal(np.isnan(value), unknown)
    assert 20 < unknown.sum() < 380
    known = points[~unknown]
    narrow, wide = (m.probability(known, interval=interval) for interval in (0.5, 0.95))
    for number, low, high in (narrow, wide):
        np.testing.assert_array_equal(number, value[~unknown])
        assert (low >= 0).all() and (low <= number).all() and (number <= high).all() and (high <= 1).all()
    assert (wide[1] <= narrow[1]).all() and (narrow[2] <= wide[2]).all()
    assert (wide[2] - wide[1] > narrow[2] - narrow[1]).mean() > 0.8
    assert all(isinstance(one, float) for one in m.probability(known[0], interval=0.9))
    assert all(one.shape == (0,) for one in m.probability(np.empty((0, 2)), interval=0.9))


def test_wrong_questions_are_refused() -> None:
    m = map_of("adaptive", scans_of(1, 2))
    points = np.zeros((1, 2))
    for interval in (0.0, 1.0, -0.5, math.nan):
        with pytest.raises(ValueError, match=r"interval = .*: must be in \(0, 1\)"):
            m.probability(points, interval=interval)
    with pytest.raises(ValueError, match="of = 'wall': must be 'occupied' or 'hit'"):
        m.probability(points, of="wall")  # type: ignore[call-overload]
    with pytest.raises(ValueError, match="interval: is of 'hit'"):
        m.probability(points, of="occupied", interval=0.5)  # type: ignore[call-overload]
    for confidence in (0.0, 1.0, math.nan):
        with pytest.raises(ValueError, match="confidence = "):
            m.certify([], confidence=confidence)
    with pytest.raises(ValueError, match="max_range = -1"):
        m.certify([], max_range=-1)


@pytest.mark.skipif(not ndtree.has_octomap, reason="built without OctoMap")
def test_octomap_has_probabilities_of_hits_but_no_bounds() -> None:
    m = ndtree.OctoMap(dim=2, min_cell_size=0.05)
    mapped, held_out = split(scans_of(1, 30))
    for scan in mapped:
        scan.insert_into(m, **OFFICE)
    points = np.random.default_rng(0).uniform(-8.0, 8.0, (300, 2))
    value = m.probability(points, of="hit")
    np.testing.assert_array_equal(np.isnan(value), m.state(points) == -1)
    order = np.argsort(m.probability(points[~np.isnan(value)]))
    assert (np.diff(value[~np.isnan(value)][order]) >= 0).all()
    with pytest.raises(ValueError, match="OctoMap does not keep how many beams"):
        m.probability(points, interval=0.9)
    assert reliability_of(m, held_out, 20.0)["all"]["ece"] < 0.02


def leaf_numbers(m: ndtree.OccupancyMap) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Of each smallest cell of a box, the number of the leaf that holds it; and the box's lower corner."""
    leaves = m.leaves()
    size = m.min_cell_size
    lower = leaves.lower.min(axis=0)
    first = np.rint((leaves.lower - lower) / size).astype(int)
    across = np.rint(leaves.size / size).astype(int)
    grid = np.full((first + across[:, None]).max(axis=0), -1)
    for n in np.unique(across):
        which = np.flatnonzero(across == n)
        for dx, dy in np.ndindex(n, n):
            grid[first[which, 0] + dx, first[which, 1] + dy] = which
    return grid, lower


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
def test_bounds_cover_what_beams_held_out_do_in_simulated_worlds(kind: str) -> None:
    """Of n beams of other scans that reach a cell, as many end in it as the bounded rate explains."""
    generator = np.random.default_rng(3)
    inside = cells = 0
    for seed in (11, 12):
        mapped, held_out = split(scans_of(seed, 150))
        m = map_of(kind, mapped)
        grid, lower = leaf_numbers(m)
        leaves = m.leaves()
        reached, ended = np.zeros((2, len(leaves)), dtype=np.int64)
        for scan in held_out:
            start, way, far = scan.returned_beams(20.0)
            steps = np.arange(0.0, far.max() + 0.02, 0.02)
            at = np.minimum(steps[None], far[:, None])
            cell = np.floor((start[:, None] + at[..., None] * way[:, None] - lower) / m.min_cell_size)
            cell = np.clip(cell.astype(int), 0, np.array(grid.shape) - 1)
            number = grid[cell[..., 0], cell[..., 1]]
            for row in number:
                reached[np.unique(row)] += 1
            np.add.at(ended, number[:, -1], 1)
        which = np.flatnonzero(leaves.observed & (reached >= 3))
        which = which[:: 1 + len(which) // 20_000]
        middle = leaves.lower[which] + 0.5 * leaves.size[which, None]
        _, low, high = (one.astype(float) for one in m.probability(middle, interval=0.95))
        # Where the rate is at one of its bounds, its number of ends is binomial: allow for that alone.
        n = reached[which]
        least = np.quantile(generator.binomial(n, low, (200, len(n))), 0.025, axis=0)
        most = np.quantile(generator.binomial(n, high, (200, len(n))), 0.975, axis=0)
        occupied = leaves.state[which] == 1
        for some in (np.ones(len(n), dtype=bool), occupied):
            share = ((ended[which] >= least) & (ended[which] <= most))[some].mean()
            assert share >= 0.95, f"seed {seed}: {share}"
        inside += (high - low < 0.8).sum()
        cells += len(n)
    assert cells > 3000 and inside > 0.5 * cells, "bounds say something"


@pytest.mark.long
@pytest.mark.parametrize(
    ("world", "seed", "scans"), [("office", 21, 100), ("office", 22, 100), ("apartment", 21, 40)]
)
def test_calibration_errors_are_small_in_other_worlds(world: str, seed: int, scans: int) -> None:
    """As long as scans look where others did: at the door of a room without scans, cells mislead."""
    log = ndtree.simulate(world, seed=seed, scans=scans)  # type: ignore[arg-type]
    found = ndtree.compare(log, KINDS, held_out=5, calibration=True, max_range=20.0)
    for row in found["maps"]:
        of = row["calibration"]
        for key in ("all", "free"):
            assert of[key]["ece"] <= 0.02, f"{row['map']} {key}"
        assert of["occupied"]["ece"] <= 0.12, row["map"]
        for parts in ("by_size", "by_beams"):
            assert sum(one["pairs"] for one in of[parts]) == of["all"]["pairs"]
        assert of["free"]["pairs"] + of["occupied"]["pairs"] <= of["all"]["pairs"]
        assert len(of["by_size"]) > 1 or row["map"] == "fixed"
        assert len(of["by_beams"]) > 3


def test_errors_are_weighted_by_pairs() -> None:
    bins = [
        {"pairs": 30, "probability": 0.1, "ends": 0.2},
        {"pairs": 10, "probability": 0.9, "ends": 0.5},
    ]
    assert expected_calibration_error(bins) == pytest.approx(0.75 * 0.1 + 0.25 * 0.4)
    assert expected_calibration_error([]) is None


def test_points_of_beams_are_those_of_the_held_out_truth() -> None:
    mapped, held_out = split(scans_of(5, 12))
    m = map_of("adaptive", mapped)
    for scan in held_out:
        truth = scan.evaluate_on(m, max_range=20.0)
        free, ends = beam_points(scan, 20.0)
        assert (len(free), len(ends)) == (truth.samples, truth.endpoints)
        assert np.mean(m.state(free) == 0) == pytest.approx(truth.free, abs=2e-4)


def test_scores_of_hits_are_those_of_balanced_points() -> None:
    """Half of the points are end points then: drawn so, their log-likelihood is the score."""
    mapped, held_out = split(scans_of(6, 60))
    m = map_of("adaptive", mapped)
    points = [beam_points(scan, 20.0) for scan in held_out]
    free, ends = (np.concatenate([one[i] for one in points]) for i in (0, 1))
    odds_of_free = len(free) / len(ends)
    total = 0.0
    for kind, some in ((0, free), (1, ends)):
        rates = m.probability(some, of="hit").astype(float)
        for rate in rates:
            p = 0.5 if math.isnan(rate) else 1.0 / (1.0 + (1.0 - rate) / rate / odds_of_free)
            p = min(max(p, 0.02), 0.98)
            total += 0.5 * math.log(p if kind else 1.0 - p) / len(some)
    assert hit_log_score(m, held_out, 20.0) == pytest.approx(total, abs=1e-6)
    assert math.isnan(hit_log_score(m, [], 20.0))
    truth = ndtree.HeldOutTruth()
    for scan in held_out:
        truth += scan.evaluate_on(m, max_range=20.0)
    assert total > truth.log_score + 0.05


@pytest.mark.parametrize("confidence", [0.8, 0.95])
def test_one_more_share_keeps_to_the_bound(confidence: float) -> None:
    """Exchangeable shares that depend on each other, with ties: as of scans of one world."""
    generator = np.random.default_rng(4)
    kept = 0
    for _ in range(4000):
        n = generator.integers(20, 60)
        shares = np.round(generator.beta(0.5, generator.uniform(5.0, 50.0), n + 1), 2)
        kept += shares[-1] <= conformal_bound(shares[:-1], confidence)
    assert kept / 4000 >= confidence - 0.01
    assert conformal_bound(np.zeros(3), 0.95) == 1.0
    assert conformal_bound(np.empty(0), 0.95) == 1.0
    assert conformal_bound(np.arange(19) / 100, 0.95) == 0.18
    assert conformal_bound(np.arange(99) / 100, 0.95) == 0.94


def test_certificates_hold_in_worlds_that_nothing_was_tried_in() -> None:
    generator = np.random.default_rng(5)
    kept, bounds = [], []
    for seed in range(100, 125):
        scans = scans_of(seed, 90)
        order = generator.permutation(len(scans))
        mapped, held_out, others = ([scans[i] for i in order[k::3]] for k in range(3))
        m = map_of(KINDS[seed % 2], mapped)
        certificate = m.certify(held_out, max_range=20.0)
        assert 25 < certificate.scans <= len(held_out) and certificate.at_most > 0
        bounds.append(certificate.at_most)
        assert certificate.at_most <= certificate.worst and certificate.occupied < certificate.free
        for scan in others:
            free, wrong = free_and_wrong(m, scan, 20.0)
            kept.append(wrong <= certificate.at_most * free)
    assert len(kept) > 700
    assert np.mean(kept) >= 0.95 - 0.01, "as far as chance lets them"
    assert np.median(bounds) < 0.1


def test_a_map_that_calls_a_wall_free_gets_a_large_bound() -> None:
    scans = scans_of(7, 60)
    mapped, held_out = split(scans)
    wrong = ndtree.FixedMap(dim=2)
    for scan in mapped:  # Beams go half a metre too far.
        way = scan.endpoints - scan.origin
        length = np.linalg.norm(way, axis=1, keepdims=True)
        wrong.insert(scan.origin + way * (1 + 0.5 / length), scan.origin, max_range=20.0)
    right = map_of("fixed", mapped).certify(held_out, max_range=20.0)
    assert wrong.certify(held_out, max_range=20.0).at_most > 1.5 * right.at_most
    assert "at most" in str(right) and "20 scans held out" in str(right)


def test_the_command_line_shows_and_draws_them(tmp_path: Path) -> None:
    from typer.testing import CliRunner

    from ndtree.cli.commands.app import app

    def run(*words: object) -> tuple[int, str]:
        done = CliRunner().invoke(app, [str(word) for word in words], standalone_mode=False)
        return done.exit_code or int(done.return_value or 0), done.output

    picture, figures = tmp_path / "reliability.png", tmp_path / "figures.json"
    asked = ["compare", "--world", "office", "--scans", 60, "--held-out", 3, "--maps", "adaptive,fixed"]
    status, text = run(*asked, "--reliability", picture, "--certify", "--json", figures)
    assert status == 0, text
    for line in ("calibration error", "called occupied", "free is occupied, at most", "to the cell"):
        assert line in text
    assert picture.read_bytes().startswith(b"\x89PNG")
    for row in json.loads(figures.read_text())["maps"]:
        assert row["certificate"]["scans"] == 20 and 0 < row["certificate"]["at_most"] < 1
        assert row["calibration"]["free"]["bins"][0]["pairs"] > 100
    status, text = run("compare", "--world", "office", "--scans", 4, "--held-out", 0, "--certify")
    assert status == 2
