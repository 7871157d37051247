# SPDX-License-Identifier: BSD-3-Clause
"""A live map that follows a SLAM: however late poses are corrected, the map is that of the corrected ones."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags")
pytest.importorskip("scipy")

from calling import cli
from drives import START
from planes import assert_same_cells
from slams import bag_of, drifted, office, path_message, yaw

import ndtree
from ndtree.live import Correction, Corrections, FramesIntake, LiveMapper, Reading, Transform, Window
from ndtree.live.corrections import Jumps, Motion
from ndtree.logs.poses.pose import Pose, quaternions_of
from ndtree.tuning.config import Config

N = 40
SETTINGS = Config.of(
    range_sigma=0.02, min_cell_size=0.05, max_cell_size=1.6, max_range=20.0, no_return="free"
)


def lived(rows: Any, poses: Any, corrections: list[tuple[int, Correction]], **options: Any) -> Any:
    """The mapper after scans by some poses, with corrections after some of them."""
    followed = Corrections(**options)
    intake = FramesIntake(SETTINGS, 2)
    with LiveMapper(intake, corrections=followed, patience=60.0, queue=1000) as mapper:
        mapper.put(Transform("base", "laser", (0.2, 0.1, 0.3), yaw(0.3)), START)
        for i, ((stamp, _, _, beams, returned), (place, turn)) in enumerate(zip(rows, poses)):
            mapper.put(Transform("map", "base", (*place, 0.0), yaw(turn), stamp=stamp), stamp)
            mapper.put(Reading(beams, stamp, "laser", returned), stamp, wait=True)
            for after, correction in corrections:
                if after == i:
                    mapper.put(correction, stamp)
    return mapper


def path(rows: Any, poses: Any, upto: int, step: int = 1) -> Correction:
    chosen = list(range(0, upto + 1, step))
    return Correction(
        [rows[i][0] for i in chosen],
        [(*poses[i][0], 0.0) for i in chosen],
        [yaw(poses[i][1]) for i in chosen],
    )


@pytest.mark.parametrize("late", [(N - 1,), (10, 11, 25, N - 1), tuple(range(N))])
def test_a_path_that_comes_late_gives_the_map_of_its_poses(late: tuple[int, ...]) -> None:
    rows = office(N)
    true = [(place, turn) for _, place, turn, _, _ in rows]
    wrong = [drifted(i, *pose) for i, pose in enumerate(true)]
    right = lived(rows, true, [])
    followed = lived(rows, wrong, [(i, path(rows, true, i)) for i in late])
    assert_same_cells(followed.snapshot(), right.snapshot())
    assert followed.figures.mapped == right.figures.mapped == N
    assert 0 < followed.figures.corrections <= len(late) + 1 and right.figures.corrections == 0
    assert followed.figures.moved >= N - 1 and followed.figures.correction_seconds > 0
    plain = lived(rows, wrong, [])
    assert len(plain.snapshot().leaves()) != len(right.snapshot().leaves())


def test_between_the_poses_of_a_path_odometry_tells_the_way() -> None:
    rows = office(N)
    true = [(place, turn) for _, place, turn, _, _ in rows]
    wrong = [drifted(i, *pose) for i, pose in enumerate(true)]
    followed = lived(rows, wrong, [(N - 1, path(rows, true, N - 1, step=13))])  # The last of 40 is the 40th.
    history = followed._target._corrections._history
    far, before = [], []
    for i in range(N):
        pose = history.pose(i)
        mount = Pose.from_quaternion((*true[i][0], 0.0), yaw(true[i][1])) @ Pose.from_quaternion(
            (0.2, 0.1, 0.0), yaw(0.3)
        )
        far.append(np.linalg.norm(pose[:2, 2] - mount.position[:2]))
        before.append(np.linalg.norm(wrong[i][0] - true[i][0]))
    assert max(far) < 0.03 < 0.3 < max(before)
    assert far[13] < 1e-12 and far[26] < 1e-12


def test_of_two_poses_that_one_tells_whose_time_odometry_knows() -> None:
    """Before the first scan and after the last the robot was elsewhere: that says nothing of the scans."""
    rows = office(N)
    true = [(place, turn) for _, place, turn, _, _ in rows]
    shifted = [(place + np.array([1.0, 2.0]), turn) for place, turn in true]
    stamps = [rows[0][0] - 5, rows[10][0], rows[-1][0] + 5]
    places = [(-30.0, 0.0, 0.0), (*true[10][0], 0.0), (30.0, 0.0, 0.0)]
    told = Correction(stamps, places, [yaw(0.0), yaw(true[10][1]), yaw(0.0)])
    followed = lived(rows, shifted, [(N - 1, told)])
    assert followed.figures.moved == N
    assert_same_cells(followed.snapshot(), lived(rows, true, []).snapshot())


def test_a_correction_waits_for_new_scans() -> None:
    """The more were mapped anew, the more new ones come before the next time; but it does come."""
    rows = office(N)
    true = [(place, turn) for _, place, turn, _, _ in rows]
    wrong = [drifted(i, *pose) for i, pose in enumerate(true)]
    followed = lived(rows, wrong, [(i, path(rows, true, i)) for i in range(N)])
    assert N // 5 < followed.figures.corrections < N // 2


def test_what_a_jump_of_the_odometrys_frame_tells() -> None:
    """Odometry drifts, the SLAM notices halfway and in the end: what is between lies between."""
    rows = office(N)
    keys = [0, 20, N - 1]
    drift = [drifted(i, place, turn) for i, (_, place, turn, _, _) in enumerate(rows)]
    jumps = []
    for i in keys:
        body = Pose.from_quaternion((*rows[i][1], 0.0), yaw(rows[i][2]))
        odometry = Pose.from_quaternion((*drift[i][0], 0.0), yaw(drift[i][1]))
        jumps.append(body @ odometry.inverse())
    intake = FramesIntake(SETTINGS, 2)
    followed = Corrections()
    with LiveMapper(intake, corrections=followed, patience=60.0, queue=1000) as mapper:
        mapper.put(Transform("base", "laser", (0.0, 0.0, 0.3)), START)
        for i, ((stamp, _, _, beams, returned), (place, turn)) in enumerate(zip(rows, drift)):
            number = sum(i >= key for key in keys) - 1
            at = jumps[number]
            quaternion = quaternions_of(at.rotation[None])[0]
            mapper.put(Transform("map", "odom", at.position, quaternion, stamp=stamp), stamp)
            mapper.put(Transform("odom", "base", (*place, 0.0), yaw(turn), stamp=stamp), stamp)
            mapper.put(Reading(beams, stamp, "laser", returned), stamp, wait=True)
            if i in keys[1:]:
                told = keys[: number + 1]
                correction = Correction(
                    [rows[k][0] for k in told],
                    [one.position for one in jumps[: number + 1]],
                    quaternions_of(np.stack([one.rotation for one in jumps[: number + 1]])),
                    of="odometry",
                )
                mapper.put(correction, stamp)
    history = followed._history
    assert history is not None
    far = [np.linalg.norm(history.pose(i)[:2, 2] - rows[i][1]) for i in range(N)]
    uncorrected = np.linalg.norm(drift[19][0] - rows[19][1])
    assert max(far) < 0.1 < 0.3 < uncorrected


def test_a_recording_with_a_slams_path(tmp_path: Path) -> None:
    rows = office(N)
    true = [(place, turn) for _, place, turn, _, _ in rows]
    wrong = [drifted(i, *pose) for i, pose in enumerate(true)]
    late = {i: path_message(rows, true, i) for i in (12, 30, N - 1)}
    options = [
        "--rate", 0, "--follow", "slam/path", "--range-sigma", "0.02", "--no-return", "free", "--look", "0.5",
    ]  # fmt: skip
    files = []
    for name, poses, paths in (("right", true, {N - 1: late[N - 1]}), ("late", wrong, late)):
        bag = bag_of(tmp_path / name, poses, rows, paths)
        target = tmp_path / f"{name}.ndt"
        done = cli("live", bag, "-o", target, "--json", tmp_path / f"{name}.json", *options)
        assert done.exit_code == 0, done.stderr
        files.append(target)
    assert " correction" in done.stdout
    assert_same_cells(*(ndtree.load(file) for file in files))


def test_memory_is_bounded_by_scans_that_stay() -> None:
    rows = office(N)
    true = [(place, turn) for _, place, turn, _, _ in rows]
    wrong = [drifted(i, *pose) for i, pose in enumerate(true)]
    one = 1000 + 8 * len(rows[0][3])
    followed = lived(rows, wrong, [(N - 1, path(rows, true, N - 1))], memory=20 * one)
    figures = followed.figures
    assert figures.frozen >= N - 21 and figures.mapped == N
    history = followed._target._corrections._history
    assert len(history) + history.num_frozen == N and history.num_frozen == figures.frozen
    assert history.memory_bytes - 2 * history.map.stats().memory_bytes < 60 * one
    with pytest.raises(KeyError):
        history.pose(0)
    with pytest.raises(ValueError, match="scans are frozen"):
        next(followed._target._corrections.scans())
    place = history.pose(N - 1)[:2, 2]
    mount = Pose.from_quaternion((*true[-1][0], 0.0), yaw(true[-1][1])).apply([[0.2, 0.1, 0.0]])[0]
    np.testing.assert_allclose(place, mount[:2], atol=1e-9)


@pytest.mark.parametrize("has_origins, has_sigma", [(False, False), (True, False), (False, True)])
def test_what_beams_have_of_their_own_takes_memory(has_origins: bool, has_sigma: bool) -> None:
    beams, here = 500, Pose.from_quaternion((0, 0, 0), (0, 0, 0, 1))
    ends = np.random.default_rng(1).normal(size=(beams, 2)) + 3
    scan = ndtree.Scan(
        ends,
        np.zeros((beams, 2)) if has_origins else np.zeros(2),
        range_sigma=np.full(beams, 0.1) if has_sigma else None,
    )
    of_scan = 1000 + beams * (8 + 8 * has_origins + 4 * has_sigma)
    followed = Corrections(memory=10 * of_scan)
    followed.begin(2, {})
    for i in range(11):
        assert followed.frozen == 0
        followed.insert(scan, Motion(float(i), here, here, here))
    assert followed.frozen > 0


def test_what_small_corrections_move_waits_for_the_end() -> None:
    rows = office(N)
    true = [(place, turn) for _, place, turn, _, _ in rows]
    nearly = [(place + 0.004, turn + 1e-4) for place, turn in true]
    followed = lived(rows, nearly, [(20, path(rows, true, 20)), (N - 1, path(rows, true, N - 1))])
    assert followed.figures.corrections == 1  # In the end.
    assert_same_cells(followed.snapshot(), lived(rows, true, []).snapshot())


def test_wrong_calls_are_said() -> None:
    rows = office(4)
    true = [(place, turn) for _, place, turn, _, _ in rows]
    with pytest.raises(ValueError, match="tolerance"):
        Corrections(tolerance=(-1.0, 0.0))
    with pytest.raises(ValueError, match="memory = 0 bytes"):
        Corrections(memory=0)
    with pytest.raises(ValueError, match="must be 'body', 'odometry' or 'sensor'"):
        Correction([0.0], [[0, 0, 0]], [[0, 0, 0, 1]], of="map")
    with pytest.raises(ValueError, match="one of each"):
        Correction([0.0, 1.0], [[0, 0, 0]], [[0, 0, 0, 1]])
    with pytest.raises(ValueError, match="finite"):
        Correction([math.nan], [[0, 0, 0]], [[0, 0, 0, 1]])
    with pytest.raises(ValueError, match="window: expected none"):
        LiveMapper(FramesIntake(SETTINGS, 2), corrections=Corrections(), window=Window(3.0))
    mapper = lived(rows, true, [])
    with pytest.raises(RuntimeError, match="follows corrections"), mapper.locked():
        pass
    with pytest.raises(ValueError, match="follows corrections"):
        mapper.replace(ndtree.AdaptiveMap(dim=2))
    for words in (["--window", "3"], ["--fixed"], ["--fade", "3"]):
        done = cli("live", "--world", "office", "--follow", "/path", *words)
        assert done.exit_code == 2 and words[0] in done.stderr
    assert "ROS bag" in cli("live", "--world", "office", "--follow", "/path").stderr
    assert "--follow, too" in cli("live", "--world", "office", "--follow-frame", "base").stderr


def test_times_between_scans_are_where_odometry_was_then() -> None:
    """Odometry goes 1 m from scan to scan, evenly; the path is as far beside it everywhere."""
    followed = Corrections()
    followed.begin(2, {"min_cell_size": 0.1, "max_cell_size": 1.6})
    ends = np.array([[0.0, 3.0], [1.0, 3.0]])
    for i in range(11):
        at = Pose.from_quaternion((float(i), 0.0, 0.0), yaw(0.0))
        here = Pose.from_quaternion((0.0, 0.0, 0.0), yaw(0.0))
        scan = ndtree.Scan(np.add(ends, (i, 0.0)), np.array([float(i), 0.0]), stamp=float(i))
        followed.insert(scan, Motion(float(i), at, at, here))
    keys = [0.5, 4.3, 9.5]
    followed.correct(Correction(keys, [(key + 0.2, 0.1, 0.0) for key in keys], [yaw(0.0)] * 3))
    followed.settle()
    places = np.array([motion.sensor.position[:2] for motion, _ in followed.scans()])
    expected = np.column_stack([np.arange(11.0), np.zeros(11)])
    expected[1:10] += (0.2, 0.1)
    np.testing.assert_allclose(places, expected, atol=1e-9)


def test_one_transform_alone_corrects_nothing() -> None:
    jumps, at = Jumps(), Pose.from_quaternion((1.0, 0.0, 0.0), yaw(0.0))
    assert jumps.add(0.0, at) is None and jumps.add(1.0, at) is None
    assert jumps.add(2.0, Pose.from_quaternion((1.5, 0.0, 0.0), yaw(0.0))) is not None
