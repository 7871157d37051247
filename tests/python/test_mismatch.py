# SPDX-License-Identifier: BSD-3-Clause
"""Poses of a lidar that do not fit its clouds are told of, whatever the cause; right ones are not."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
import pytest

TOOLS = Path(__file__).resolve().parents[2] / "tools"
if not (TOOLS / "trials").exists():
    pytest.skip("the tools are not beside the tests", allow_module_level=True)
sys.path.insert(0, str(TOOLS))

from lidar_drives import measured

import ndtree
from ndtree import Scan
from ndtree.alignment.surfaces import Cloud
from ndtree.evaluation.pose_noise import PoseNoise
from ndtree.evaluation.sampling import spread
from ndtree.tuning.first_look import FirstLook
from ndtree.tuning.mismatch import _AROUND, _UP, Mismatch, _spread, mismatch
from ndtree.tuning.motions import moved_by
from trial import moving, worlds
from trial.capabilities import Trial
from trial.scene import Floats
from trial.setup_in_space import driven

TIMES = np.append(0.1 * np.arange(60), 0.1 * np.arange(60)[::-1])  # There and back.


@pytest.fixture(scope="module", params=[10, 14])
def drive(request: pytest.FixtureRequest) -> tuple[Floats, list[Floats]]:
    """True poses of the sensor, and what it measures in its own frame."""
    rng = np.random.default_rng(request.param)
    world = worlds.chamber(rng)
    poses = driven(world, rng)(TIMES)
    return poses, measured(world.scene, poses, rng)


def scans_of(told: Floats, clouds: list[Floats], *, knows_turns: bool = True) -> list[Scan]:
    return [
        Scan(
            points @ T[:3, :3].T + T[:3, 3],
            T[:3, 3],
            stamp=5.0 + 0.1 * i,
            rotation=T[:3, :3] if knows_turns else None,
        )
        for i, (T, points) in enumerate(zip(told, clouds))
    ]


def found_in(told: Floats, clouds: list[Floats], *, knows_turns: bool = True) -> Mismatch | None:
    scans = scans_of(told, clouds, knows_turns=knows_turns)
    runs = spread(scans, keep=Cloud.of)[0]
    return mismatch([[one for one in run if one is not None] for run in runs])


def test_right_poses_fit(drive: tuple[Floats, list[Floats]]) -> None:
    """As they do where each errs by itself, or the log does not say how its sensor is turned."""
    poses, clouds = drive
    rng = np.random.default_rng(1)
    noisy = poses @ [moved_by(rng.normal(0, [*3 * [0.02], *3 * [0.008]])) for _ in poses]
    assert found_in(poses, clouds) is None and found_in(noisy, clouds) is None
    assert found_in(noisy, clouds, knows_turns=False) is None
    assert all(found_in(poses[:few], clouds[:few]) is None for few in (0, 1, 2, 5))
    assert found_in(poses, [points[:1] for points in clouds]) is None


@pytest.mark.parametrize("knows_turns", [True, False])
def test_clouds_in_another_order_are_told_of(drive: tuple[Floats, list[Floats]], knows_turns: bool) -> None:
    poses, clouds = drive
    order = np.random.default_rng(2).permutation(len(poses))
    found = found_in(poses[order], clouds, knows_turns=knows_turns)
    assert found is not None and found.kind == "steps" and "order of scans and poses" in str(found)
    assert found.wrong > 0.5 * found.pairs


@pytest.mark.parametrize(
    "motion", [[0, 0, 0, 0, 0, 0.5], [0.2, 0, 1.2, 0, 0, 0], [0, 0, 0, 0.3, 0, 0], [1.5, 0.5, 0, 0, 0, 0.2]]
)
def test_a_jump_is_told_of(drive: tuple[Floats, list[Floats]], motion: list[float]) -> None:
    poses, clouds = (some[:60] for some in drive)
    after = poses[31] @ moved_by(np.array(motion)) @ np.linalg.inv(poses[31])
    found = found_in(np.concatenate((poses[:31], after @ poses[31:])), clouds)
    assert found is not None and found.kind == "jump", found
    assert found.since == pytest.approx(3.1, abs=0.4) and "carried" in str(found)


@pytest.mark.parametrize("drift", [[0, 0, 0.08, 0, 0, 0], [0, 0, 0, 0, 0, 0.04]])
def test_drift_is_told_of_where_the_robot_returns(
    drive: tuple[Floats, list[Floats]], drift: list[float]
) -> None:
    """So much for each metre: from one cloud to the next that is within what poses err."""
    poses, clouds = drive
    told = [poses[0]]
    for one, other in zip(poses, poses[1:]):
        step = np.linalg.inv(one) @ other
        told.append(told[-1] @ step @ moved_by(np.linalg.norm(step[:3, 3]) * np.array(drift)))
    found = found_in(np.array(told), clouds)
    assert found is not None and found.kind == "returns" and "where the robot returns" in str(found), found


def test_the_first_look_says_so(drive: tuple[Floats, list[Floats]], tmp_path: Path) -> None:
    poses, clouds = drive
    order = np.random.default_rng(3).permutation(len(poses))
    scans = scans_of(poses[order], clouds)
    arrays = {
        "points": np.concatenate([scan.endpoints for scan in scans]),
        "origins": np.array([scan.origin for scan in scans]),
        "offsets": len(scans[0]) * np.arange(len(scans) + 1),
    }
    np.savez(tmp_path / "log.npz", **arrays)
    look: FirstLook = ndtree.first_look(ndtree.read(tmp_path / "log.npz"))
    assert look.mismatch is not None and str(look.mismatch) == look.doubt
    assert math.isnan(look.mismatch.since) and look.figures()["mismatch"]["since"] is None


@pytest.mark.parametrize(("row", "seed"), [("static", 16), ("static", 33), ("static", 38), ("clean", 2)])
def test_rails_that_repeat_are_no_noise_of_poses(row: str, seed: int, tmp_path: Path) -> None:
    """Poses are exact; patches of rails fit one period on, too, and nothing else tells of the way along."""
    recording, _, _ = moving.recorded(Trial.of(row, seed, "railing").case())
    assert PoseNoise.of(ndtree.read(recording.save(tmp_path / "log.npz"))) == PoseNoise()


def test_what_meets_elsewhere_all_along_is_told_of() -> None:
    """By its poses the robot drives backwards; of the way along the straight corridor little is told."""
    _, outcome = Trial.of("setup", 83).run()
    assert any("the robot did not move as they say" in one for one in outcome.words), outcome.words


def test_what_is_seen_beside_a_direction_counts_around_it() -> None:
    """Of a map of directions: one cell on each side, over its seam, too, and not over its poles."""
    seen = np.zeros((_UP, _AROUND))
    seen[_UP - 1, 0] = 1.0
    rows, columns = np.nonzero(_spread(seen.ravel(), np.maximum).reshape(_UP, _AROUND))
    assert set(zip(rows, columns)) == {(row, at) for row in (_UP - 2, _UP - 1) for at in (0, 1, _AROUND - 1)}
