# SPDX-License-Identifier: BSD-3-Clause
"""What a sensor would see anew, beside plain looks at equal cells; and a robot that goes by it."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest

import ndtree
from ndtree.evaluation import exploring
from ndtree.evaluation.exploring import explore


def half_seen(kind: str = "adaptive") -> Any:
    options = {"dim": 2, "range_sigma": 0.02}
    if kind == "adaptive":
        m = ndtree.AdaptiveMap(min_cell_size=0.1, max_cell_size=1.6, **options)
    else:
        m = ndtree.FixedMap(cell_size=0.1, **options)
    for scan in ndtree.simulate("office", scans=6):
        scan.insert_into(m, max_range=8.0)
    return m


def test_any_number_of_threads_gives_the_same_and_one_pose_is_one_answer() -> None:
    m = half_seen()
    sensor = ndtree.RangeSensor.laser(max_range=12.0, beams=1000)
    poses = np.random.default_rng(3).uniform([1.0, 1.0, -3.0], [15.0, 15.0, 3.0], (7, 3))
    alone = m.information_gain(poses, sensor, threads=1)
    for threads in (0, 2, 5):
        again = m.information_gain(poses, sensor, threads=threads)
        np.testing.assert_array_equal(again.volume, alone.volume)
        np.testing.assert_array_equal(again.bits, alone.bits)
    one = m.information_gain(poses[2], sensor)
    assert one.volume == alone.volume[2] and one.shape == ()
    turned = m.information_gain(poses + np.array([0.0, 0.0, 2.0 * math.pi / 1000]), sensor)
    np.testing.assert_allclose(turned.volume, alone.volume, rtol=1e-6)
    assert "InformationGain(7: volume up to" in repr(alone)


def test_unknown_space_may_occlude() -> None:
    m = ndtree.AdaptiveMap(dim=2, min_cell_size=0.1)
    m.mark([[-1.0, -1.0], [1.0, 1.0]], "free")
    whole = ndtree.RangeSensor.laser(max_range=5.0, beams=720)
    all_of_it = m.information_gain([0.0, 0.0], whole)
    assert all_of_it.volume == pytest.approx(math.pi * 25.0 - 4.0, rel=0.005)
    half = ndtree.RangeSensor.laser(max_range=5.0, beams=720, field_of_view=math.pi)
    assert m.information_gain([0.0, 0.0, 1.0], half).volume == pytest.approx(all_of_it.volume / 2, rel=0.005)
    some = ndtree.RangeSensor.laser(max_range=5.0, beams=720, mean_free_path=0.01)
    # What one mean free path behind the square's sides holds: r r dr / path, by angle.
    sides = 8.0 * math.log(1.0 + math.sqrt(2.0))
    expected = 0.01 * sides + 2.0 * math.pi * 0.01**2
    assert m.information_gain([0.0, 0.0], some).volume == pytest.approx(expected, rel=0.005)


def test_sensors_of_space_see_their_solid_angles() -> None:
    m = ndtree.FixedMap(dim=3, cell_size=0.1)
    m.mark([[-0.1] * 3, [0.1] * 3], "free")  # Else the map has no cells at all.
    here, cell = [0.0, 0.0, 0.0], 0.008
    lidar = ndtree.RangeSensor.lidar(max_range=2.0, rings=90, azimuths=400, lowest=-0.5, highest=0.5)
    sphere = 4.0 / 3.0 * math.pi * 8.0
    assert m.information_gain(here, lidar).volume + cell == pytest.approx(sphere * math.sin(0.5), rel=0.005)
    camera = ndtree.RangeSensor.camera(max_range=2.0, width=80, height=60, field_of_view=1.0)
    right, down = math.tan(0.5), 0.75 * math.tan(0.5)
    angle = 4.0 * math.asin(right * down / math.sqrt((1.0 + right**2) * (1.0 + down**2)))
    assert m.information_gain(here, camera).volume == pytest.approx(angle * 8.0 / 3.0, rel=0.005)
    plane = ndtree.RangeSensor.laser(max_range=2.0, dim=3)
    assert m.information_gain(here, plane).volume == pytest.approx(math.pi * 4.0 * 0.1, rel=0.01)


def test_wrong_sensors_and_poses_are_named() -> None:
    m, laser = half_seen(), ndtree.RangeSensor.laser(max_range=3.0)
    for call, text in (
        (lambda: ndtree.RangeSensor.laser(max_range=0.0), "max_range = 0.0 m: must be > 0"),
        (lambda: ndtree.RangeSensor.laser(max_range=1.0, beams=0), "beams = 0"),
        (lambda: ndtree.RangeSensor.laser(max_range=1.0, field_of_view=7.0), "field_of_view = 7.0 rad"),
        (lambda: ndtree.RangeSensor.laser(max_range=1.0, dim=4), "dim = 4"),
        (lambda: ndtree.RangeSensor.lidar(max_range=1.0, lowest=1.0, highest=0.5), "lowest = 1.0"),
        (lambda: ndtree.RangeSensor([[0.0, 0.0]], [[1.0]], 1.0), r"directions\[0\]"),
        (lambda: ndtree.RangeSensor([[1.0, 0.0]], [[0.0]], 1.0), r"spacing\[0\]"),
        (lambda: ndtree.RangeSensor([[1.0, 0.0]], [[1.0, 1.0]], 1.0), "spacing: shape"),
        (lambda: m.information_gain([1.0, 2.0, math.nan], laser), "pose 0: must be finite"),
        (
            lambda: m.information_gain([1.0, 2.0, 0.0], ndtree.RangeSensor.camera(max_range=1.0)),
            r"sensor: directions of shape \(4800, 3\), expected \(n, 2\)",
        ),
        (lambda: m.information_gain([1.0, 2.0, 0.0], laser, threads=-1), "threads"),
    ):
        with pytest.raises(ValueError, match=text):
            call()
    with pytest.raises(TypeError, match="RangeSensor"):
        m.information_gain([1.0, 2.0, 0.0], 5.0)


def test_a_robot_explores_and_says_how_far_it_drove() -> None:
    seen = {name: explore("office", name, max_looks=25) for name in ("information", "nearest", "random")}
    for result in seen.values():
        assert len(result.way) == len(result.volume) == len(result.seconds) == 25 and not result.done
        driven = np.diff(result.way)  # More than a metre where noise made it drive back first.
        assert (driven >= 0.0).all() and (driven < 1.0 + 1e-9).mean() > 0.8
        steps = np.linalg.norm(np.diff(result.track, axis=0), axis=1)
        assert steps.sum() >= result.way[-1] - 1e-9
        assert not ndtree.simulate("office").contains(result.track).any()
        assert result.way_to(0.0) == 0.0 and result.way_to(1e9) == math.inf
    assert seen["information"].volume[-1] > seen["nearest"].volume[-1]
    again = explore("office", "information", max_looks=25)
    np.testing.assert_array_equal(again.track, seen["information"].track)
    for wrong in ({"world": "street"}, {"world": "office", "strategy": "luck"}):
        with pytest.raises(ValueError, match="must be one of"):
            explore(**wrong)
    for start in (-1, 720):
        with pytest.raises(
            ValueError, match=f"start = {start}: must be 0 to 719, a scan of the office's own log"
        ):
            explore("office", start=start)


@pytest.mark.parametrize("strategy", ["information", "nearest"])
def test_a_robot_that_is_shut_in_from_the_start_is_not_done(strategy, monkeypatch, tmp_path, capsys) -> None:
    """It fits nowhere by what it sees: no place is left, but nothing was explored."""
    pytest.importorskip("typer")
    from calling import cli

    laser = exploring.ROBOTS["office"].sensor
    monkeypatch.setitem(exploring.ROBOTS, "office", exploring.Robot(laser, laser, radius=3.0))
    seen = explore("office", strategy)
    assert seen.shut_in and not seen.done and len(seen.way) == 1
    result = cli("explore", "office", "--strategy", strategy)
    assert "nothing can be reached from here" in result.output + capsys.readouterr().out


def test_the_command_says_what_each_strategy_took(tmp_path, capsys) -> None:
    pytest.importorskip("typer")
    from calling import cli

    target = tmp_path / "explored.json"
    result = cli("explore", "office", "--scans", "4", "--json", target)
    assert result.exit_code == 0, result.output
    figures = json.loads(target.read_text())
    assert set(figures["strategies"]) == {"information", "nearest", "random"}
    assert all(row["looks"] == 4 and row["volume"] > 10.0 for row in figures["strategies"].values())
