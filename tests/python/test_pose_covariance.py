# SPDX-License-Identifier: BSD-3-Clause
"""Poses that are not sure: beams become as unsure as they are, wherever the covariance comes from."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import turned

import ndtree
from ndtree.base.scan import Scan
from ndtree.evaluation.moved import MovedPoints
from ndtree.logs.core.log import DerivedLog
from ndtree.logs.poses.covariances import PoseCovariances
from ndtree.tiles.mapper import TileMapper
from ndtree.tiles.storage import storage_of

SIZE = {2: 3, 3: 6}


def covariance(rng: np.random.Generator, dim: int, place: float = 0.05, turn: float = 0.02) -> Any:
    scale = np.array([place] * dim + [turn] * (SIZE[dim] - dim))
    root = rng.normal(size=(SIZE[dim], SIZE[dim])) * scale[:, None]
    return root @ root.T


def scans(dim: int, count: int = 3, beams: int = 80) -> list[tuple[Any, Any]]:
    rng = np.random.default_rng(7)
    return [(rng.normal(size=(beams, dim)) * 4, rng.normal(size=dim) * 0.3) for _ in range(count)]


MAPS = {
    "evidence": lambda dim: ndtree.AdaptiveMap(dim=dim),
    "paper": lambda dim: ndtree.AdaptiveMap(dim=dim, refinement="paper"),
    "fixed": lambda dim: ndtree.FixedMap(dim=dim),
    "layers": lambda dim: ndtree.AdaptiveMap(dim=dim, layers={"echo": "mean"}),
}


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("kind", MAPS)
def test_a_covariance_is_that_range_sigma_and_zero_is_none(kind: str, dim: int) -> None:
    rng = np.random.default_rng(3)
    plain, zero, unsure, widened = (MAPS[kind](dim) for _ in range(4))
    for points, origin in scans(dim):
        own: dict[str, Any] = {"layers": {"echo": np.abs(points[:, 0])}} if kind == "layers" else {}
        c = covariance(rng, dim)
        plain.insert(points, origin, **own)
        zero.insert(points, origin, pose_covariance=np.zeros_like(c), **own)
        unsure.insert(points, origin, pose_covariance=c, **own)
        sigma = ndtree._native._core.pose_range_sigma(points, origin, c)
        widened.insert(points, origin, range_sigma=sigma, **own)
    assert plain.to_bytes() == zero.to_bytes()
    assert unsure.to_bytes() == widened.to_bytes() != plain.to_bytes()


def test_of_a_covariance_in_space_a_map_of_the_plane_takes_x_y_and_yaw() -> None:
    rng = np.random.default_rng(5)
    whole = covariance(rng, 3)
    part = whole[np.ix_((0, 1, 5), (0, 1, 5))]
    one, other = ndtree.AdaptiveMap(dim=2), ndtree.AdaptiveMap(dim=2)
    for points, origin in scans(2):
        one.insert(points, origin, pose_covariance=whole)
        other.insert(points, origin, pose_covariance=part)
    assert one.to_bytes() == other.to_bytes()


def asymmetric() -> Any:
    matrix = np.eye(6)
    matrix[4, 1] = 0.5
    return matrix


WRONG = {
    "shape": (np.eye(4), r"has shape \(4, 4\): must be \(6, 6\)"),
    "of the plane": (np.eye(3), r"has shape \(3, 3\): must be \(6, 6\)"),
    "flat": (np.zeros(36), r"has shape \(36,\): must be \(6, 6\)"),
    "not finite": (np.diag([1, 1, 1, 1, math.nan, 1.0]), r"\[4, 4\] = nan: must be finite"),
    "not symmetric": (asymmetric(), r"\[4, 1\] = 0\.5 and \[1, 4\] = 0\.0: must be symmetric"),
    "negative": (np.diag([1, 1, 1, 1, 1, -0.5]), r"eigenvalue -0\.5: all must be >= 0"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_no_covariance_is_refused(name: str) -> None:
    wrong, message = WRONG[name]
    m, history = ndtree.AdaptiveMap(dim=3), ndtree.ScanHistory(dim=3)
    before = m.to_bytes()
    for insert in (
        lambda: m.insert([[1.0, 2, 3]], np.zeros(3), pose_covariance=wrong),
        lambda: history.insert(1, [[1.0, 2, 3]], np.eye(4), pose_covariance=wrong),
        lambda: Scan([[1.0, 2, 3]], np.zeros(3), pose_covariance=wrong),
    ):
        with pytest.raises(ValueError, match=message):
            insert()
    assert m.to_bytes() == before and len(history) == 0
    with pytest.raises(ValueError, match="dim = 4, must be 2 or 3"):
        ndtree.AdaptiveMap(dim=4).insert([[1.0, 2, 3, 4]], np.zeros(4), pose_covariance=np.eye(6))


@pytest.mark.parametrize("dim", [2, 3])
def test_a_history_keeps_what_the_covariance_said_when_scans_move(dim: int) -> None:
    rng = np.random.default_rng(6)
    history, plain = ndtree.ScanHistory(dim=dim), ndtree.ScanHistory(dim=dim)
    pose = turned(dim, 0.7, rng.normal(size=dim))
    points, _ = scans(dim, 1)[0]
    c = covariance(rng, dim)
    history.insert(1, points, pose, pose_covariance=c)
    plain.insert(1, points, pose, pose_covariance=np.zeros_like(c))
    assert plain.scan(1).range_sigma is None
    ends = points @ pose[:dim, :dim].T + pose[:dim, dim]
    expected = ndtree._native._core.pose_range_sigma(ends, pose[:dim, dim], c)
    np.testing.assert_allclose(history.scan(1).range_sigma, expected, rtol=1e-6)
    history.move({1: np.eye(dim + 1)})
    np.testing.assert_allclose(history.scan(1).range_sigma, expected, rtol=1e-6)


def test_tiles_and_archives_have_what_a_map_has(tmp_path: Path) -> None:
    rng = np.random.default_rng(8)
    every = [
        Scan(points, origin, pose_covariance=covariance(rng, 2, 0.4) if i else np.zeros((3, 3)))
        for i, (points, origin) in enumerate(scans(2, 4))
    ]
    m = ndtree.AdaptiveMap(dim=2)
    for scan in every:
        scan.insert_into(m)
    # Small tiles: beams reach other ones by what the covariance adds.
    storage = storage_of(str(tmp_path / "map.tiles"))
    mapper = TileMapper(storage, ndtree.AdaptiveMap(dim=2), tile_size=1.6)
    for scan in every:
        mapper.insert(scan)
    mapper.write(complete=True)
    points = rng.normal(size=(20_000, 2)) * 6
    tiled = ndtree.open_tiles(tmp_path / "map.tiles")
    np.testing.assert_array_equal(tiled.probability(points), m.probability(points))

    again = ndtree.AdaptiveMap(dim=2)
    ndtree.logs.core.archive.save_archive(every, tmp_path / "log.npz", "a log")
    for scan in ndtree.read(tmp_path / "log.npz"):
        scan.insert_into(again)
    assert again.to_bytes() == m.to_bytes()
    assert every[1].only(slice(0, 5)).pose_covariance is every[1].pose_covariance


class Changed(DerivedLog):
    """A log whose scans are changed."""

    def __init__(self, log: Any, change: Any) -> None:
        super().__init__(log)
        self._change = change

    def _scans(self) -> Any:
        return (self._change(scan) for scan in self._log)


def test_what_moved_is_judged_with_what_poses_are_worth() -> None:
    office = ndtree.simulate("office", seed=7, scans=40, people=6)
    c, noise = np.diag([0.2**2, 0.2**2, 0.02**2]), {"range_sigma": 0.02}
    unsure = Changed(office, lambda scan: replace(scan, pose_covariance=c))
    widened = Changed(office, lambda scan: replace(scan, pose_covariance=c).with_sigma(noise))
    found = [MovedPoints(log, noise, math.inf, "free").look() for log in (unsure, widened, office)]
    differ = 0
    for scan, same, plain in zip(unsure, widened, office):
        probability = found[0].probability(scan)
        np.testing.assert_array_equal(probability, found[1].probability(same))
        np.testing.assert_array_equal(found[0].without(scan).endpoints, found[1].without(same).endpoints)
        differ += np.count_nonzero(probability != found[2].probability(plain))
    assert differ > 100


def rows(*diagonals: Any, use: str = "auto", dim: int = 2) -> PoseCovariances:
    found = PoseCovariances("/pose", use, dim)
    for i, diagonal in enumerate(diagonals):
        found.add(float(i), np.diag(np.broadcast_to(diagonal, 6)).ravel())
    return found


SMALL, LARGE = np.full(6, 1e-4), np.full(6, 1e-2)
DEFAULTS = {
    "none": rows(), "zeros": rows(0, 0, 0), "the same": rows(SMALL, SMALL, SMALL), "unknown": rows(-1, -1),
    "huge": rows(1e6, 1e6, 1e9), "that grow": rows(SMALL, 2 * SMALL, 3 * SMALL),
    "that change out of the plane": rows([1, 1, 5, 5, 5, 1], [1, 1, 6, 6, 6, 1], [1, 1, 2, 2, 2, 1]),
    "ignored": rows(SMALL, LARGE, SMALL, use="ignore"),
}  # fmt: skip


@pytest.mark.parametrize("name", DEFAULTS)
def test_a_drivers_default_is_no_covariance(name: str) -> None:
    assert not DEFAULTS[name].are_used and DEFAULTS[name].at(0.5, np.zeros(3)) is None
    note = DEFAULTS[name].note()
    assert note is None if name != "that grow" else "only grow" in note


def test_covariances_are_interpolated_and_moved_to_the_sensor() -> None:
    found = rows(SMALL, LARGE, SMALL, dim=3)
    found.add(3.0, np.full(36, np.nan))  # None.
    assert found.are_used and found.wrong == 1 and found.told == 4
    lever = np.array([0.5, -0.2, 0.3])
    middle = (SMALL + 0.0 * LARGE) * 0.75 + 0.25 * LARGE
    rng = np.random.default_rng(9)
    errors = rng.normal(size=(200_000, 6)) * np.sqrt(middle)
    at_sensor = np.hstack([errors[:, :3] + np.cross(errors[:, 3:], lever), errors[:, 3:]])
    np.testing.assert_allclose(found.at(0.25, lever), np.cov(at_sensor.T), atol=3e-5)
    np.testing.assert_allclose(found.at(-5.0, np.zeros(3)), np.diag(SMALL))
    assert "0.0173 m" in found.note() and "1 of 4 are none" in found.note()
    assert rows(SMALL, SMALL, use="use").are_used
    forgetful = PoseCovariances("/pose", "use", 3, most=2)
    for i, size in enumerate((1.0, 2.0, 3.0)):
        forgetful.add(float(i), size * np.eye(6).ravel())
    np.testing.assert_allclose(forgetful.at(0.0, np.zeros(3)), 2 * np.eye(6))


pytest.importorskip("rosbags")
from bags import KINDS, LEVEL, Messages, write_bag  # noqa: E402
from calling import cli  # noqa: E402
from drives import START  # noqa: E402

STAMPS = np.arange(0, 3, 0.1)
MOUNT = np.array([0.4, 0.1, 0.2])


def bag(folder: Path, size: Any, kind: str = "mcap", of: str = "Odometry") -> Path:
    """A laser on a robot whose poses have a covariance that depends on the time."""
    make = Messages(kind)
    content = [make.fixed(START, "base_link", "laser", MOUNT)]
    for t in STAMPS:
        odometry = make.odometry(START + t, "map", "base_link", (0.5 * t, 0, 0), LEVEL)
        pose = make.of(
            "geometry_msgs/msg/PoseWithCovariance",
            pose=odometry.pose.pose,
            covariance=(size(t) * np.diag([1, 1, 1e6, 1e6, 1e6, 0.1])).ravel(),
        )
        if of == "Odometry":
            message = make.of(
                "nav_msgs/msg/Odometry",
                header=odometry.header, child_frame_id="base_link", pose=pose, twist=odometry.twist,
            )  # fmt: skip
        else:
            message = make.of(f"geometry_msgs/msg/{of}", header=odometry.header, pose=pose)
        content.append(("/pose", START + t, message))
        ranges = 3.0 + 0.3 * np.sin(np.arange(60))
        content.append(("/scan", START + t, make.laser(START + t, "laser", ranges)))
    return write_bag(folder / kind, make, content)


def waves(t: float) -> float:
    return 0.01 * (1.2 + math.sin(3 * t))


@pytest.mark.parametrize("of", ["Odometry", "PoseWithCovarianceStamped"])
@pytest.mark.parametrize("kind", KINDS)
def test_poses_of_bags_tell_how_sure_they_are(kind: str, of: str, tmp_path: Path) -> None:
    topic = {"odometry": "/pose"} if of == "Odometry" else {"poses": "/pose"}
    log = ndtree.read(bag(tmp_path, waves, kind, of), **topic)
    m, plain = ndtree.AdaptiveMap(dim=2), ndtree.AdaptiveMap(dim=2)
    found = list(log)
    assert len(found) == len(STAMPS)
    for scan, t in zip(found, STAMPS):
        c = scan.pose_covariance[np.ix_((0, 1, 5), (0, 1, 5))]
        x, y = MOUNT[:2]
        lever = np.array([[1, 0, -y], [0, 1, x], [0, 0, 1]])
        np.testing.assert_allclose(c, waves(t) * lever @ np.diag([1, 1, 0.1]) @ lever.T, atol=1e-9)
        scan.insert_into(m)
        plain.insert(scan.endpoints, scan.origin, returned=scan.returned)
    assert m.to_bytes() != plain.to_bytes()
    assert any("the covariances of /pose widen beams" in note for note in log.notes)
    ignored = list(ndtree.read(log.path, pose_covariance="ignore", **topic))
    assert all(scan.pose_covariance is None for scan in ignored)


def test_the_command_says_what_it_does_with_covariances(tmp_path: Path) -> None:
    constant, out = bag(tmp_path, lambda t: 0.01), tmp_path / "out.ndt"
    asked = ("map", constant, "--odometry", "/pose", "-o", out)
    done = cli(*asked)
    assert done.exit_code == 0 and "covariances" not in done.output, done.output
    before = out.read_bytes()
    done = cli(*asked, "--pose-covariance", "use")
    assert done.exit_code == 0 and "the covariances of /pose widen beams" in done.output, done.output
    assert out.read_bytes() != before
    done = cli(*asked, "--pose-covariance", "maybe")
    assert done.exit_code != 0 and "must be one of auto, ignore, use" in done.output
    growing = bag(tmp_path / "growing", lambda t: 0.01 * (1 + t))
    done = cli("map", growing, "--odometry", "/pose", "-o", out)
    assert "only grow" in done.output and out.read_bytes() == before
    unknown = bag(tmp_path / "unknown", lambda t: -1.0)
    done = cli("map", unknown, "--odometry", "/pose", "-o", out, "--pose-covariance", "use")
    assert done.exit_code != 0 and "have no covariance" in done.output


def test_live_maps_take_covariances_as_the_recording_does(tmp_path: Path) -> None:
    path = bag(tmp_path, waves)
    files = tmp_path / "live.ndt", tmp_path / "map.ndt"
    options = ("--odometry", "/pose", "--pose-covariance", "use")
    for words in (("live", path, "-o", files[0], "--rate", 0), ("map", path, "-o", files[1])):
        done = cli(*words, *options)
        assert done.exit_code == 0, done.output
    assert files[0].read_bytes() == files[1].read_bytes()
