# SPDX-License-Identifier: BSD-3-Clause
"""What scans saw, and what maps claim beyond it: as SciPy's nearest neighbours and a plain count have it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest

import ndtree

spatial = pytest.importorskip("scipy.spatial")

Array = np.ndarray[Any, Any]
LineOfSight = Callable[[Array, Array, Array], Array]


def seen_by(
    scans: Sequence[ndtree.Scan],
    points: Array,
    max_range: float,
    is_clear: LineOfSight | None = None,
    spacings: float = 1.5,
    tolerance: float = 0.1,
) -> Array:
    """Whether some scan saw each of the points; each origin of a scan is looked at from by itself."""
    seen = np.zeros(len(points), dtype=bool)
    for scan in scans:
        starts = np.broadcast_to(np.asarray(scan.origin, float), scan.endpoints.shape)
        ways = scan.endpoints.astype(float) - starts
        lengths = np.linalg.norm(ways, axis=1)
        returned = np.ones(len(scan), bool) if scan.returned is None else scan.returned
        usable = np.isfinite(lengths) & (lengths > 0)
        for origin in np.unique(starts[usable], axis=0):
            own = usable & (starts == origin).all(axis=1)
            if np.count_nonzero(own) < 2:
                continue
            beams = spatial.cKDTree(ways[own] / lengths[own, None])
            spacing = np.median(beams.query(beams.data, k=2)[0][:, 1])
            far = np.linalg.norm(points - origin, axis=1)
            to = (points - origin) / far[:, None]
            angle, beam = beams.query(to)
            if is_clear is not None:
                reached = (far <= max_range) & is_clear(origin, to, far - tolerance)
            else:
                hit = returned[own] & (lengths[own] <= max_range)
                reach = np.where(hit, lengths[own] + tolerance, np.minimum(lengths[own], max_range))
                reached = far <= reach[beam]
            seen |= (angle <= spacings * spacing) & reached
    return seen


def hand_made_log(dim: int) -> list[ndtree.Scan]:
    """Half-open views, beams that did not return or are invalid, several origins, and single beams."""
    random = np.random.default_rng(3)
    scans = []
    for s in range(15):
        n = 1 if s == 0 else int(random.integers(2, 200))
        ways = random.normal(size=(n, dim))
        if s % 2:
            ways[:, 0] = np.abs(ways[:, 0]) + 0.5
        ways *= (random.uniform(0.5, 4.0, n) / np.linalg.norm(ways, axis=1))[:, None]
        origins = random.uniform(-1.0, 1.0, (3, dim))
        origin = origins[random.integers(0, 3, n)] if s % 3 == 2 else origins[0]
        ends = origin + ways
        ends[random.random(n) < 0.1] = np.nan
        returned = None if s % 4 == 0 else random.random(n) < 0.7
        scans.append(ndtree.Scan(ends.astype(np.float32) if s % 5 == 0 else ends, origin, returned))
    return scans


@pytest.mark.parametrize("dim", [2, 3, 4])
@pytest.mark.parametrize("max_range", [math.inf, 2.5])
def test_seen_space_of_a_hand_made_log_is_that_of_scipy(dim: int, max_range: float) -> None:
    scans = hand_made_log(dim)
    space = ndtree.SeenSpace(scans, max_range=max_range, samples=3000, seed=4)
    assert (space.dim, space.points.shape, space.seen.shape) == (dim, (3000, dim), (3000,))
    np.testing.assert_array_equal(space.seen, seen_by(scans, space.points, max_range))
    wide = ndtree.SeenSpace(
        iter(scans), max_range=max_range, samples=3000, seed=4, spacings=3.0, tolerance=0.5
    )
    np.testing.assert_array_equal(wide.points, space.points)
    np.testing.assert_array_equal(
        wide.seen, seen_by(scans, space.points, max_range, spacings=3.0, tolerance=0.5)
    )
    assert 100 < np.count_nonzero(space.seen) < np.count_nonzero(wide.seen) < 3000


@pytest.mark.parametrize("dim", [2, 3])
def test_points_are_drawn_around_the_middle_of_the_end_points(dim: int) -> None:
    scans = hand_made_log(dim)
    space = ndtree.SeenSpace(scans, max_range=2.5, middle=0.9, margin=0.3)
    ends = []
    for scan in scans:
        way = scan.endpoints.astype(float) - scan.origin
        length = np.linalg.norm(way, axis=1, keepdims=True)
        ends.append(scan.origin + way * np.minimum(1.0, 2.5 / length))
    lower, upper = np.nanpercentile(np.concatenate(ends), (5, 95), axis=0)
    assert space.box is not None
    np.testing.assert_allclose(space.box, [lower - 0.3, upper + 0.3], rtol=0, atol=1e-9)
    assert len(space.points) == 40_000
    assert (space.points >= space.box[0]).all() and (space.points < space.box[1]).all()
    parts = np.histogramdd(space.points, bins=4, range=list(space.box.T))[0]
    assert parts.sum() == 40_000
    assert np.abs(parts - 40_000 / 4**dim).max() < 6 * math.sqrt(40_000 / 4**dim)


def test_in_a_simulated_world_the_line_of_sight_decides() -> None:
    log = ndtree.simulate("office", seed=5, scans=25)

    def is_clear(origin: Array, ways: Array, up_to: Array) -> Array:
        surface = log.distance(origin, ways)
        return ~(surface <= up_to)

    scans = list(log)
    silent = [np.linalg.norm(s.endpoints[~s.returned] - s.origin, axis=1) for s in scans]
    sensor_range = float(np.nanmax(np.concatenate(silent)))
    for max_range, farthest in ((6.0, 6.0), (math.inf, sensor_range)):
        space = log.seen_space(scans, max_range=max_range, samples=8000)
        expected = seen_by(scans, space.points, farthest, is_clear)
        assert np.count_nonzero(space.seen != expected) <= 1  # The sensor's range is known but for rounding.
        assert 1000 < np.count_nonzero(expected) < 7000
        by_beams = ndtree.SeenSpace(scans, max_range=farthest, samples=8000)
        assert 0 < np.count_nonzero(by_beams.seen != expected) < 800


def test_claims_are_a_plain_count() -> None:
    scans = hand_made_log(2)
    space = ndtree.SeenSpace(scans, samples=5000)
    m = ndtree.FixedMap(dim=2, min_cell_size=0.1)
    nothing = m.claims(space)
    assert (nothing.points, nothing.free, nothing.free_and_unseen) == (5000, 0, 0)
    assert math.isnan(nothing.free_unseen)
    assert nothing.seen_unknown == nothing.wrong_volume == 1.0
    for scan in scans:
        scan.insert_into(m)
    free, unknown = (m.state(space.points) == value for value in (0, -1))
    claims = m.claims(space)
    assert (claims.points, claims.seen) == (5000, np.count_nonzero(space.seen))
    assert claims.free == np.count_nonzero(free) > 500
    assert claims.free_and_unseen == np.count_nonzero(free & ~space.seen) > 50
    assert claims.unknown_and_seen == np.count_nonzero(unknown & space.seen) > 50
    assert claims.free_unseen == claims.free_and_unseen / claims.free
    assert claims.seen_unknown == claims.unknown_and_seen / claims.seen
    assert claims.wrong_volume == (claims.free_and_unseen + claims.unknown_and_seen) / claims.seen


def test_without_a_beam_there_is_nothing_to_ask() -> None:
    silent = ndtree.Scan(np.full((3, 2), np.nan), np.zeros(2))
    space = ndtree.SeenSpace([silent, ndtree.Scan(np.empty((0, 2)), np.zeros(2))])
    assert (space.points.shape, space.seen.shape, space.box) == ((0, 2), (0,), None)
    claims = ndtree.FixedMap(dim=2).claims(space)
    assert claims.points == 0
    assert all(math.isnan(share) for share in (claims.free_unseen, claims.seen_unknown, claims.wrong_volume))


@pytest.mark.parametrize("simulated", [True, False])
def test_a_comparison_says_what_its_maps_claim(simulated: bool) -> None:
    log = ndtree.simulate("office", seed=7, scans=40)
    mapped = [scan for i, scan in enumerate(log) if i % 10 != 9]
    maps = ["adaptive", "paper", "fixed"] + ["octomap"] * ndtree.has_octomap
    options: dict[str, Any] = {"cell_size": 0.1, "max_cell_size": 1.6, "range_sigma": 0.03}
    source = log if simulated else list(log)
    comparison = ndtree.compare(source, maps, max_range=12.0, no_return="free", **options)
    of = log.seen_space if simulated else ndtree.SeenSpace
    space = of(mapped, max_range=12.0)
    table = str(comparison)
    for name in maps:
        claims = comparison.row(name)["claims"]
        states = comparison.map_objects[name].state(space.points)
        free, unknown = states == 0, states == -1
        wrong = np.count_nonzero(free & ~space.seen), np.count_nonzero(unknown & space.seen)
        assert claims == {
            "points": 40_000,
            "seen": np.count_nonzero(space.seen),
            "free": np.count_nonzero(free),
            "free_and_unseen": wrong[0],
            "unknown_and_seen": wrong[1],
            "free_unseen": wrong[0] / np.count_nonzero(free),
            "seen_unknown": wrong[1] / np.count_nonzero(space.seen),
            "wrong_volume": sum(wrong) / np.count_nonzero(space.seen),
        }
        assert claims["free"] > 5000
        for share in ("free_unseen", "seen_unknown", "wrong_volume"):
            assert f"{100 * claims[share]:.2f} %" in table
    for label in ("free but unseen", "seen but unknown", "wrong volume"):
        assert label in table
    assert "claims_free_unseen" in comparison.to_csv()


def test_larger_cells_claim_more_unseen_space() -> None:
    log = list(ndtree.simulate("office", seed=7, scans=20))
    maps = [f"fixed@{size}" for size in (0.05, 0.1, 0.2, 0.4, 0.8)]
    rows = ndtree.compare(log, maps, range_sigma=0.03)["maps"]
    unseen = [row["claims"]["free_unseen"] for row in rows]
    assert unseen == sorted(unseen)
    assert unseen[-1] > 0.1 > 0.05 > unseen[0] > 0.0


@pytest.mark.parametrize(
    "call, message",
    [
        (lambda scan: ndtree.SeenSpace([]), "scans: none, expected at least one"),
        (lambda scan: ndtree.SeenSpace([scan], max_range=0.0), "max_range = 0.0 m: must be > 0"),
        (lambda scan: ndtree.SeenSpace([scan], max_range=math.nan), "max_range = nan m: must be > 0"),
        (lambda scan: ndtree.SeenSpace([scan], samples=0), "samples = 0.0: must be in"),
        (lambda scan: ndtree.SeenSpace([scan], spacings=0.0), "spacings = 0.0: must be > 0 and finite"),
        (lambda scan: ndtree.SeenSpace([scan], tolerance=-1.0), "tolerance = -1.0: must be >= 0 m"),
        (lambda scan: ndtree.SeenSpace([scan], margin=math.inf), "margin = inf: must be >= 0 m and finite"),
        (lambda scan: ndtree.SeenSpace([scan], middle=0.0), r"middle = 0.0: must be in \(0, 1\]"),
        (lambda scan: ndtree.SeenSpace([scan, scan_in(3)]), r"scan 1: points has shape \(2, 3\)"),
        (lambda scan: ndtree.SeenSpace([scan_in(5)]), "scan 0: dim = 5: must be 2, 3 or 4"),
        (
            lambda scan: ndtree.simulate("street", scans=1).seen_space([scan]),
            "simulation: must be a simulated log with dim = 2",
        ),
        (
            lambda scan: ndtree.FixedMap(dim=3).claims(ndtree.SeenSpace([scan])),
            "space has dim = 2: must be 3 as the map",
        ),
    ],
)
def test_what_cannot_be_is_refused(call: Callable[[ndtree.Scan], Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call(scan_in(2))


def scan_in(dim: int) -> ndtree.Scan:
    return ndtree.Scan(np.eye(2, dim), np.zeros(dim))
