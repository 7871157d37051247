# SPDX-License-Identifier: BSD-3-Clause
"""Poses that do not fit the scans of a planar laser are told of, with the time; good ones are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import ndtree
from ndtree.base.scan import Scan
from ndtree.evaluation.sampling import spread
from ndtree.tuning.agreement import WORSE_RUNS, _first, _worse_from, disagreement
from ndtree.tuning.pairs import pairs_of
from ndtree.tuning.revisits import surface_of

SCANS, BEGIN = 480, 200


@pytest.fixture(scope="module")
def office() -> list[Scan]:
    return [replace(scan, stamp=100 + 0.2 * i) for i, scan in enumerate(ndtree.simulate("office"))][:SCANS]


def shifted(scans: list[Scan], step: np.ndarray) -> list[Scan]:
    """What odometry says of wheels that slip from some scan on."""
    off = np.maximum(np.arange(len(scans)) - BEGIN, 0)[:, None] * step
    return [replace(s, endpoints=s.endpoints + d, origin=s.origin + d) for s, d in zip(scans, off)]


def standing(scans: list[Scan], step: float) -> list[Scan]:
    """A robot that is stuck from some scan on, and whose wheels turn on."""
    stuck = [*scans[:BEGIN], *(replace(scans[BEGIN], stamp=scan.stamp) for scan in scans[BEGIN:])]
    return shifted(stuck, np.array([step, 0.0]))


def test_good_poses_are_not_told_of(office: list[Scan]) -> None:
    for scans in (office, office[::3], ndtree.simulate("office", seed=5, position_sigma=0.005)):
        assert disagreement(pairs_of(spread(scans)[0])) is None


@pytest.mark.parametrize("step", [0.02, 0.05, -0.1])
def test_wheels_that_slip_are_told_of_with_the_time(step: float, office: list[Scan]) -> None:
    found = disagreement(pairs_of(spread(shifted(office, np.array([step, 0.3 * step])))[0]))
    assert found is not None
    assert abs(found.since - 0.2 * BEGIN) < 6.0, "runs are a few seconds apart"
    assert found.error == pytest.approx(3 * abs(step) * 1.044, rel=0.3)
    assert "wheels slip" in str(found) and f"from {found.since:.1f} s on" in str(found)


def test_a_log_without_times_is_told_of_without_one(office: list[Scan]) -> None:
    scans = [replace(scan, stamp=0.0) for scan in shifted(office, np.array([0.05, 0.0]))]
    assert str(disagreement(pairs_of(spread(scans)[0]))).startswith("from some scan on, consecutive scans")


def test_a_robot_that_is_stuck_is_told_of(office: list[Scan]) -> None:
    found = disagreement(pairs_of(spread(standing(office, 0.02))[0]))
    assert found is not None and abs(found.since - 0.2 * BEGIN) < 6.0
    assert found.error == pytest.approx(found.moved, rel=0.3)


def test_errors_that_are_large_in_the_last_runs_alone_are_worse_from_there_on() -> None:
    good, bad = np.full(20, 0.01), np.full(WORSE_RUNS, 5.0)
    assert _worse_from(np.concatenate([good, bad])) == 20
    assert _worse_from(np.concatenate([good, bad[1:]])) is None, "too few"
    assert _worse_from(np.concatenate([good, bad, good])) is None, "not up to the end"


def test_several_of_some_runs_in_a_row_have_to_be_wrong() -> None:
    assert _first(np.array([0, 1, 0, 1, 0, 1, 1, 0, 1]) > 0, 3, 4) == 3
    assert _first(np.array([1, 1, 0, 0, 1, 1]) > 0, 3, 4) is None


def corridor(step: float, angles: np.ndarray) -> list[Scan]:
    """Scans on the way through a smooth corridor, 2 m wide, whose ends are out of sight."""
    reach = 1.0 / np.abs(np.sin(angles))
    local = np.column_stack((reach * np.cos(angles), np.sign(angles)))[reach < 14.0]
    origins = [np.array([step * i, 0.0]) for i in range(160)]
    return [Scan(local + at, at, stamp=0.1 * i, heading=0.0) for i, at in enumerate(origins)]


@pytest.mark.parametrize(("beams", "step"), [(91, 0.12), (181, 0.06), (361, 0.17)])
def test_a_corridor_that_looks_the_same_everywhere_contradicts_no_pose(beams: int, step: float) -> None:
    """Each scan is the one before, in its sensor's frame, as if the robot had stood."""
    angles = np.linspace(-1.99, 2.01, beams)
    assert disagreement(pairs_of(spread(corridor(step, angles))[0])) is None


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


def test_what_a_run_does_not_show_says_nothing(office: list[Scan]) -> None:
    assert disagreement(pairs_of([])) is None
    assert disagreement(pairs_of([[scan] for scan in office[:20]])) is None
    empty = Scan(np.empty((0, 2)), np.zeros(2))
    assert disagreement(pairs_of([[empty, empty]] * 10)) is None
    lost = Scan(np.full((90, 2), np.nan), np.zeros(2))
    assert disagreement(pairs_of([[lost, lost]] * 10)) is None
    assert disagreement(pairs_of(spread(ndtree.simulate("apartment", scans=8))[0])) is None
