# SPDX-License-Identifier: BSD-3-Clause
"""Maps that follow the poses of their scans."""

import math
import threading
from pathlib import Path

import numpy as np
import pytest
from histories import mapped_anew

import ndtree


def in_sensor_frame(scan: ndtree.Scan, x: float, y: float, yaw: float) -> np.ndarray:
    """The end points of a 2-D scan as its sensor saw them."""
    turn = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
    return (scan.endpoints - [x, y]) @ turn


def cells(m: ndtree.AdaptiveMap) -> tuple[np.ndarray, ...]:
    leaves = m.leaves()
    return leaves.lower, leaves.size, leaves.log_odds, leaves.hits, leaves.misses, leaves.observed


def assert_same(a: ndtree.AdaptiveMap, b: ndtree.AdaptiveMap) -> None:
    for one, other in zip(cells(a), cells(b)):
        np.testing.assert_array_equal(one, other)


def test_a_corrected_log_is_the_log_of_the_corrected_poses(recordings: Path) -> None:
    log = ndtree.read(recordings / "laser2d_intel" / "laser2d_intel.npz")
    scans = [scan.returned_only() for scan in log][::12]
    poses = np.load(recordings / "laser2d_intel" / "laser2d_intel.npz")["poses"][::12]
    xyt = np.column_stack([poses[:, 0, 3], poses[:, 1, 3], np.arctan2(poses[:, 1, 0], poses[:, 0, 0])])
    drift = np.cumsum(np.random.default_rng(0).normal(0, [0.02, 0.02, 0.003], xyt.shape), axis=0)
    drifted, right = ndtree.ScanHistory(dim=2), ndtree.ScanHistory(dim=2)
    for i, (scan, at, off) in enumerate(zip(scans, xyt, drift)):
        points = in_sensor_frame(scan, *at)
        drifted.insert(i, points, at + off, max_range=20)
        right.insert(i, points, at, max_range=20)
    assert drifted.map.stats().observed_leaves > 1.2 * right.map.stats().observed_leaves, "walls are double"
    report = drifted.move(dict(enumerate(xyt)))
    assert report.moved == len(scans)
    assert_same(drifted.map, right.map)
    # A loop closure moves the end of a log.
    last = range(len(scans) * 9 // 10, len(scans))
    back = drifted.move({i: xyt[i] + [0.1, 0, 0.01] for i in last})
    assert back.moved == len(last) and back.cube_scans < 0.8 * back.all_cube_scans
    drifted.move({i: xyt[i] for i in last})
    assert_same(drifted.map, right.map)
    packed = drifted.memory_bytes - drifted.map.stats().memory_bytes
    beams = sum(len(scan) for scan in scans)
    assert packed < 8 * beams + 1500 * len(scans), "8 bytes a beam, and what a scan needs besides"


def test_scans_that_are_left_make_the_same_map_with_their_numbers() -> None:
    scans = list(ndtree.simulate("office", scans=30))

    def made(keys: list[int]) -> ndtree.ScanHistory:
        history = ndtree.ScanHistory(dim=2, min_cell_size=0.05)
        for i in keys:
            points = scans[i].endpoints - scans[i].origin
            history.insert(i, points, [*scans[i].origin, 0.0], returned=scans[i].returned, number=i)
        return history

    left = [i for i in range(30) if i not in (5, 6, 20)]
    history = made(list(range(30)))
    history.remove([5, 6, 20])
    assert_same(history.map, made(left).map)
    with pytest.raises(ValueError, match="number = 29: must be at least 30"):
        history.insert(40, np.ones((1, 2)), [0.0, 0.0, 0.0], number=29)
    with pytest.raises(ValueError, match="number = -1: must be at least 0"):
        history.insert(40, np.ones((1, 2)), [0.0, 0.0, 0.0], number=-1)


def test_wrong_calls_say_what_is_wrong_and_change_nothing() -> None:
    history = ndtree.ScanHistory(dim=2, min_cell_size=0.1)
    history.insert(1, [[1.0, 0.0]], (0, 0, 0))
    before = cells(history.map)
    with pytest.raises(ValueError, match="key 1: is there already"):
        history.insert(1, [[1.0, 0.0]], (0, 0, 0))
    with pytest.raises(ValueError, match=r"pose has shape \(2,\): must be"):
        history.insert(2, [[1.0, 0.0]], (0, 0))
    with pytest.raises(ValueError, match="points"):
        history.insert(2, [[1.0, 0.0, 0.0]], (0, 0, 0))
    with pytest.raises(ValueError, match="max_range"):
        history.insert(2, [[1.0, 0.0]], (0, 0, 0), max_range=-1)
    with pytest.raises(ValueError, match="pose of key 1: must be finite"):
        history.move({1: (math.nan, 0, 0)})
    with pytest.raises(ValueError, match="pose of key 1"):
        history.move({1: -np.eye(3)})
    with pytest.raises(KeyError, match="key 5: no such scan"):
        history.move({1: (1, 0, 0), 5: (0, 0, 0)})
    with pytest.raises(KeyError, match="key 5"):
        history.remove([5])
    with pytest.raises(ValueError, match="given twice"):
        history.remove([1, 1])
    with pytest.raises(KeyError):
        history.pose(7)
    with pytest.raises(KeyError):
        history.scan(7)
    with pytest.raises(TypeError):
        history.move({"one": (0, 0, 0)})
    with pytest.raises(ValueError, match="dim = 4"):
        ndtree.ScanHistory(dim=4)
    with pytest.raises(TypeError, match="dim"):
        ndtree.ScanHistory()
    with pytest.raises(TypeError, match="min_cell_siez"):
        ndtree.ScanHistory(dim=2, min_cell_siez=0.1)
    assert history.keys() == [1] and len(history) == 1
    for one, other in zip(before, cells(history.map)):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(history.pose(1), np.eye(3))


def test_threads_may_share_a_history() -> None:
    history = ndtree.ScanHistory(dim=2, min_cell_size=0.1)
    angle = np.linspace(-3, 3, 300)
    points = 3 * np.column_stack([np.cos(angle), np.sin(angle)])

    def work(first: int) -> None:
        for key in range(first, first + 20):
            history.insert(key, points, (key / 50, 0, 0))
            history.move({key: (key / 60, 0, 0)})
            assert history.map.stats().observed_leaves > 100

    threads = [threading.Thread(target=work, args=(100 * i,)) for i in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(history) == 60
    numbers = {key: i for i, key in enumerate(history.keys())}
    assert_same(history.map, mapped_anew(history, numbers, min_cell_size=0.1))
