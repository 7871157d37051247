# SPDX-License-Identifier: BSD-3-Clause
"""Headings that drift as odometry's are told of, those that a SLAM system made are not."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import ndtree
from ndtree.base.scan import Scan
from ndtree.evaluation.sampling import spread
from ndtree.tuning.heading import heading_drift
from ndtree.tuning.pairs import Pair, pairs_of


@pytest.fixture(scope="module")
def office() -> list[Scan]:
    """A drive of 150 m."""
    return list(ndtree.simulate("office"))


def turned(scans: list[Scan], angles: np.ndarray, together: bool) -> list[Scan]:
    """By how much each pose errs [rad]; or how much is added on the way, and turns all that follows."""
    origins = np.array([scan.origin for scan in scans])
    steps = np.diff(origins, axis=0)
    if together:
        angles = np.cumsum(angles)
    turns = np.array([[[math.cos(a), math.sin(a)], [-math.sin(a), math.cos(a)]] for a in angles])
    moves = np.einsum("ni,nij->nj", steps, turns[:-1]) if together else steps
    places = origins[0] + np.concatenate([np.zeros((1, 2)), np.cumsum(moves, axis=0)])
    return [
        replace(
            scan,
            endpoints=(scan.endpoints - scan.origin) @ turn + place,
            origin=place,
            heading=None if scan.heading is None else scan.heading + angle,
        )
        for scan, turn, place, angle in zip(scans, turns, places, angles)
    ]


def ways(scans: list[Scan]) -> np.ndarray:
    origins = np.array([scan.origin for scan in scans])
    return np.concatenate([[0.0], np.linalg.norm(np.diff(origins, axis=0), axis=1)])


@pytest.mark.parametrize("degrees, seed", [(1.5, 1), (3.0, 2), (3.0, 3)])
def test_growth_is_found_as_it_is(office: list[Scan], degrees: float, seed: int) -> None:
    """The variance of a heading grows by degrees² a metre."""
    growth = math.radians(degrees) ** 2
    noise = np.random.default_rng(seed).normal(0.0, np.sqrt(growth * ways(office)))
    found = heading_drift(pairs_of(spread(turned(office, noise, together=True))[0]))
    assert found is not None and found.least <= found.turned
    # By chance more to one side than to the other.
    assert 0.55 < found.turned / math.sqrt(growth * found.way) < 4
    assert "degrees over a path of 150 m" in str(found).replace("149", "150") and "align" in str(found)


@pytest.mark.parametrize("degrees", [-1.2, 0.4, 2.5])
def test_headings_that_drift_to_one_side_are_told_of(office: list[Scan], degrees: float) -> None:
    """By the same angle a metre, as with wheels of unlike size."""
    side = math.radians(degrees) * ways(office)
    noise = np.random.default_rng(1).normal(0.0, math.radians(0.3), len(office))
    found = heading_drift(pairs_of(spread(turned(turned(office, side, True), noise, together=False))[0]))
    assert found is not None and found.least <= found.turned
    assert 0.6 < math.degrees(found.turned) / (abs(degrees) * found.way) < 1.5


@pytest.mark.parametrize("degrees, seed", [(0.0, 0), (0.3, 1), (0.3, 2), (0.6, 1), (0.6, 2)])
def test_poses_that_err_each_by_itself_do_not_drift(office: list[Scan], degrees: float, seed: int) -> None:
    noise = np.random.default_rng(seed).normal(0.0, math.radians(degrees), len(office))
    assert heading_drift(pairs_of(spread(turned(office, noise, together=False))[0])) is None


def test_what_tells_too_little_says_nothing(office: list[Scan]) -> None:
    assert heading_drift(pairs_of([])) is None
    assert heading_drift(pairs_of([[]] * 20)) is None
    assert heading_drift(pairs_of([office[:4]] * 30)) is None
    assert heading_drift(pairs_of([[scan] for scan in office[:9]])) is None
    assert heading_drift(pairs_of([[Scan(np.empty((0, 2)), np.zeros(2))] * 4] * 20)) is None


def test_pairs_that_turn_far_tell_nothing() -> None:
    unknown = np.full(3, np.nan)
    for turn, moved, is_near in ((0.5, 0.1, True), (1.2, 0.1, False), (0.0, 0.01, False), (0.0, 7.0, False)):
        told = np.array([moved, 0.0, turn])
        pair = Pair(told, unknown)
        assert pair.is_near is is_near and not pair.is_matched
