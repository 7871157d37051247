# SPDX-License-Identifier: BSD-3-Clause
"""Robots that were carried, wheels that slip, and places that look otherwise when they are visited again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import ndtree
from ndtree.alignment.planar import between, composed, placed, seen_from
from ndtree.alignment.surfaces import Cloud
from ndtree.base.scan import Scan
from ndtree.evaluation.sampling import spread
from ndtree.tuning.mismatch import Mismatch, mismatch


@pytest.fixture(scope="module")
def office() -> list[Scan]:
    """A drive of 150 m, with a scan each 0.1 m and 0.1 s."""
    return [replace(scan, stamp=0.1 * i) for i, scan in enumerate(ndtree.simulate("office", scans=1500))]


def pose_of(scan: Scan) -> np.ndarray:
    return np.array([*scan.origin, scan.heading or 0.0])


def told_at(scan: Scan, pose: np.ndarray) -> Scan:
    """What was seen, as if from another pose."""
    points = placed(pose, seen_from(pose_of(scan), scan.endpoints))
    return replace(scan, endpoints=points, origin=pose[:2], heading=float(pose[2]))


def slipping(scans: list[Scan], at: int, step: float) -> list[Scan]:
    """Poses go aside by so much a scan, from one on."""
    off = step * (np.arange(len(scans)) - at).clip(0)
    return [
        told_at(scan, pose_of(scan) + np.array([0.9 * by, 0.3 * by, 0.0])) for scan, by in zip(scans, off)
    ]


def found_in(scans: list[Scan]) -> Mismatch | None:
    return mismatch(spread(scans, keep=Cloud.of)[0])


@pytest.mark.parametrize(("at", "to"), [(300, 900), (585, 472), (750, 1200)])
def test_a_robot_that_is_carried_is_told_of(office: list[Scan], at: int, to: int) -> None:
    """Its poses go on as if it had not been."""
    way = [between(pose_of(office[to]), pose_of(scan)) for scan in office[to : to + 120]]
    after = [told_at(scan, composed(pose_of(office[at]), by)) for scan, by in zip(office[to:], way)]
    after = [replace(scan, stamp=old.stamp) for scan, old in zip(after, office[at:])]
    found = found_in([*office[at - 60 : at], *after])
    assert found is not None and found.kind == "jump"
    assert found.since == pytest.approx(office[at].stamp - office[at - 60].stamp, abs=1.0)
    assert "was the robot carried?" in str(found)


def test_places_that_look_otherwise_are_told_of(office: list[Scan]) -> None:
    elsewhere = [told_at(scan, pose_of(at)) for scan, at in zip(office[900:1140], office)]
    assert found_in([*office[:240], *office[600:780], *elsewhere]) is not None
    assert found_in([*office[:240], *office[600:780], *office[:240]]) is None


@pytest.mark.parametrize("every", [1, 2])
def test_right_poses_do_not_contradict(office: list[Scan], every: int) -> None:
    rng = np.random.default_rng(every)
    noisy = [told_at(scan, pose_of(scan) + rng.normal(0, [0.05, 0.05, 0.01])) for scan in office[::every]]
    assert found_in(noisy) is None and found_in(noisy[:210]) is None
    short = [replace(scan, endpoints=scan.endpoints[:1], returned=None) for scan in noisy[:40]]
    assert all(found_in(few) is None for few in ([], noisy[:1], noisy[:9], short))


@pytest.mark.parametrize("step", [0.06, -0.1])
def test_wheels_that_slip_are_told_of_with_the_time(step: float, office: list[Scan]) -> None:
    found = found_in(slipping(office[:300], 120, step))
    assert found is not None and found.kind == "steps" and "wheels slip" in str(found)
    assert found.since == pytest.approx(12.0, abs=5.0)


def test_a_robot_that_is_stuck_is_told_of(office: list[Scan]) -> None:
    """Its wheels turn on: that each scan is as the one before counts where surfaces contradict the poses."""
    stuck = [replace(office[120], stamp=scan.stamp) for scan in office[120:300]]
    found = found_in(slipping([*office[:120], *stuck], 120, 0.05))
    assert found is not None and found.kind == "steps" and found.since == pytest.approx(12.0, abs=3.0)


def corridor(step: float, angles: np.ndarray) -> list[Scan]:
    """Scans on the way through a smooth corridor, 2 m wide, whose ends are out of sight."""
    reach = 1.0 / np.abs(np.sin(angles))
    local = np.column_stack((reach * np.cos(angles), np.sign(angles)))[reach < 14.0]
    origins = [np.array([step * i, 0.0]) for i in range(160)]
    return [Scan(local + at, at, stamp=0.1 * i, heading=0.0) for i, at in enumerate(origins)]


@pytest.mark.parametrize(("beams", "step"), [(91, 0.12), (181, 0.06), (361, 0.17)])
def test_a_corridor_that_looks_the_same_everywhere_contradicts_no_pose(beams: int, step: float) -> None:
    """Each scan is the one before, in its sensor's frame, as if the robot had stood."""
    assert found_in(corridor(step, np.linspace(-1.99, 2.01, beams))) is None
