# SPDX-License-Identifier: BSD-3-Clause
"""Poses that are made while a laser drives: those of align, with its verdict; a drive goes on later."""

from __future__ import annotations

import json
import math
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags")
pytest.importorskip("scipy")

from calling import cli as run
from conftest import turned
from planes import assert_same_cells
from slams import bag_of, drifted
from slams import office as driven
from test_align import Drifting

import ndtree
from ndtree.alignment.loops import Graph
from ndtree.alignment.online import OnlineAlignment
from ndtree.alignment.planar import between, composed
from ndtree.alignment.sensor_scans import moved, pose_in_log
from ndtree.live import Corrections, LiveMapper, Localization, Saver, ScansIntake, Session, Slam
from ndtree.live.slam import NOT_FOUND, scans_beside
from ndtree.tuning.config import Config

N = 300
CONFIG = Config.of(range_sigma=0.02, max_range=20.0, no_return="ignore")


class Drive:
    """The office, by odometry that drifts by 1.5 % of the way and 0.01 rad/m."""

    def __init__(self, scans: int = N) -> None:
        every = [replace(one, heading=0.0) for one in ndtree.simulate("office")][:scans]
        self.truth = np.array([pose_in_log(one) for one in every])
        rng = np.random.default_rng(4)
        odometry = [self.truth[0]]
        for step in between(self.truth[:-1], self.truth[1:]):
            way = math.hypot(step[0], step[1])
            wrong = np.array([0.015 * way, 0.0, (0.01 + 0.01 * rng.normal()) * way])
            odometry.append(composed(odometry[-1], step + wrong))
        self.odometry = np.array(odometry)
        self.scans = [
            replace(moved(one, pose), stamp=0.1 * i) for i, (one, pose) in enumerate(zip(every, odometry))
        ]

    def wrong(self, poses: np.ndarray, first: int = 0) -> np.ndarray:
        return np.hypot(*(poses - self.truth[first : first + len(poses)])[:, :2].T)


@pytest.fixture(scope="module")
def drive() -> Drive:
    return Drive()


def mapped(scans: list[ndtree.Scan], slam: Slam, told: list[Localization] | None = None) -> LiveMapper:
    with LiveMapper(
        ScansIntake(CONFIG, 2),
        corrections=Corrections(threads=1),
        slam=slam,
        localized=None if told is None else told.append,
    ) as mapper:
        for scan in scans:
            mapper.put(scan, scan.stamp, wait=True)
    return mapper


def test_poses_are_those_of_align(drive: Drive) -> None:
    log = Drifting(drive.scans, drive.odometry)
    online = OnlineAlignment()
    first = np.array([online.add(scan) for scan in log])
    found, again = online.finish(), ndtree.align(log)
    assert drive.wrong(drive.odometry).max() > 1.0 and drive.wrong(found.poses).max() < 0.15
    assert drive.wrong(first).max() < 1.0, "already when they come"
    np.testing.assert_allclose(found.poses, again.poses, atol=1e-3)
    assert found.doubts == again.doubts and len(found.loops) == len(again.loops) > 3
    np.testing.assert_array_equal(found.key_scans, again.key_scans)


def test_odometry_that_counts_backwards_is_learned(drive: Drive) -> None:
    forward = drive.odometry[: N // 2]
    steps = between(forward[:-1], forward[1:]) * (-1.0, -1.0, 1.0)
    poses = [drive.odometry[0]]
    for step in steps:
        poses.append(composed(poses[-1], step))
    online = OnlineAlignment()
    for scan, before, after in zip(drive.scans, forward, poses):
        online.add(moved(scan, after) if before is not after else scan)
    found = online.finish()
    assert found.odometry_scale < -0.7 and drive.wrong(found.poses).max() < 0.2


def test_the_map_is_that_of_the_last_poses(drive: Drive) -> None:
    told: list[Localization] = []
    slam = Slam(odometry=True)
    mapper = mapped(drive.scans, slam, told)
    figures = mapper.figures
    assert figures.mapped == len(told) == N and figures.corrections > 0 < figures.moved
    expected = ndtree.ScanHistory(dim=2, **CONFIG.options)
    for number, (scan, pose) in enumerate(zip(drive.scans, slam.poses)):
        local = moved(CONFIG.usable(scan), np.zeros(3))
        expected.insert(number, local.endpoints, pose, returned=local.returned, max_range=20.0)
    assert_same_cells(mapper.snapshot(), expected.map)
    said = slam.figures()
    assert said["verdict"] == "sure" and said["doubts"] == [] and said["loops"] > 3
    for one, scan, odometry in zip(told, drive.scans, drive.odometry):
        assert one.stamp == scan.stamp and not one.is_lost
        at = turned(2, odometry[2], odometry[:2])
        np.testing.assert_allclose(one.map_odometry @ at, one.pose, atol=1e-9)


def test_a_drive_goes_on_from_its_file(drive: Drive, tmp_path: Path) -> None:
    """The second half begins anywhere by odometry that begins at 0, and is found in the map of the first."""
    half = 200
    before = mapped(drive.scans[:half], Slam(odometry=True))
    before.session().save(tmp_path / "a.scans.npz")
    loaded, empty = Session.load(tmp_path / "a.scans.npz"), Corrections()
    empty.begin(2, CONFIG.options)
    for early in (mapped([], Slam()).session, lambda: Session.of(loaded.drive, empty, {})):
        Saver(tmp_path / "b.ndt", 1.0, early).update(empty.map, 0.0)  # Before the first scan is mapped.
        assert not list(tmp_path.glob("b.*"))
    assert loaded.options == {**CONFIG.options, "max_range": 20.0}
    first, away = half - 30, np.array([3.0, -2.0, 0.5])
    later = [moved(scan, between(away, pose_in_log(scan))) for scan in drive.scans[first:]]
    slam = Slam(odometry=True, earlier=loaded)
    mapper = mapped(later, slam)
    lost = mapper.figures.left_out[NOT_FOUND]
    assert 0 < lost < 60 and mapper.figures.mapped == len(later) - lost
    assert drive.wrong(slam.poses[:half]).max() < 0.15
    assert drive.wrong(slam.poses[half:], first + lost).max() < 0.15
    assert slam.figures()["scans"] == half + len(later) - lost
    # What was not moved is the same map as before.
    again = mapped(later[:1], Slam(odometry=True, earlier=loaded))
    assert_same_cells(again.snapshot(), before.snapshot())


def test_another_building_is_not_gone_on_with(drive: Drive) -> None:
    session = mapped(drive.scans[:100], Slam(odometry=True)).session()
    rng = np.random.default_rng(1)
    ways = rng.uniform(-math.pi, math.pi, (30, 200))
    other = [
        ndtree.Scan(
            rng.uniform(1, 6) * np.stack([np.cos(way), np.sin(way)], axis=1),
            np.zeros(2),
            stamp=0.1 * i,
            heading=0.0,
        )
        for i, way in enumerate(ways)
    ]
    slam = Slam(odometry=True, earlier=session)
    mapper = mapped(other, slam)
    assert mapper.figures.mapped == 0 and mapper.figures.left_out == {NOT_FOUND: 30}
    assert slam.doubts == [f"{NOT_FOUND}: nothing is mapped"] and slam.figures()["verdict"] == "doubtful"


def test_what_only_odometry_tells_is_said(drive: Drive) -> None:
    """Scans that see next to nothing: only odometry tells, which the verdict says."""
    slam = Slam(odometry=True)
    blind = [replace(scan, endpoints=scan.endpoints[:3], returned=None) for scan in drive.scans]
    mapped(blind, slam)
    assert slam.figures()["verdict"] == "doubtful"
    assert any("only odometry says" in one for one in slam.doubts)


def test_loops_that_contradict_are_said(drive: Drive, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of loops that are found, each second is 1.5 m off: the verdict says so."""
    find, found = Graph._find, [0]

    def wrong(self: Graph, older: int, newer: int, way: float) -> Any:
        loop = find(self, older, newer, way)
        found[0] += loop is not None
        if loop is None or found[0] % 2:
            return loop
        return replace(loop, relation=loop.relation + np.array([1.5, 0.0, 0.0]))

    monkeypatch.setattr(Graph, "_find", wrong)
    slam = Slam(odometry=True)
    mapped(drive.scans, slam)
    said = slam.figures()
    assert said["verdict"] == "doubtful" and said["contradicted"] > 0
    assert any("contradict the others" in one for one in slam.doubts)


def test_a_reset_begins_anew(drive: Drive) -> None:
    slam = Slam(odometry=True)
    with LiveMapper(ScansIntake(CONFIG, 2), corrections=Corrections(threads=1), slam=slam) as mapper:
        for scan in drive.scans[:60]:
            mapper.put(scan, scan.stamp, wait=True)
        while mapper.figures.mapped < 60:
            time.sleep(0.01)
        mapper.replace(None)
        for scan in drive.scans[60:100]:
            mapper.put(scan, scan.stamp, wait=True)
    assert len(slam.poses) == 40
    np.testing.assert_array_equal(slam.poses[0], pose_in_log(drive.scans[60]))
    again = mapped(drive.scans[60:100], Slam(odometry=True)).snapshot()
    assert mapper.snapshot().to_bytes() == again.to_bytes(), "the same scans give the same map"


def test_the_command_with_a_bag(tmp_path: Path) -> None:
    rows = driven(140)
    decided = ["--no-return", "free", "--sweep", "said"]
    poses = [drifted(i, row[1], row[2]) for i, row in enumerate(rows)]
    bag = bag_of(tmp_path / "drive", poses, rows, {}, fixed_frame="odom")
    target, said = tmp_path / "office.ndt", tmp_path / "said.json"
    done = run(
        "live", bag, "--slam", "--rate", 0, "-o", target, "--json", said, "--range-sigma", 0.02, *decided
    )
    assert done.exit_code == 0, done.stderr
    assert "140 mapped, 0 dropped" in done.stdout and "no reason to doubt the poses" in done.stdout
    slam = json.loads(said.read_text())["slam"]
    assert slam["verdict"] == "sure" and slam["scans"] == 140 and slam["has_odometry"]
    found = np.array(Session.load(scans_beside(target)).drive.track.poses)
    places = np.array([row[1] for row in rows])
    at = np.array([composed(pose, np.zeros(3)) for pose in found])[:, :2]
    back = between(found[0], np.column_stack((at, found[:, 2])))[:, :2]
    turn = rows[0][2] + 0.3
    start = places - places[0]
    truth = start @ np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    assert abs(np.hypot(*back.T) - np.hypot(*truth.T)).max() < 0.6  # The mount is 0.22 m from the base.
    done = run(
        "live", bag, "--slam", "--resume", target, "--rate", 0, "-o", tmp_path / "more.ndt", "--json", said
    )
    assert done.exit_code == 0, done.stderr
    slam = json.loads(said.read_text())["slam"]
    assert slam["verdict"] == "sure" and slam["scans"] > 220


def test_scans_that_slam_cannot_place_are_told_with_the_reason(tmp_path: Path) -> None:
    path = tmp_path / "in_space.npz"
    ways = np.random.default_rng(1).normal(size=(300, 3))
    np.savez(path, origins=np.zeros((2, 3)), points=np.concatenate([ways, 2 * ways]), offsets=[0, 300, 600])
    done = run("live", path, "--slam", "--rate", 0, "-o", tmp_path / "a.ndt")
    said = " ".join(done.stderr.split())
    assert done.exit_code == 1 and "(scans that slam cannot place: a scan is 3-D, expected" in said, said


def test_wrong_calls_are_said(tmp_path: Path) -> None:
    for words, said in (
        (["--slam", "--window", "3"], "--window: not with --slam"),
        (["--slam", "--follow", "tf"], "--follow: not with --slam"),
        (["--slam", "--guess", "0,0,0"], "--slam with --resume, too"),
        (["--slam", "--resume", tmp_path / "no.ndt"], "no.scans.npz"),
    ):
        done = run("live", "--world", "office", *words)
        assert done.exit_code in (1, 2) and said in done.stderr, done.stderr
    (tmp_path / "no.scans.npz").write_bytes(b"nonsense")
    done = run("live", "--world", "office", "--slam", "--resume", tmp_path / "no.ndt")
    assert done.exit_code == 1 and "Traceback" not in done.stderr, done.stderr
    with pytest.raises(ValueError, match="slam: expected corrections"):
        LiveMapper(ScansIntake(CONFIG, 2), slam=Slam())
