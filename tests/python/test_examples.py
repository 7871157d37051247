# SPDX-License-Identifier: BSD-3-Clause
"""The programs of examples/ run, and do what they say; the truth of their worlds is exact."""

from __future__ import annotations

import json
import runpy
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from snippets import ROOT

import ndtree

EXAMPLES = sorted(path.stem for path in (ROOT / "examples").glob("*.py"))


def run(name: str, folder: Path, monkeypatch: pytest.MonkeyPatch, *arguments: str) -> dict[str, Any]:
    """What is in the program when it has ended."""
    pytest.importorskip("matplotlib", reason="matplotlib is not installed: examples draw")
    picture = folder / f"{name}.png"
    monkeypatch.setattr(sys, "argv", [name, str(picture), *arguments])
    left = runpy.run_path(str(ROOT / "examples" / f"{name}.py"), run_name="__main__")
    assert picture.read_bytes().startswith(b"\x89PNG") and picture.stat().st_size > 10_000
    return left


def test_examples_are_short_and_shown() -> None:
    assert EXAMPLES == ["explore", "follow", "localise", "plan", "timetable"]
    page = (ROOT / "docs" / "plan.md").read_text()
    for name in EXAMPLES:
        assert len((ROOT / "examples" / f"{name}.py").read_text().splitlines()) < 80, name
        assert f"gallery/{name}.png" in page and f"examples/{name}.py" in page
        assert (ROOT / "docs" / "gallery" / f"{name}.png").stat().st_size < 200_000


def test_the_notebook_runs_from_a_log_to_a_corrected_map(tmp_path, monkeypatch, capsys) -> None:
    pytest.importorskip("matplotlib", reason="matplotlib is not installed: the notebook draws")
    monkeypatch.chdir(tmp_path)
    notebook = json.loads((ROOT / "examples" / "first_map.ipynb").read_text())
    left: dict[str, Any] = {}
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            assert cell["outputs"] == [] and cell["execution_count"] is None
            exec("".join(cell["source"]), left)
    assert ndtree.load(tmp_path / "first.ndt").to_bytes() == left["m"].to_bytes()
    assert (tmp_path / "first.png").read_bytes().startswith(b"\x89PNG")
    assert "robot began: free" in capsys.readouterr().out
    corrected, drifted = left["after"], left["before"]
    assert corrected.stats().observed_leaves < 0.92 * drifted.stats().observed_leaves
    anew = ndtree.ScanHistory(dim=2, min_cell_size=0.05)
    for key, scan in enumerate(left["scans"]):
        local = scan.endpoints - scan.origin.reshape(-1, 2)[0]
        anew.insert(key, local, left["poses"][key], returned=scan.returned, max_range=15.0)
    one, other = anew.map.leaves(), corrected.leaves()
    for name in ("lower", "size", "log_odds", "hits", "misses"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def test_the_cpp_examples_are_short_and_shown() -> None:
    """tests/cpp compiles and runs them."""
    page = (ROOT / "docs" / "cpp.md").read_text()
    programs = sorted((ROOT / "examples" / "cpp").glob("*.cpp"))
    assert [path.stem for path in programs] == [
        "insert_and_ask",
        "layer",
        "path",
        "plan",
        "sensor",
        "sensor_default",
    ]
    for path in programs:
        assert len(path.read_text().splitlines()) < 60, path.name
        assert f"examples/cpp/{path.name}" in page


def test_the_explorer_leaves_nothing_that_it_can_reach(tmp_path, monkeypatch, capsys) -> None:
    ndimage = pytest.importorskip("scipy.ndimage")
    left = run("explore", tmp_path, monkeypatch)
    assert left["done"] and "nothing left to see" in capsys.readouterr().out
    world, m, track = ndtree.simulate("office"), left["m"], left["track"]
    assert not world.contains(track).any(), "it drove through something"
    lower, upper = np.array(m.bounds()) + np.array([[-0.5], [0.5]])
    axes = [np.arange(lower[a], upper[a], 0.05) for a in (0, 1)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    clearance = ndimage.distance_transform_edt(
        ~world.contains(points.reshape(-1, 2)).reshape(points.shape[:2])
    )
    regions, _ = ndimage.label(0.05 * clearance > left["RADIUS"] + 0.1)  # Where even a shy robot gets to.
    start = tuple(((track[0] - lower) / 0.05).astype(int))
    reachable = points[regions == regions[start]]
    assert len(reachable) * 0.05**2 > 100, "[m2]"
    assert (m.state(reachable) == 0).mean() > 0.995
    ends = [f.cell_centers for f in m.frontiers(min_cells=8)]
    at = ((np.concatenate([np.zeros((0, 2)), *ends]) - lower) / 0.05).astype(int)
    assert (regions[tuple(at.T)] == regions[start]).sum() < 20, "cells of frontiers in reach"


def test_the_planned_way_touches_nothing_in_truth(tmp_path, monkeypatch) -> None:
    left = run("plan", tmp_path, monkeypatch, "--scans", "360")
    way, world, radius = left["first"].points, left["world"], left["RADIUS"]
    np.testing.assert_array_equal(way[[0, -1]], [[2.0, 4.0], [22.0, 17.0]])
    assert 23.8 < left["first"].length < 60
    assert left["planner"].first_blocked(way) >= 0 and left["second"].length > left["first"].length
    lengths = np.linalg.norm(np.diff(way, axis=0), axis=1)
    along = np.concatenate(([0.0], np.cumsum(lengths)))
    steps = np.linspace(0.0, along[-1], 1 + int(along[-1] / 0.02))
    places = np.column_stack([np.interp(steps, along, way[:, a]) for a in (0, 1)])
    assert len(places) > 1000 and not world.contains(places).any()
    angles = np.linspace(0, 2 * np.pi, 180, endpoint=False)
    around = np.broadcast_to(np.stack((np.cos(angles), np.sin(angles)), axis=1), (len(places), 180, 2))
    origins = np.broadcast_to(places[:, None], around.shape)
    near = world.distance(origins, around, max_range=radius)
    assert near.shape == around.shape[:2] and np.isnan(near).all(), f"as near as {np.nanmin(near):.3f} m"


def test_the_filter_finds_where_the_robot_is(tmp_path, monkeypatch) -> None:
    left = run("localise", tmp_path, monkeypatch, "--steps", "25")
    assert len(left["errors"]) == 25 and left["errors"][-1] < 0.1
    assert len(np.unique(left["clouds"][0] // 1.0, axis=0)) > 100, "at first it may be anywhere"


def test_the_window_keeps_its_size(tmp_path, monkeypatch) -> None:
    left = run("follow", tmp_path, monkeypatch, "--scans", "20")
    memory, of_whole, m = left["memory"], left["of_whole"], left["m"]
    assert left["far"][-1] > 90 and memory[10:].max() < 1.2 * memory[:10].max()
    assert memory[-1] < 0.5 * of_whole[-1] and of_whole[-1] > 1.5 * of_whole[10]
    here = left["scans"][-1].origin
    leaves = m.leaves()
    leaves = leaves[leaves.observed]
    nearest = np.clip(here, leaves.lower, leaves.lower + leaves.size[:, None])
    assert len(leaves) > 10_000
    assert np.linalg.norm(nearest - here, axis=1).max() <= left["WINDOW"] + 1e-9
    kept = np.linalg.norm(leaves.center - here, axis=1) < 5.0
    assert kept.sum() > 1000
    assert (left["whole"].state(leaves.center[kept]) == leaves.state[kept]).mean() > 0.97


def test_a_map_by_time_of_day_knows_the_next_day(tmp_path, monkeypatch) -> None:
    left = run("timetable", tmp_path, monkeypatch)
    (one, one_changing), (hourly, hourly_changing), (timed, timed_changing) = left["accuracy"]
    assert timed > hourly - 0.002 > one + 0.018
    assert timed_changing > hourly_changing - 0.005 > one_changing + 0.05
    page = (ROOT / "docs" / "benchmarks.md").read_text()
    for right, count in zip(left["accuracy"], left["cells"]):
        row = f"| {100 * right[0]:.1f} % | {100 * right[1]:.1f} % | {count:,} |"
        assert row in page, "the table of the page"


def test_moveit_gets_a_difference_with_the_octomap(monkeypatch: pytest.MonkeyPatch) -> None:
    """By classes with the fields of MoveIt's messages, which no wheel has; the node itself is not run."""

    def scene(**fields: Any) -> SimpleNamespace:
        placed = SimpleNamespace(origin=SimpleNamespace(orientation=SimpleNamespace(w=0.0)))
        return SimpleNamespace(world=SimpleNamespace(octomap=placed), **fields)

    names = {
        "rclpy": {},
        "rclpy.qos": {"DurabilityPolicy": None, "QoSProfile": None},
        "moveit_msgs.msg": {"PlanningScene": scene},
        "octomap_msgs.msg": {"Octomap": object},
    }
    for name, fields in names.items():
        module = ModuleType(name)
        vars(module).update(fields)
        monkeypatch.setitem(sys.modules, name, module)
    example = runpy.run_path(str(ROOT / "examples" / "ros2" / "moveit_scene.py"))
    octomap = SimpleNamespace(header="the frame of the map", binary=True, data=b"")
    made = example["scene_of"](octomap)
    placed = made.world.octomap
    assert made.is_diff and placed.octomap is octomap and placed.header == octomap.header
    assert placed.origin.orientation.w == 1.0
