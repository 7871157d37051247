# SPDX-License-Identifier: BSD-3-Clause
"""Poses of 3-D logs and loops: of logs that have none, and of logs with poor ones."""

from __future__ import annotations

import json
import sys
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from calling import cli
from conftest import turned

import ndtree
from ndtree.alignment import align_in_space
from ndtree.alignment.motion import Motion
from ndtree.alignment.spatial_loops import SpatialGraph
from ndtree.alignment.spatial_tracking import CloudScan, SpatialTracker
from ndtree.logs.poses.pose import quaternions_of

FIRST, SCANS = 60, 30
FAR = 50.0  # What is looked at [m].


@pytest.fixture
def libraries() -> None:
    pytest.importorskip("small_gicp", reason="small-gicp is missing: pip install 'ndtree-mapping[lidar]'")


def street(folder: Path, errors: Any = None) -> tuple[Path, np.ndarray]:
    """A lidar that drives through a street: without poses, or with these errors. And its places."""
    log = ndtree.simulate("street", scans=200)
    points, origins, truth = [], [], []
    for i in range(SCANS):
        scan = log[FIRST + i].returned_only().only(slice(None, None, 4))
        truth.append(scan.origin)
        origins.append(np.zeros(3) if errors is None else scan.origin + errors[i])
        points.append(scan.endpoints - scan.origin + origins[-1])
    path = folder / "street.npz"
    np.savez(
        path,
        points=np.concatenate(points),
        origins=np.array(origins),
        offsets=np.cumsum([0, *map(len, points)]),
        stamps=0.1 * np.arange(SCANS),
    )
    return path, np.array(truth)


def blocks(seed: int) -> np.ndarray:
    """Boxes (n, 2, 3) beside a square of streets: their least and largest corners [m]."""
    rng = np.random.default_rng(seed)
    middles = [
        (x, y) for x in np.arange(-24.0, 25.0, 4.0) for y in np.arange(-24.0, 25.0, 4.0)
        if min(abs(abs(x) - 12), abs(abs(y) - 12)) > 2.5 or max(abs(x), abs(y)) > 17
    ]  # fmt: skip
    middle = np.array(middles) + rng.uniform(-1, 1, (len(middles), 2))
    size = rng.uniform(0.3, 1.6, (len(middles), 2))
    low = np.column_stack((middle - size, np.zeros(len(middle))))
    return np.stack((low, np.column_stack((middle + size, rng.uniform(0.5, 6.0, len(middle))))), axis=1)


def seen(boxes: np.ndarray, pose: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """What a lidar with 16 rings sees of boxes and the ground, in its frame [m]."""
    up, around = np.meshgrid(np.radians(np.linspace(-20, 15, 16)), np.linspace(-np.pi, np.pi, 180, False))
    ways = np.stack((np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)), -1).reshape(-1, 3)
    turned, origin = ways @ pose[:3, :3].T, pose[:3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        at = (boxes[:, None] - origin) / turned[None, :, None]
        enter, leave = at.min(axis=2).max(axis=-1), at.max(axis=2).min(axis=-1)
        met = np.where((enter <= leave) & (enter > 0), enter, np.inf).min(axis=0)
        ground = np.where(turned[:, 2] < 0, -origin[2] / turned[:, 2], np.inf)
    ranges = np.minimum(met, ground) + rng.normal(0, 0.01, len(ways))
    near = ranges < 30
    return ways[near] * ranges[near, None]


def round_trip() -> np.ndarray:
    """Poses (n, 4, 4) once around the square and a little more, a step of 1 m each."""
    corners = np.array([(-12, -12), (12, -12), (12, 12), (-12, 12), (-12, -12), (4, -12)], dtype=float)
    poses = []
    for side, (begin, end) in enumerate(zip(corners[:-1], corners[1:])):
        for i in range(int(np.linalg.norm(end - begin))):
            at = begin + i * (end - begin) / np.linalg.norm(end - begin)
            poses.append(turned(3, side * np.pi / 2, (*at, 1.5)))
    return np.array(poses)


@cache
def of_round_trip(i: int, town: int) -> np.ndarray:
    """What is seen from a pose of the round trip."""
    return seen(blocks(town), round_trip()[i], np.random.default_rng(i))


def drifted(truth: np.ndarray) -> np.ndarray:
    """Poses that add up steps with a wrong yaw and pitch, from the first on."""
    wrong = np.eye(4)
    wrong[:3, :3] += 6e-4 * np.array([[0, -1, 1], [1, 0, 0], [-1, 0, 0]])
    poses = [np.eye(4)]
    for step in np.linalg.inv(truth[:-1]) @ truth[1:]:
        poses.append(poses[-1] @ step @ wrong)
    return np.array(poses)


@pytest.mark.usefixtures("libraries")
@pytest.mark.parametrize("is_changed", [False, True])
def test_places_that_are_seen_again_close_loops(is_changed: bool) -> None:
    truth, changed = round_trip(), 75
    scans = [of_round_trip(i, 1 + (is_changed and i > changed)) for i in range(len(truth))]
    graph = SpatialGraph(drifted(truth), scans, np.zeros((len(truth), 3, 3)))
    before = off(graph.poses, (np.linalg.inv(truth[0]) @ truth)[:, :3, 3])
    graph.close()
    after = off(graph.poses, (np.linalg.inv(truth[0]) @ truth)[:, :3, 3])
    if is_changed:  # Another town, where odometry says that it is the same place.
        assert not graph.loops
        np.testing.assert_array_equal(after, before)
        return
    assert len(graph.loops) >= 2 and graph.contradicted == 0
    for loop in graph.loops:
        a, b = graph.keys[[loop.older, loop.newer]]
        np.testing.assert_allclose(loop.relation, np.linalg.inv(truth[a]) @ truth[b], atol=0.1)
        beside = loop.relation.copy()
        beside[1, 3] += 1.0
        assert graph._agree(loop.older, loop.newer, loop.relation)
        assert not graph._agree(loop.older, loop.newer, beside), "end points where the other saw through"
    assert before[-1] > 0.5 and after[-1] < 0.1 and after.max() < 0.5 * before.max()


def off(poses: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """How far places are from the truth, both from the first on [m]."""
    return np.linalg.norm((poses[:, :3, 3] - poses[0, :3, 3]) - (truth - truth[0]), axis=1)


@pytest.mark.usefixtures("libraries")
def test_a_log_without_poses_is_aligned(tmp_path: Path) -> None:
    path, truth = street(tmp_path)
    found = align_in_space(ndtree.read(path), max_range=FAR)
    assert off(found.poses, truth).max() < 0.25 < np.linalg.norm(truth[-1] - truth[0])
    assert not found.doubts and found.cells[1] < 0.8 * found.cells[0]
    again = align_in_space(ndtree.read(path), max_range=FAR)
    np.testing.assert_array_equal(found.poses, again.poses)
    for scan, before, pose in zip(found.log, ndtree.read(path), found.poses):
        np.testing.assert_allclose(scan.origin, pose[:3, 3], atol=1e-9)
        np.testing.assert_allclose((scan.endpoints - pose[:3, 3]) @ pose[:3, :3], before.endpoints, atol=1e-6)


@pytest.mark.usefixtures("libraries")
def test_poor_poses_are_found_anew(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    errors = np.cumsum(rng.normal(size=(SCANS, 3)) * 0.15, axis=0)
    path, truth = street(tmp_path, errors)
    found = align_in_space(ndtree.read(path), max_range=FAR)
    assert off(found.poses, truth).max() < 0.25 < np.linalg.norm(errors - errors[0], axis=1).max()
    np.testing.assert_allclose(found.poses[0, :3, 3], truth[0] + errors[0], atol=0.05)
    assert found.cells[1] < found.cells[0]


@pytest.mark.usefixtures("libraries")
def test_jumps_and_scans_that_match_nothing_are_told(tmp_path: Path) -> None:
    path, _ = street(tmp_path)
    held = dict(np.load(path))
    rng = np.random.default_rng(4)
    for i in range(10, 20):  # Scans of nowhere.
        part = slice(*held["offsets"][i : i + 2])
        held["points"][part] = rng.uniform(-40, 40, held["points"][part].shape)
    np.savez(path, **held)
    found = align_in_space(ndtree.read(path), max_range=FAR)
    assert found.doubts and "doubtful" in str(found)


@pytest.mark.usefixtures("libraries")
def test_the_command_writes_trajectory_map_and_picture(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    path, _ = street(tmp_path)
    out = {name: tmp_path / name for name in ("poses.txt", "map.ndt", "both.png", "figures.json")}
    done = cli(
        "align", path, "--max-range", FAR, "-o", out["poses.txt"],
        "--map", out["map.ndt"], "--picture", out["both.png"], "--json", out["figures.json"],
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    assert f"{SCANS} scans aligned" in done.output and "no loops found" in done.output
    found = align_in_space(ndtree.read(path), max_range=FAR)
    rows = np.loadtxt(out["poses.txt"])
    np.testing.assert_allclose(rows[:, 1:4], found.poses[:, :3, 3], atol=1e-6)
    same = np.abs((rows[:, 4:] * quaternions_of(found.poses[:, :3, :3])).sum(axis=1))
    np.testing.assert_allclose(same, 1.0, atol=1e-9)
    assert ndtree.load(out["map.ndt"]).dim == 3 and out["both.png"].stat().st_size > 1000
    figures = json.loads(out["figures.json"].read_text())
    assert figures["scans"] == SCANS and figures["max_range"] == FAR and figures["broken"] == []


def corridor(folder: Path, told: Any) -> tuple[ndtree.Log, np.ndarray]:
    """A smooth corridor without ends in sight, whose log has other steps than the truth; and its places."""
    walls = np.array(
        [[[-60, y, -1], [60, y + 0.2, 3]] for y in (-1.4, 1.2)]
        + [[[-60, -2, 2.6], [60, 2, 2.8]], [[-60, -2, -0.2], [60, 2, 0]]]
    )
    truth = np.column_stack((0.1 * np.arange(40), np.zeros(40), np.full(40, 1.0)))
    origins, rng = told(truth), np.random.default_rng(5)
    points = [seen(walls, turned(3, 0.0, tuple(at)), rng) + origin for at, origin in zip(truth, origins)]
    offsets = np.cumsum([0, *map(len, points)])
    path = folder / "corridor.npz"
    np.savez(
        path, points=np.concatenate(points), origins=origins, offsets=offsets, stamps=0.1 * np.arange(40)
    )
    return ndtree.read(path), truth


@pytest.mark.usefixtures("libraries")
def test_in_a_corridor_odometry_alone_says_the_way_and_that_is_told(tmp_path: Path) -> None:
    """The same beams on smooth walls fit best where the sensor stood still."""
    log, truth = corridor(tmp_path, lambda truth: truth + [0, 0.3, 0] * np.arange(40)[:, None] / 40)
    found = align_in_space(log)
    assert np.abs(found.poses[:, :3, 3] - truth).max() < 0.05, "across, walls tell that odometry drifts"
    assert any("only odometry says how far" in doubt for doubt in found.doubts)
    alone = align_in_space(corridor(tmp_path, lambda truth: np.tile(truth[:1], (40, 1)))[0])
    assert not alone.has_odometry and alone.doubts


@pytest.mark.usefixtures("libraries")
@pytest.mark.parametrize("stands", [False, True])
def test_where_nothing_is_flat_points_tell_the_way_but_not_that_a_moving_sensor_stands(stands: bool) -> None:
    """Bushes all around; where the sensor stands, all scans are the same, as of smooth walls."""
    rng = np.random.default_rng(6)
    bushes = rng.uniform([-8, -8, -1], [10, 8, 4], (250, 1, 3))
    leaves = (bushes + rng.normal(0, 0.15, (250, 60, 3))).reshape(-1, 3)
    tracker = SpatialTracker(Motion(), has_odometry=True)
    for i in range(40):
        told = turned(3, 0.0, (0.05 * i, 0.0, 0.0))
        at = told[:3, 3] * (not stands) + [0.0, 0.002 * i * (not stands), 0.0]
        near = leaves[np.linalg.norm(leaves - at, axis=1) < 8.0][:: 1 if stands else 2 + i % 3]
        tracker.add(CloudScan((near - at + rng.normal(0, 0.01, near.shape)).astype(np.float32), told))
    track = tracker.track
    if stands:
        np.testing.assert_allclose(track.poses[-1][:3, 3], told[:3, 3], atol=0.3)
        assert sum(track.unfixed) > 1.0, "odometry alone says that it moved"
    else:
        np.testing.assert_allclose(track.poses[-1][:3, 3], at, atol=0.03)
        assert sum(track.unfixed) < 0.06, "it is where it is in the map, whatever was before"


def test_points_on_flat_surfaces_or_alone_say_little() -> None:
    rng = np.random.default_rng(8)
    tracker = SpatialTracker(Motion(), has_odometry=True)
    floor = rng.uniform([-5, -5, -1], [5, 5, -1], (4000, 3)).astype(np.float32)
    leaves = rng.uniform([-5, -5, 0], [5, 5, 2], (8000, 3)).astype(np.float32)
    tracker.add(CloudScan(np.concatenate([floor, leaves]), np.eye(4)))
    assert tracker._is_smooth(floor) and not tracker._is_smooth(leaves)
    assert not tracker._is_smooth(np.concatenate([floor[:700], leaves[:300]]))
    alone = rng.uniform(50, 90, (300, 3)).astype(np.float32)
    assert tracker._is_smooth(np.concatenate([floor[:700], alone]))


@pytest.mark.usefixtures("libraries")
@pytest.mark.parametrize("kind", ["backwards", "stalls", "jumps"])
def test_odometry_that_is_wrong_is_found_out(tmp_path: Path, kind: str) -> None:
    _, truth = street(tmp_path)
    told = truth.copy()
    if kind == "backwards":
        told = 2 * truth[0] - truth
    elif kind == "stalls":
        told[10:14] = told[10]
    else:
        told[15:] += [0.0, 8.0, 0.0]
    found = align_in_space(ndtree.read(street(tmp_path, told - truth)[0]), max_range=FAR, close_loops=False)
    assert off(found.poses, truth).max() < 0.15 and not found.doubts
    assert (found.odometry_scale < -0.9) == (kind == "backwards")


@pytest.mark.usefixtures("libraries")
def test_a_scan_without_points_says_nothing(tmp_path: Path) -> None:
    rng = np.random.default_rng(7)
    places = np.column_stack((0.2 * np.arange(12), np.full(12, -12.0), np.full(12, 1.5)))
    points = [seen(blocks(1), turned(3, 0.0, tuple(at)), rng) + at for at in places]
    for empty in (0, 6, 11):
        kept = [one[: 0 if i == empty else None] for i, one in enumerate(points)]
        ends, path = np.cumsum([0, *map(len, kept)]), tmp_path / f"{empty}.npz"
        np.savez(path, points=np.concatenate(kept), origins=places, offsets=ends, stamps=0.1 * np.arange(12))
        found = align_in_space(ndtree.read(path))
        assert off(found.poses, places).max() < 0.02 and not found.doubts and found.lost == (empty > 0)


def test_what_is_missing_or_wrong_is_said_in_a_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, _ = street(tmp_path)
    monkeypatch.setitem(sys.modules, "small_gicp", None)
    done = cli("align", path, "-o", tmp_path / "poses.txt")
    assert done.exit_code != 0 and "small-gicp" in done.output and "pip install" in done.output
    assert not (tmp_path / "poses.txt").exists()
    with pytest.raises(ValueError, match="expected a 3-D log"):
        align_in_space(ndtree.simulate("office", scans=2))
    with pytest.raises(ValueError, match="max_range = 0 m"):
        align_in_space(ndtree.read(path), max_range=0)
