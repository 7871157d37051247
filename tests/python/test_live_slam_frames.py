# SPDX-License-Identifier: BSD-3-Clause
"""What SLAM makes of a scan's pose: frames of robot, odometry and map, by given answers of its parts."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags")
pytest.importorskip("scipy")

import ndtree
from ndtree.alignment.planar import composed, pose_of
from ndtree.live.corrections import Motion
from ndtree.live.following import matrix_of
from ndtree.live.localizing import Localization
from ndtree.live.slam import Slam
from ndtree.logs.poses.pose import Pose

BODY, MOUNT = np.array([2.0, -1.0, 0.7]), np.array([0.3, 0.1, -0.4])  # In the odometry, and on the body.
MAP = np.array([5.0, 3.0, 2.0])  # The odometry's frame in the map.
AT = composed(BODY, MOUNT)
POINTS = np.array([[1.0, 0.0], [2.0, 1.0], [0.0, 3.0]])  # As the sensor sees them.


def placed(pose: np.ndarray) -> np.ndarray:
    return POINTS @ matrix_of(pose)[:2, :2].T + pose[:2]


SCAN = ndtree.Scan(placed(AT), AT[:2], stamp=9.0, heading=AT[2])
MOTION = Motion(9.0, Pose.planar(*AT), Pose.planar(*BODY), Pose.planar(*MOUNT))


class Aligning:
    """Places scans by `MAP`."""

    def __init__(self, **_: Any) -> None:
        self.given: list[tuple[ndtree.Scan, Any]] = []
        self.track, self.covariance = SimpleNamespace(poses=[0, 0]), np.eye(3)

    def add(self, scan: ndtree.Scan, covariance: Any) -> np.ndarray:
        self.given.append((scan, covariance))
        self.track.poses.append(0)
        return composed(MAP, AT)


@pytest.fixture
def aligning(monkeypatch: pytest.MonkeyPatch) -> Aligning:
    made = Aligning()
    monkeypatch.setattr("ndtree.live.slam.OnlineAlignment", lambda **_: made)
    return made


def test_a_robot_is_where_its_odometry_and_the_map_s_say(aligning: Aligning) -> None:
    slam = Slam(odometry=True)
    scan = slam.placed(SCAN, MOTION)
    assert scan is not None
    np.testing.assert_allclose(scan.endpoints, placed(composed(MAP, AT)), atol=1e-12)
    found, motion = slam.located(), slam.motion()
    np.testing.assert_allclose(pose_of(found.map_odometry), [*MAP[:2], MAP[2]], atol=1e-12)
    np.testing.assert_allclose(found.pose, matrix_of(composed(MAP, AT)), atol=1e-12)
    np.testing.assert_allclose(found.body, matrix_of(composed(MAP, BODY)), atol=1e-12)
    assert not found.is_lost and found.stamp == 9.0
    assert motion is not None and motion.stamp == 2.0, "the number of the scan"
    np.testing.assert_allclose(motion.mount.matrix(2), matrix_of(MOUNT), atol=1e-12)
    assert aligning.given[0][0] is SCAN and aligning.given[0][1] is None


def test_a_drive_goes_on_where_the_robot_is_found_and_not_surer_than_the_old_map(aligning: Aligning) -> None:
    covariance = np.diag([0.01, 0.02, 0.003])
    answers = [(True, np.zeros(3)), (False, MAP)]
    asked: list[tuple[np.ndarray, np.ndarray]] = []

    def track(points: np.ndarray, at: np.ndarray, stamp: float) -> Localization:
        asked.append((points, at))
        is_lost, pose = answers.pop(0)
        zero = np.eye(3)
        return Localization(stamp, is_lost, zero, zero, matrix_of(pose), covariance, 1.0, 1.0)

    slam = Slam(odometry=True)
    slam._localizer = SimpleNamespace(track=track)  # type: ignore[assignment]
    assert slam.placed(SCAN, MOTION) is None and not aligning.given and slam.verdict == "doubtful"
    assert slam.placed(SCAN, MOTION) is not None
    for points, at in asked:
        np.testing.assert_allclose(points, POINTS, atol=1e-12)
        np.testing.assert_allclose(at, AT, atol=1e-12)
    ((begun, given),) = aligning.given
    np.testing.assert_allclose(given, covariance + np.diag([0.1, 0.1, 0.02]) ** 2)
    np.testing.assert_allclose(begun.endpoints, placed(composed(MAP, AT)), atol=1e-12)


@pytest.mark.parametrize("options, expected", [({"max_range": 7.0}, 7.0), ({}, math.inf)])
def test_an_earlier_drive_is_mapped_as_it_was(
    options: dict[str, float], expected: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    inserted: list[tuple[Any, ...]] = []
    corrections: Any = SimpleNamespace(insert=lambda *given: inserted.append(given), map="the map")
    earlier: Any = SimpleNamespace(options=options, scans=lambda: [(MOTION, SCAN)] * 2)
    monkeypatch.setattr("ndtree.live.slam.Localizer", lambda m, guess: (m, guess))
    slam = Slam(earlier=earlier, guess=[1.0, 2.0, 0.0])
    slam.begin(corrections)
    assert inserted == [(SCAN, MOTION, expected)] * 2
    assert slam._localizer == ("the map", [1.0, 2.0, 0.0]) and slam.options == options
