# SPDX-License-Identifier: BSD-3-Clause
"""Poses of 3-D logs by kiss-icp: of logs that have none, and of logs with poor ones."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("typer")

from typer.testing import CliRunner

import ndtree
from ndtree.alignment import align_by_kiss_icp
from ndtree.cli.commands import app
from ndtree.logs.poses.pose import quaternions_of

FIRST, SCANS = 60, 30
FAR = 50.0  # What is looked at [m].


def needs_kiss_icp() -> None:
    pytest.importorskip(
        "kiss_icp", reason="kiss-icp is not installed: pip install 'ndtree-mapping[kiss-icp]'"
    )


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


def off(poses: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """How far places are from the truth, both from the first on [m]."""
    return np.linalg.norm((poses[:, :3, 3] - poses[0, :3, 3]) - (truth - truth[0]), axis=1)


def cli(*words: Any) -> Any:
    return CliRunner().invoke(app, [str(word) for word in words])


def test_a_log_without_poses_is_aligned(tmp_path: Path) -> None:
    needs_kiss_icp()
    path, truth = street(tmp_path)
    found = align_by_kiss_icp(ndtree.read(path), max_range=FAR)
    assert off(found.poses, truth).max() < 0.25 < np.linalg.norm(truth[-1] - truth[0])
    assert not found.doubts and found.cells[1] < 0.8 * found.cells[0]
    again = align_by_kiss_icp(ndtree.read(path), max_range=FAR)
    np.testing.assert_array_equal(found.poses, again.poses)
    for scan, before, pose in zip(found.log, ndtree.read(path), found.poses):
        np.testing.assert_allclose(scan.origin, pose[:3, 3], atol=1e-9)
        np.testing.assert_allclose((scan.endpoints - pose[:3, 3]) @ pose[:3, :3], before.endpoints, atol=1e-6)


def test_poor_poses_are_found_anew(tmp_path: Path) -> None:
    needs_kiss_icp()
    rng = np.random.default_rng(3)
    errors = np.cumsum(rng.normal(size=(SCANS, 3)) * 0.15, axis=0)
    path, truth = street(tmp_path, errors)
    found = align_by_kiss_icp(ndtree.read(path), max_range=FAR)
    assert off(found.poses, truth).max() < 0.25 < np.linalg.norm(errors - errors[0], axis=1).max()
    np.testing.assert_allclose(found.poses[0, :3, 3], truth[0] + errors[0], atol=0.05)
    assert found.cells[1] < found.cells[0]


def test_jumps_and_scans_that_match_nothing_are_told(tmp_path: Path) -> None:
    needs_kiss_icp()
    path, _ = street(tmp_path)
    held = dict(np.load(path))
    rng = np.random.default_rng(4)
    for i in range(10, 20):  # Scans of nowhere.
        part = slice(*held["offsets"][i : i + 2])
        held["points"][part] = rng.uniform(-40, 40, held["points"][part].shape)
    np.savez(path, **held)
    found = align_by_kiss_icp(ndtree.read(path), max_range=FAR)
    assert found.doubts and "doubtful" in str(found)


def test_the_command_writes_trajectory_map_and_picture(tmp_path: Path) -> None:
    needs_kiss_icp()
    pytest.importorskip("matplotlib")
    path, _ = street(tmp_path)
    out = {name: tmp_path / name for name in ("poses.txt", "map.ndt", "both.png", "figures.json")}
    done = cli(
        "align", path, "--odometry", "kiss-icp", "--max-range", FAR, "-o", out["poses.txt"],
        "--map", out["map.ndt"], "--picture", out["both.png"], "--json", out["figures.json"],
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    assert f"{SCANS} scans aligned" in done.output and "no loops closed" in done.output
    found = align_by_kiss_icp(ndtree.read(path), max_range=FAR)
    rows = np.loadtxt(out["poses.txt"])
    np.testing.assert_allclose(rows[:, 1:4], found.poses[:, :3, 3], atol=1e-6)
    same = np.abs((rows[:, 4:] * quaternions_of(found.poses[:, :3, :3])).sum(axis=1))
    np.testing.assert_allclose(same, 1.0, atol=1e-9)
    assert ndtree.load(out["map.ndt"]).dim == 3 and out["both.png"].stat().st_size > 1000
    assert json.loads(out["figures.json"].read_text())["scans"] == SCANS


def test_what_is_missing_or_wrong_is_said_in_a_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, _ = street(tmp_path)
    done = cli("align", path, "-o", tmp_path / "poses.txt")
    assert done.exit_code != 0 and "ndtree align --odometry kiss-icp" in done.output
    monkeypatch.setitem(sys.modules, "kiss_icp", None)
    monkeypatch.setitem(sys.modules, "kiss_icp.config", None)
    done = cli("align", path, "--odometry", "kiss-icp", "-o", tmp_path / "poses.txt")
    assert done.exit_code != 0 and "pip install 'ndtree-mapping[kiss-icp]'" in done.output
    assert not (tmp_path / "poses.txt").exists()
    with pytest.raises(ValueError, match="expected a 3-D log"):
        align_by_kiss_icp(ndtree.simulate("office", scans=2))
    with pytest.raises(ValueError, match="max_range = 0 m"):
        align_by_kiss_icp(ndtree.read(path), max_range=0)
