# SPDX-License-Identifier: BSD-3-Clause
"""Poses that drift are told of where a planar laser sees places again; good ones are not."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import ndtree
from ndtree.base.scan import Scan
from ndtree.evaluation.sampling import spread
from ndtree.tuning.revisits import LEAST_PLACES, drift, is_of_one_place, surface_of
from ndtree.tuning.revisits import moved as matched


@pytest.fixture(scope="module")
def office() -> list[Scan]:
    return list(ndtree.simulate("office", scans=240))


def moved(scan: Scan, shift: tuple[float, float], angle: float = 0.0) -> Scan:
    c, s = math.cos(angle), math.sin(angle)
    turn = np.array([[c, s], [-s, c]])
    heading = None if scan.heading is None else scan.heading + angle
    return replace(
        scan, endpoints=scan.endpoints @ turn + shift, origin=scan.origin @ turn + shift, heading=heading
    )


@pytest.mark.parametrize("shift", [(0.2, 0.1), (-0.3, 0.0), (0.0, 0.5)])
def test_a_second_lap_beside_the_first_is_told_of_with_how_far(
    shift: tuple[float, float], office: list[Scan]
) -> None:
    laps = [*office, *(moved(scan, shift) for scan in office)]
    found = drift(spread(laps)[0])
    assert found is not None and found.places >= 10
    assert found.error == pytest.approx(math.hypot(*shift), abs=0.03)
    assert f"drift by about {found.error:.1g} m" in str(found) and "align" in str(found)


def test_a_heading_that_drifts_is_told_of(office: list[Scan]) -> None:
    found = drift(spread([moved(scan, (0.0, 0.0), 0.0008 * i) for i, scan in enumerate(office)])[0])
    assert found is not None and 0.12 < found.error < 1.0


def test_so_many_places_are_needed_and_no_more(office: list[Scan], monkeypatch: pytest.MonkeyPatch) -> None:
    runs = spread([*office, *(moved(scan, (0.3, 0.0)) for scan in office)])[0]
    found = drift(runs)
    assert found is not None and found.places > LEAST_PLACES
    for more, expected in ((0, found), (1, None)):
        monkeypatch.setattr("ndtree.tuning.revisits.LEAST_PLACES", found.places + more)
        assert drift(runs) == expected


@pytest.mark.parametrize("spacing", [0.5, 0.8])
@pytest.mark.parametrize("shift", [0.15, 0.25])
def test_pillars_that_look_alike_do_not_tell_which_is_which(spacing: float, shift: float) -> None:
    x = (np.arange(-8, 8, spacing)[:, None] + np.linspace(-0.1, 0.1, 8)).ravel()
    both = np.concatenate([np.column_stack([x, np.full(len(x), y)]) for y in (-2.0, 2.0)])
    points = both[np.argsort(np.arctan2(both[:, 1], both[:, 0]))]
    one = Scan(points, np.zeros(2))
    assert matched([one], moved(one, (shift, 0.0)), (1.0, 1.0, 0.2), 0.1) is None


def test_good_poses_are_not_told_of(office: list[Scan]) -> None:
    for scans in (office, [*office, *office], ndtree.simulate("office", seed=5, position_sigma=0.01)):
        assert drift(spread(scans)[0]) is None


def test_what_shows_no_place_twice_says_nothing(office: list[Scan]) -> None:
    assert drift([]) is None
    assert drift([[]] * 5) is None
    assert drift([[scan] for scan in office[:30]]) is None
    empty = Scan(np.empty((0, 2)), np.zeros(2))
    far = Scan(np.empty((0, 2)), np.array([20.0, 0.0]))
    assert drift([[empty], [far], [empty]] * 5) is None
    lost = Scan(np.full((90, 2), np.nan), np.zeros(2))
    assert drift([[lost], [far], [lost]] * 5) is None
    assert drift(spread(ndtree.simulate("apartment", scans=8))[0]) is None


def test_what_lies_between_lonely_beams_is_where_their_surface_is() -> None:
    points = np.array([[0.0, 2.0], [0.31, 2.0], [0.62, 2.0], [0.93, 2.0]])[::-1]
    surface = surface_of(points)
    x = np.sort(surface[:, 0])
    np.testing.assert_allclose(surface[:, 1], 2.0)
    assert x[0] == 0.0 and x[-1] == 0.93 and np.diff(x).max() <= 0.05 and np.diff(x).min() > 0.04
    near = points * (0.5, 1.0)
    np.testing.assert_array_equal(surface_of(near), near)


def test_two_beams_behind_a_gap_are_no_surface() -> None:
    points = np.array([[x, 2.0] for x in (0.0, 0.31, 0.62, 9.0, 9.31)])
    for surface in (surface_of(points), surface_of(points[::-1])):
        assert np.count_nonzero(surface[:, 0] < 1.0) > 3
        assert np.count_nonzero(surface[:, 0] > 1.0) == 2


def test_a_visit_is_compared_with_the_runs_beside_the_earlier_one(monkeypatch: pytest.MonkeyPatch) -> None:
    places = [(0.0, 0.0), (2.5, 0.0), (7.0, 0.0), (7.0, 9.0), (2.5, 9.0), (2.5, 0.5)]
    runs = [[Scan(np.ones((3, 2)), np.array(place), stamp=float(i))] for i, place in enumerate(places)]
    asked = []
    monkeypatch.setattr(
        "ndtree.tuning.revisits.moved", lambda seen, *_: asked.append([s.stamp for s in seen])
    )
    assert drift(runs) is None and asked == [[0.0, 1.0]]


@pytest.mark.parametrize(
    "origin, dim, points_only, is_one",
    [
        ([1.0, 2.0], 2, False, True),
        ([1.0, 2.0, 3.0], 3, False, False),
        ([[1.0, 2.0], [1.0, 3.0]], 2, False, False),
        ([math.nan, 2.0], 2, False, False),
        (None, 2, True, False),
    ],
)
def test_what_scans_are_of_one_place(origin: Any, dim: int, points_only: bool, is_one: bool) -> None:
    scan = ndtree.Scan(np.ones((2, dim)), np.zeros(dim) if origin is None else origin)
    scan = replace(scan, points_only=points_only)
    good = ndtree.Scan(np.ones((2, 2)), [0.0, 0.0])
    assert is_of_one_place([good, scan]) == is_one and is_of_one_place([good])


def test_surfaces_are_filled_between_neighbouring_beams_alone() -> None:
    wall = np.column_stack((3.0 / np.tan(np.linspace(0.3, 1.5, 16)), np.full(16, 3.0)))
    filled = surface_of(wall)
    assert np.allclose(filled[:16], wall) and np.allclose(filled[:, 1], 3.0)
    assert np.diff(np.sort(filled[:, 0])).max() <= 0.2
    door = np.delete(wall, [6, 7, 8], axis=0)  # Their beams did not return.
    inside = surface_of(door)[:, 0]
    assert not ((inside > wall[9, 0] + 0.01) & (inside < wall[5, 0] - 0.01)).any()
    rods = np.column_stack((np.arange(16.0), np.where(np.arange(16) % 2, 2.0, 4.0)))
    assert len(surface_of(rods)) == 16
    assert len(surface_of(wall[:2])) == 2
