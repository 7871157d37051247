# SPDX-License-Identifier: BSD-3-Clause
"""Poses of logs that drift, found from what the scans saw."""

from __future__ import annotations

import json
import math
import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from calling import cli as run
from conftest import there
from planes import box, ranges_to, rays

import ndtree
from ndtree.alignment.loops import Graph
from ndtree.alignment.motion import LearnedRate, Motion
from ndtree.alignment.planar import between, composed, placed, pose_of, seen_from, turned
from ndtree.alignment.sensor_scans import Outline, SensorScan, Track, moved, pose_in_log
from ndtree.alignment.stalls import _stands_since
from ndtree.alignment.tracking import Tracker, _is_leap
from ndtree.logs.core.log import Log
from ndtree.logs.ros.reading import heading_of


class Drifting(Log):
    """A log whose poses are those of an odometry."""

    format = "drifting"

    def __init__(self, scans, poses):
        super().__init__(None, 2)
        self._placed = [moved(scan, pose) for scan, pose in zip(scans, poses)]

    def _scans(self):
        yield from self._placed


def driven(rate: float, turn: float, seed: int = 1, scans: int = 160):
    """A drive through the office: its scans, where they were, and where odometry says."""
    every = [replace(scan, heading=0.0) for scan in ndtree.simulate("office", seed=seed)][:scans]
    truth = np.array([pose_in_log(scan) for scan in every])
    rng = np.random.default_rng(seed)
    odometry = [truth[0]]
    for step in between(truth[:-1], truth[1:]):
        way = math.hypot(step[0], step[1])
        wrong = np.array([rate * way, 0.0, turn * way + 0.3 * turn * rng.normal() * math.sqrt(way)])
        odometry.append(composed(odometry[-1], step + wrong))
    return every, truth, np.array(odometry)


def errors(poses: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Distances, with the first pose in its place."""
    at = composed(truth[0][None], between(poses[0][None], poses))
    return np.hypot(*(at - truth)[:, :2].T)


@pytest.fixture(scope="module")
def office():
    scans, truth, odometry = driven(rate=0.03, turn=0.015)
    return Drifting(scans, odometry), truth, odometry


def test_poses_in_the_plane_compose():
    rng = np.random.default_rng(7)
    a, b = rng.uniform(-3, 3, (2, 50, 3))
    c = between(a, b)
    np.testing.assert_allclose(composed(a, c)[:, :2], b[:, :2], atol=1e-12)
    np.testing.assert_allclose(np.cos(composed(a, c)[:, 2] - b[:, 2]), 1, atol=1e-12)
    points = rng.normal(size=(20, 2))
    np.testing.assert_allclose(seen_from(a[0], placed(a[0], points)), points, atol=1e-12)
    matrix = np.eye(3)
    matrix[:2, :2] = [[math.cos(a[0, 2]), -math.sin(a[0, 2])], [math.sin(a[0, 2]), math.cos(a[0, 2])]]
    matrix[:2, 2] = a[0, :2]
    np.testing.assert_allclose(placed(pose_of(matrix), points), placed(a[0], points), atol=1e-12)
    samples = rng.multivariate_normal(np.zeros(3), np.diag((4.0, 1.0, 0.1)), 20000)
    in_frame = seen_from(np.array([0, 0, 0.7]), samples[:, :2])
    np.testing.assert_allclose(turned(np.diag((4.0, 1.0, 0.1)), 0.7)[:2, :2], np.cov(in_frame.T), atol=0.15)


@pytest.fixture(scope="module")
def aligned(office):
    return ndtree.align(office[0])


def test_poses_of_a_drive_are_found(office, aligned):
    log, truth, odometry = office
    found = aligned
    before, after = errors(odometry, truth), errors(found.poses, truth)
    assert before.max() > 1.0 and after.max() < 0.15 and np.median(after) < 0.07
    assert found.lost <= 3 and not found.doubts and found.cells[1] < 0.7 * found.cells[0]
    assert "no reason to doubt them" in str(found)
    np.testing.assert_allclose(found.odometry, odometry, atol=1e-9)
    # The log with the poses is the log with its scans moved.
    aligned = list(found.log)
    assert len(aligned) == len(found.log) == len(truth)
    np.testing.assert_allclose([pose_in_log(scan) for scan in aligned], found.poses, atol=1e-6)
    again = ndtree.align(log)
    np.testing.assert_array_equal(again.poses, found.poses)


def test_poses_without_odometry_are_found(office):
    log, truth, _ = office
    there = [moved(scan, np.zeros(3)) for scan in log]
    found = ndtree.align(Drifting(there, np.zeros((len(there), 3))))
    after = errors(found.poses, truth)
    # A scan that sees nothing of those before is where it was: the sensor turns away, then starts to move.
    assert not found.has_odometry
    assert "lie where earlier scans saw free space, the first at 0.0 s" in str(found)
    assert after.max() < 0.7 and np.median(after) < 0.07


def seen_in(walls, poses, reach=8.0, beams=361, noise=0.01, seed=0, order=1):
    """Scans of wall segments (n, 2, 2) from poses; `order` -1: beams are told in the other one."""
    bearings = np.linspace(-np.pi, np.pi, beams, endpoint=False)
    rng = np.random.default_rng(seed)
    for i, pose in enumerate(poses):
        ranges = ranges_to(walls, pose, bearings)
        returned = ranges < reach
        ranges = np.where(returned, ranges + rng.normal(0, noise, beams), reach)
        ends = pose[:2] + ranges[:, None] * rays(order * bearings + pose[2])
        yield ndtree.Scan(ends, pose[:2], returned=returned, stamp=0.1 * i, heading=pose[2])


@pytest.mark.parametrize("start", [20, 29])
def test_scans_of_a_stall_are_placed_when_odometry_has_caught_up(start):
    """Odometry stands for six scans, then says all that was missed, between walls with a few recesses."""
    recess = ((0.0, 1.0), (0.0, 1.15), (1.0, 1.15), (1.0, 1.0))
    corners = [(x + dx, y) for x in (-4.0, 1.0, 5.0, 10.0) for dx, y in recess]
    line = np.array([(-20.0, 1.0), *corners, (40.0, 1.0)])
    upper = np.stack((line[:-1], line[1:]), axis=1)
    walls = np.concatenate((upper, upper * (1.0, -1.0) + np.array((0.3, 0.0))))
    truth = np.column_stack((np.arange(0, 5, 0.12), np.zeros((42, 2))))
    odometry = truth.copy()
    odometry[start : start + 7] = odometry[start]
    found = ndtree.align(Drifting(list(seen_in(walls, truth, reach=12.0, beams=240)), odometry))
    assert np.hypot(*(found.poses - truth)[:, :2].T).max() < 0.25


def test_a_stall_begins_after_the_last_scan_that_odometry_moved_to():
    """Its last step is the leap that makes up for it, and tells nothing."""
    told = [SimpleNamespace(pose=np.array([x, 0.0, 0.0])) for x in (0.0, 0.1, 0.2, 0.2, 0.2, 0.5)]
    track = SimpleNamespace(poses=[np.array([0.1 * i, 0.0, 0.0]) for i in range(-4, 6)])
    assert _stands_since(track, told) == 4 + 2
    assert _stands_since(track, told[2:]) == 4 + 2  # It stood all the time.


def test_a_jump_of_odometry_leaves_the_poses_where_they_were():
    """By 1.2 m and 0.5 rad, of a log that does not say how its sensor is turned."""
    room = np.concatenate([box(0, 0, 9, 5), [[[3, 0], [3, 1.5]]]])
    truth = np.column_stack((np.linspace(1, 7, 60), np.full(60, 2.5), np.zeros(60)))
    jump = np.array([0.9, -0.8, 0.5])
    odometry = truth.copy()
    odometry[30:] = composed(composed(truth[29], jump), between(truth[29], truth[30:]))
    scans = [replace(moved(scan, at), heading=None) for scan, at in zip(seen_in(room, truth), odometry)]
    log = Drifting(scans, odometry * (1.0, 1.0, 0.0))
    found = ndtree.align(log)
    assert np.hypot(*(found.poses - truth)[:, :2].T).max() < 0.05 and not found.doubts


def test_what_only_odometry_tells_is_said():
    """A smooth corridor whose ends are out of sight."""
    walls = np.array([[[-90.0, side], [90.0, side]] for side in (-1.0, 1.0)])
    truth = np.column_stack((np.arange(0, 8, 0.1), np.zeros((80, 2))))
    found = ndtree.align(Drifting(list(seen_in(walls, truth)), truth))
    assert np.hypot(*(found.poses - truth)[:, :2].T).max() < 0.15
    assert found.unfixed.sum() > 6 and any("only odometry says how far" in doubt for doubt in found.doubts)
    # At a closed end, each scan says where it is.
    end = np.array([[[10.0, -1.0], [10.0, 1.0]], [[4.0, 1.0], [4.0, 0.6]], [[6.0, 1.0], [6.0, 0.6]]])
    found = ndtree.align(Drifting(list(seen_in(np.concatenate((walls, end)), truth)), truth))
    assert found.unfixed.sum() < 1 and not found.doubts, found.doubts


def test_odometry_that_a_noisy_corridor_agrees_with_is_doubted():
    """It counts backwards; single end points far away, which noise lifts off the walls, agree with it."""
    walls = np.array([[[-90.0, side], [90.0, side]] for side in (-1.0, 1.0)])
    ahead = np.arange(0, 4, 0.07)
    turns = np.random.default_rng(1).normal(0, 0.1, len(ahead))
    truth = np.column_stack((ahead, np.zeros(len(ahead)), turns))
    scans = list(seen_in(walls, truth, reach=12.0, beams=360, noise=0.03))
    found = ndtree.align(Drifting(scans, truth * (-1.0, 1.0, 1.0)))
    assert np.hypot(*(found.poses - truth)[:, :2].T).max() > 5
    assert found.unfixed.sum() > 1 and any("only odometry says how far" in doubt for doubt in found.doubts)


@pytest.mark.parametrize(("scale", "count", "most"), [(1.0, 0, 0.1), (1.0, 99, 0.01), (0.7, 99, 0.3)])
def test_what_odometry_is_worth_is_learned_where_scans_tell_the_way(scale, count, most):
    """One motion in ten that odometry has elsewhere, as in a jump, changes nothing."""
    learned = LearnedRate(0.1)
    for i in range(count):
        learned.learn(np.array([0.2, 0.0, 0.0]), np.array([0.2 * (scale if i % 10 else -3.0), 0.0, 0.0]))
    assert learned.rate == pytest.approx(most, rel=0.05)


def test_odometry_that_stalls_and_catches_up_costs_nothing():
    """It stands for eight scans while the sensor turns by 1.9 rad, and then is right at once."""
    walls = np.concatenate([box(0, 0, 6, 5), box(2, 0, 0.6, 0.5), box(5, 3.5, 1, 0.5)])
    turn = np.concatenate((np.zeros(20), np.linspace(0, 1.9, 9)[1:], np.full(20, 1.9)))
    step = 0.1 * np.column_stack((np.cos(turn), np.sin(turn)))
    truth = np.column_stack((np.cumsum(step, axis=0) + np.array([1.5, 1.2]), turn))
    odometry = truth.copy()
    odometry[20:28] = odometry[19]
    found = ndtree.align(Drifting(list(seen_in(walls, truth)), odometry))
    assert np.hypot(*(found.poses - truth)[:, :2].T).max() < 0.05
    assert found.through.max() < 0.05 and 0.9 < found.odometry_scale < 1.1 and not found.doubts, found.doubts


def test_logs_without_a_heading_are_aligned_alike(office, aligned):
    log, _, odometry = office
    blind = Drifting(log, odometry)
    blind._placed = [replace(scan, heading=None) for scan in log]
    found = ndtree.align(blind)
    off = np.hypot(*(found.poses - aligned.poses)[:, :2].T)
    assert off.max() < 0.05


def test_loops_bring_a_drive_back():
    """A round trip: what drifts on the way is gone at its end."""
    scans, truth, odometry = (every[::2] for every in driven(rate=0.05, turn=0.02, seed=2, scans=300))
    log = Drifting(scans, odometry)
    with_loops, without = ndtree.align(log), ndtree.align(log, close_loops=False)
    assert without.loops == [] and len(with_loops.loops) > 0 and with_loops.contradicted == 0
    for loop in with_loops.loops:
        keys = with_loops.key_scans
        off = between(truth[keys[loop.older]], truth[keys[loop.newer]]) - loop.relation
        assert np.hypot(*off[:2]) < 0.15 and abs(off[2]) < 0.03
    assert np.mean(errors(with_loops.poses, truth)) <= np.mean(errors(without.poses, truth)) + 0.005


def test_the_first_pose_stays_and_one_scan_is_enough(office):
    log, _, odometry = office
    one = Drifting(list(log)[:1], odometry[:1])
    begin = time.perf_counter()
    found = ndtree.align(one)
    assert 0 < found.seconds <= time.perf_counter() - begin
    np.testing.assert_allclose(found.poses, odometry[:1])
    assert found.loops == [] and "no loops found" in str(found)


def sensor_scans(walls, poses):
    """What a sensor with exact odometry measures of walls (n, 2, 2) from poses."""
    for pose, scan in zip(poses, seen_in(walls, poses)):
        free = seen_from(pose, scan.endpoints)
        yield SensorScan(free[scan.returned], free, pose, scan.stamp)


@pytest.mark.parametrize("has_heading", [True, False])
def test_a_rival_is_less_likely_by_what_its_score_is_less(has_heading):
    """Whatever the window: the prior of both is the same."""
    match = SimpleNamespace(score=0.8, second=0.3, inliers=0.9, pose=np.eye(3), covariance=np.eye(3))
    tracker = SimpleNamespace(_near=SimpleNamespace(matcher=SimpleNamespace(match=lambda *_, **__: match)))
    scan = SimpleNamespace(points=np.zeros((1, 2)), has_heading=has_heading)
    best, is_unique, rival = Tracker._anyhow(tracker, scan, np.zeros(3), np.array([9.0, 0.0, 0.0]), pieces=10)
    assert is_unique and best.posterior - rival == pytest.approx(10 * (0.8 - 0.3))


@pytest.mark.parametrize(
    "step, is_leap", [((0.2, 0, 0), 0), ((0.9, 0, 0), 1), ((0.2, -0.9, 0), 1), ((0.2, 0, 2), 0)]
)
def test_a_step_that_goes_farther_or_elsewhere_is_a_leap(step, is_leap):
    """A turn alone is none."""
    assert _is_leap(np.array([0.1, 0.0, 0.0]), np.array(step), np.array([0.5, 0.5, 0.5])) == is_leap


def test_what_a_scan_tells_is_in_the_frame_of_the_key_scan_before():
    """A smooth corridor that lies askew: along it a pose is unsure, across it is not."""
    turn = 0.6
    along, across = np.array([math.cos(turn), math.sin(turn)]), np.array([-math.sin(turn), math.cos(turn)])
    walls = np.array([[-90 * along + side * across, 90 * along + side * across] for side in (-1.0, 1.0)])
    poses = np.column_stack((np.arange(0, 6, 0.1)[:, None] * along, np.full(60, turn)))
    tracker = Tracker(0.05, Motion())
    for scan in sensor_scans(walls, poses):
        tracker.add(scan)
    assert len(tracker.track.covariances) > 10
    for covariance in tracker.track.covariances:
        assert covariance[0, 0] > 10 * covariance[1, 1]
        assert abs(covariance[0, 1]) < 0.3 * math.sqrt(covariance[0, 0] * covariance[1, 1])


@pytest.mark.parametrize("is_changed", [False, True])
def test_a_place_where_scans_see_through_the_others_walls_is_no_loop(is_changed):
    """Two rounds in a room. It is another room if a wall stands where the first round saw through."""
    walls = np.concatenate([box(-5, -3, 10, 6), box(-5, 1, 2, 2), box(3, -3, 2, 1)])
    bearings = np.linspace(0, 4 * np.pi, 400)
    poses = np.column_stack((3.5 * np.cos(bearings), 1.8 * np.sin(bearings), bearings % (2 * np.pi)))
    partition = np.concatenate([walls, box(-2.2, -0.8, 4.4, 1.6)])
    scans = [
        *sensor_scans(walls, poses[:200]),
        *sensor_scans(partition if is_changed else walls, poses[200:]),
    ]
    steps = between(poses[:-1], poses[1:])
    way = np.append(0, np.cumsum(np.hypot(steps[:, 0], steps[:, 1])))
    covariance = np.diag((0.01, 0.01, 0.002)) ** 2
    graph = Graph(
        Track(list(poses), list(range(400)), scans, list(way), list(steps), [covariance] * len(steps))
    )
    graph.close()
    rounds = {(loop.older < 200) != (loop.newer < 200) for loop in graph.loops}
    assert graph.tested > 0 and (True in rounds) != is_changed


def test_an_outline_tells_walls_from_space():
    bearings = np.linspace(-1.5, 1.5, 181)
    wall = 3.0 * np.column_stack((np.cos(bearings), np.sin(bearings)))
    outline = Outline(SensorScan(wall, wall, np.zeros(3), 0.0))
    assert outline.judge(0.99 * wall)[0] > 170 and outline.judge(0.99 * wall)[1] == 0
    assert outline.judge(0.5 * wall)[0] == 0 and outline.judge(0.5 * wall)[1] > 170
    assert outline.judge(1.5 * wall) == (0, 0)  # Behind it, which was not seen.
    assert outline.judge(-wall) == (0, 0)


def carmen(path, scans, odometry):
    """A CARMEN log of scans."""
    lines = []
    for i, (scan, pose) in enumerate(zip(scans, odometry)):
        bearings = np.arange(-90, 90)
        local = seen_from(pose_in_log(scan), scan.returned_only().endpoints)
        angles = np.degrees(np.arctan2(local[:, 1], local[:, 0]))
        ranges = [
            float(np.hypot(*local[np.argmin(np.abs(angles - b))])) if np.abs(angles - b).min() < 1 else 81.83
            for b in bearings
        ]
        place = f"{pose[0]:.6f} {pose[1]:.6f} {pose[2]:.6f}"
        numbers = " ".join(f"{r:.3f}" for r in ranges)
        lines.append(f"FLASER 180 {numbers} {place} {place} {i * 0.2:.3f} host {i * 0.2:.3f}\n")
    path.write_text("".join(lines))


def test_the_command_writes_poses_map_and_picture(tmp_path, office):
    log, _, odometry = office
    source = tmp_path / "drive.log"
    carmen(source, list(log)[:40], odometry)
    result = run(
        "align", source, "-o", tmp_path / "poses.txt", "--map", tmp_path / "drive.ndt",
        "--picture", tmp_path / "both.png", "--json", tmp_path / "figures.json",
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    assert "40 scans aligned" in result.stdout and "poses moved by" in result.stdout
    rows = np.loadtxt(tmp_path / "poses.txt")
    found = ndtree.align(ndtree.read(source))
    assert rows.shape == (40, 8)
    np.testing.assert_allclose(rows[:, 1:3], found.poses[:, :2], atol=1e-6)
    np.testing.assert_allclose(2 * np.arctan2(rows[:, 6], rows[:, 7]) - found.poses[:, 2], 0, atol=1e-6)
    np.testing.assert_allclose(rows[:, 0], found.stamps, atol=1e-6)
    figures = json.loads((tmp_path / "figures.json").read_text())
    assert figures["scans"] == 40 and figures["loops"] == len(found.loops)
    assert figures["doubts"] == found.doubts and figures["unfixed_way"] == pytest.approx(found.unfixed.sum())
    assert (tmp_path / "both.png").stat().st_size > 10_000
    mapped = run("map", source, "--align", "-o", tmp_path / "same.ndt", "--json", tmp_path / "map.json")
    assert mapped.exit_code == 0, mapped.output
    assert f"aligned: {found}"[:60] in mapped.stderr
    assert json.loads((tmp_path / "map.json").read_text())["notes"] == [f"aligned: {found}"]
    assert (tmp_path / "same.ndt").read_bytes() == (tmp_path / "drive.ndt").read_bytes()


@pytest.mark.long
def test_a_real_drive_fits_relations_that_people_measured(recordings):
    """The first minutes of ACES, and those of its relations that lie in them."""
    folder = there(recordings / "laser2d_raw_aces")
    found = ndtree.align(ndtree.read(folder / "aces.clf.bz2").select(stop=240))
    rows = np.loadtxt(folder / "aces.relations")
    rows = rows[rows[:, :2].max(axis=1) < found.stamps[-1]]
    first, second = (np.abs(found.stamps - t[:, None]).argmin(axis=1) for t in rows[:, :2].T)

    off = between(rows[:, [2, 3, 7]], between(found.poses[first], found.poses[second]))
    assert len(rows) > 100 and np.hypot(off[:, 0], off[:, 1]).mean() < 0.045
    assert found.cells[1] < 0.75 * found.cells[0]
    assert all("odometry" in doubt for doubt in found.doubts)  # No loop confirms these stretches yet.


def test_readers_say_the_heading_of_lasers(tmp_path):
    log = tmp_path / "two.log"
    log.write_text(
        "FLASER 3 1 2 3 0.5 0.25 0.75 9 9 9 1.0 host 1.0\n"
        "ROBOTLASER1 0 -1.57 3.14 1.57 80 0.01 0 3 1 2 3 2 7 8 0.5 0.25 -0.5 9 9 9 0 0 0 0 0 2.0 host 2.0\n"
    )
    assert [scan.heading for scan in ndtree.read(log)] == [0.75, -0.5]
    assert [scan.heading for scan in ndtree.read(log).select(stride=2)] == [0.75, -0.5]
    assert ndtree.Scan(np.zeros((1, 2)), np.zeros(2)).heading is None


def test_the_heading_of_a_bag_is_that_of_its_beams():
    rng = np.random.default_rng(4)
    local = np.column_stack((rng.uniform(-3, 3, (50, 2)), np.zeros(50)))
    local[3] = np.nan
    for yaw in (-3.1, -1.0, 0.0, 2.5, 3.14):
        c, s = math.cos(yaw), math.sin(yaw)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        for hung in (np.eye(3), np.diag((1, -1, -1))):
            heading = heading_of(local, local @ hung @ turn.T + (1, 2, 0.5), np.array([1, 2, 0.5]))
            assert math.cos(heading - yaw) == pytest.approx(1)
        assert heading_of(local, local @ np.diag((2, 1, 1)) @ turn.T, np.zeros(3)) is None
    assert heading_of(local[:0], local[:0], np.zeros(3)) is None


def test_wrong_calls_are_refused(tmp_path, office):
    with pytest.raises(ValueError, match="is 3-D, expected a 2-D log"):
        ndtree.align(ndtree.simulate("street", scans=1))
    with pytest.raises(ValueError, match="max_range = -1 m"):
        ndtree.align(office[0], max_range=-1)
    with pytest.raises(TypeError, match="expected a Log"):
        ndtree.align("drive.log")
    with pytest.raises(ValueError, match="expected at least one"):
        ndtree.align(Drifting([], np.zeros((0, 3))))
    source = tmp_path / "drive.log"
    carmen(source, list(office[0])[:2], office[2])
    both = run("map", source, source, "--align", "--merge", "-o", tmp_path / "m.ndt")
    assert both.exit_code == 2 and "expected no --merge" in both.stderr
    changed = ndtree.align(ndtree.read(source)).log
    carmen(source, list(office[0])[:3], office[2])
    with pytest.raises(ValueError, match="has not the 2 scans"):
        list(changed)


HALL = np.concatenate(
    [box(0, 0, 11.3, 7.4), box(2.6, 4.8, 0.5, 0.3), box(7.7, 1.6, 0.5, 0.5), box(5.2, 6.1, 0.2, 0.7)]
)


def in_a_hall(step: float) -> np.ndarray:
    t = np.arange(0, 2 * np.pi, step)
    yaw = np.unwrap(np.arctan2(2 * np.cos(t), -4 * np.sin(t)))
    return np.column_stack((5.6 + 4 * np.cos(t), 3.7 + 2 * np.sin(t), yaw))


@pytest.mark.parametrize("kind", ["jumps", "is backwards"])
def test_odometry_that_fails_costs_nothing_in_a_hall(kind):
    truth = in_a_hall(0.03)
    odometry = truth.copy()
    if kind == "jumps":
        half = len(truth) // 2
        jumped = composed(truth[half], np.array([0.2, 0.1, -0.75]))
        odometry[half:] = composed(jumped[None], between(truth[half][None], truth[half:]))
    else:
        odometry[:, :2] = 2 * truth[0, :2] - truth[:, :2]
    scans = seen_in(HALL, truth, reach=9.0, beams=300, noise=0.012, seed=5)
    found = ndtree.align(Drifting(list(scans), odometry))
    assert errors(found.poses, truth).max() < 0.06
    if kind == "is backwards":  # It is learned: then nothing contradicts it.
        assert found.odometry_scale == pytest.approx(-1.0, abs=0.05) and len(found.against) < 10


@pytest.mark.parametrize("order", [1, -1])
def test_beams_in_the_other_order_contradict_the_turns_of_odometry(order):
    truth = in_a_hall(0.06)
    scans = seen_in(HALL, truth, reach=9.0, beams=300, order=order)
    found = ndtree.align(Drifting(list(scans), truth))
    assert found.turn_scale == pytest.approx(order, abs=0.1)
    assert any("turns" in doubt for doubt in found.doubts) == (order < 0)
