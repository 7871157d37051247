# SPDX-License-Identifier: BSD-3-Clause
"""Fading: a cube that was not seen for a time is unknown, and all others are as if nothing faded."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from calling import cli

import ndtree
from ndtree.base.scan import Scan
from ndtree.live import Fading, LiveMapper, ScansIntake
from ndtree.live.fading import _points_in_cubes
from ndtree.tuning.config import Config

SETTINGS = Config.of(no_return="free")


def fan(dim: int, stamp: float, x: float, seed: int, beams: int = 100) -> Scan:
    """Beams of 4 m around a sensor on the x axis."""
    random = np.random.default_rng(seed)
    ways = random.normal(size=(beams, dim))
    origin = np.full(dim, 0.1)
    origin[0] = x
    return Scan(origin + 4 * ways / np.linalg.norm(ways, axis=1, keepdims=True), origin, stamp=stamp)


N = 50


def drive(dim: int) -> Iterator[Scan]:
    """A second from scan to scan, 0.5 m on each; it stays at the end."""
    for i in range(N):
        yield fan(dim, float(i), 0.5 * min(i, N // 2), i)


def crossed(scan: Scan, edge: float) -> set[tuple[int, ...]]:
    """Cubes with a point of a beam in them, by a walk of 1 cm."""
    steps = np.linspace(0, 1, 401)[:, None, None]
    points = scan.origin + steps * (scan.endpoints - scan.origin)
    cubes = np.unique(np.floor(points.reshape(-1, scan.dim) / edge).astype(int), axis=0)
    return {tuple(cube) for cube in cubes.tolist()}


def made(kind: Any, dim: int, fading: Fading | None) -> Any:
    m = kind(dim=dim)
    for scan in drive(dim):
        scan.insert_into(m)
        if fading is not None:
            fading.follow(m, scan)
    return m


@pytest.mark.parametrize("kind, dim", [(ndtree.AdaptiveMap, 3), (ndtree.FixedMap, 2)])
def test_what_was_not_seen_is_unknown_and_what_was_is_as_it_was(kind: Any, dim: int) -> None:
    m, plain = made(kind, dim, Fading(10.0)), made(kind, dim, None)
    edge = m.max_cell_size if kind is ndtree.AdaptiveMap else 16 * m.min_cell_size
    seen: dict[tuple[int, ...], list[float]] = {}
    for scan in drive(dim):
        for cube in crossed(scan, edge):
            seen.setdefault(cube, [-1e9]).append(scan.stamp)
    random = np.random.default_rng(7)
    points = random.uniform(-4, 20, size=(30000, dim))
    points[:, 1:] = random.uniform(-4, 4, size=(30000, dim - 1))
    cubes = [tuple(one) for one in np.floor(points / edge).astype(int).tolist()]
    # Between two looks there is a tenth of the time; a cube that is only clipped may be found at the first.
    faded = np.array([seen.get(one, [1e9])[-1] < N - 1 - 13.0 for one in cubes])
    fresh = np.array([max(np.diff([*seen.get(one, [0.0])[1:], N - 1.0]), default=99.0) < 10 for one in cubes])
    before, after = plain.state(points), m.state(points)
    assert (before[faded] >= 0).sum() > 100 and (before[fresh] >= 0).sum() > 200
    assert (after[faded] == -1).all()
    assert np.array_equal(after[fresh], before[fresh])


def test_without_a_pause_nothing_fades() -> None:
    m, plain = ndtree.AdaptiveMap(dim=2), ndtree.AdaptiveMap(dim=2)
    fading = Fading(5.0)
    for i in range(40):
        scan = fan(2, 0.5 * i, 0.0, 0, 400)
        scan.insert_into(m)
        scan.insert_into(plain)
        assert fading.follow(m, scan) == 0
    assert m.to_bytes() == plain.to_bytes()


def test_only_a_box_fades() -> None:
    box = [[-10.0, -10.0], [1.0, 10.0]]
    m, plain = made(ndtree.AdaptiveMap, 2, Fading(10.0, box)), made(ndtree.AdaptiveMap, 2, None)
    points = np.random.default_rng(1).uniform([-4, -4], [10, 4], size=(5000, 2))
    outside = points[:, 0] > 1.0 + 1.6
    assert np.array_equal(m.state(points[outside]), plain.state(points[outside]))
    inside = points[:, 0] < 0.0
    assert (plain.state(points[inside]) >= 0).sum() > 300 and (m.state(points[inside]) == -1).all()


def test_a_map_that_was_loaded_fades_from_its_first_scan_on() -> None:
    m = ndtree.AdaptiveMap(dim=2)
    fan(2, 0.0, 50.0, 0).insert_into(m)
    assert (m.state(np.random.default_rng(0).uniform([48, -2], [52, 2], size=(500, 2))) >= 0).any()
    fading, counts = Fading(10.0), []
    for i in range(20):
        scan = fan(2, 100.0 + i, 0.0, i)
        scan.insert_into(m)
        counts.append(fading.follow(m, scan))
    assert sum(counts[:10]) == 0 and sum(counts) > 10
    assert (m.state(np.random.default_rng(0).uniform([48, -2], [52, 2], size=(500, 2))) == -1).all()


def test_a_clock_that_begins_again_forgets_nothing_at_once() -> None:
    m, fading = ndtree.AdaptiveMap(dim=2), Fading(5.0)
    for i, stamp in enumerate([1000.0, 1001.0, 3.0, 4.0, 5.0, 6.0, 7.0]):
        scan = fan(2, stamp, 0.0 if i < 2 else 50.0, i)
        scan.insert_into(m)
        assert fading.follow(m, scan) == 0
    scan = fan(2, 9.0, 50.0, 9)
    scan.insert_into(m)
    assert fading.follow(m, scan) > 10


def test_a_live_map_fades_by_the_same_steps() -> None:
    with LiveMapper(ScansIntake(SETTINGS, 2), fading=Fading(10.0)) as mapper:
        for scan in drive(2):
            mapper.put(scan)
    assert mapper.figures.mapped == N
    assert mapper.snapshot().to_bytes() == made(ndtree.AdaptiveMap, 2, Fading(10.0)).to_bytes()


@pytest.mark.parametrize("seconds", [0.0, -1.0, math.inf, math.nan])
def test_wrong_times_are_refused(seconds: float) -> None:
    with pytest.raises(ValueError, match=r"^fade = .* s: must be > 0 and finite$"):
        Fading(seconds)


def test_wrong_boxes_are_refused() -> None:
    with pytest.raises(ValueError, match="must be two corners, the lower one first"):
        Fading(1.0, [[0, 0], [1, 0]])
    with pytest.raises(ValueError, match=r"must be \(2, 3\) for a 3-D map"):
        Fading(1.0, [[0, 0], [1, 1]]).follow(ndtree.AdaptiveMap(dim=3), fan(3, 0.0, 0.0, 0))


@pytest.mark.parametrize("seconds", [4.0, 10.0])
def test_what_fades_does_so_after_its_time_and_at_most_a_tenth_more(seconds: float) -> None:
    step, looks = 0.1, 0.1 * seconds
    m, fading = ndtree.AdaptiveMap(dim=2), Fading(seconds)
    points = np.random.default_rng(3).uniform([47, -3], [53, 3], size=(400, 2))
    known = None
    gone = []
    for i in range(round(2 * seconds / step)):
        scan = fan(2, 100.0 + step * i, 50.0 if i == 0 else 0.0, i)
        scan.insert_into(m)
        fading.follow(m, scan)
        now = m.state(points) >= 0
        known = now if known is None else known
        if (now != known).any():
            gone.append((scan.stamp - 100.0, bool(now.any())))
            known = now
    assert gone and not gone[-1][1]
    assert seconds < gone[0][0] and gone[-1][0] <= seconds + looks + step + 1e-6


def test_the_command_fades_as_the_class_does(tmp_path: Path) -> None:
    log, target, scans = tmp_path / "drive.npz", tmp_path / "drive.ndt", list(drive(2))
    arrays = {"points": np.concatenate([scan.endpoints for scan in scans])}
    arrays["origins"] = np.stack([scan.origin for scan in scans])
    arrays["offsets"] = np.cumsum([0, *(len(scan) for scan in scans)])
    np.savez(log, **arrays, stamps=[scan.stamp for scan in scans])
    words = ["live", log, "-o", target, "--rate", 0, "--range-sigma", 0.03, "--no-return", "free", "--fade"]
    done = cli(*words, 10)
    assert done.exit_code == 0, done.stderr
    assert target.read_bytes() == made(ndtree.AdaptiveMap, 2, Fading(10.0)).to_bytes()
    assert target.read_bytes() != made(ndtree.AdaptiveMap, 2, None).to_bytes()
    refused = cli(*words, 0)
    assert refused.exit_code == 2 and "--fade 0: must be a number > 0 s" in refused.stderr


def test_it_is_looked_for_after_a_tenth_of_the_time() -> None:
    """Stamps are as clocks have them: the first look is at the first scan."""
    m, fading, begin = ndtree.AdaptiveMap(dim=2), Fading(10.0), 1000.0
    cleared = []
    for after, x in ((0.0, 0.0), (9.5, 30.0), (10.2, 30.0), (10.6, 30.0)):
        scan = fan(2, begin + after, x, 1)
        scan.insert_into(m)
        cleared.append(fading.follow(m, scan))
    assert cleared[:3] == [0, 0, 0] and cleared[3] > 0


@pytest.mark.parametrize("beams", [3, 4, 7, 8, 9])
def test_so_many_beams_are_followed_and_in_the_end_all(beams: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ndtree.live.fading.MOST_BEAMS", 4)
    angle = np.linspace(0, 2 * math.pi, beams, endpoint=False)
    scan = Scan(np.stack([10 * np.cos(angle), 10 * np.sin(angle)], axis=1), np.zeros(2))
    followed = []
    for number in range(-(-beams // 4)):
        points = _points_in_cubes(scan, math.inf, 1.0, number)
        length = np.linalg.norm(points, axis=1)
        within = points[(length > 2.0) & (length < 9.0)]
        turned = np.arctan2(within[:, 1], within[:, 0])[:, None] - angle
        followed.append(np.unique(np.abs(np.angle(np.exp(1j * turned))).argmin(axis=1)))
    assert all(len(one) <= 4 for one in followed)
    assert sorted(np.concatenate(followed).tolist()) == list(range(beams))
