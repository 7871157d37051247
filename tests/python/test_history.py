# SPDX-License-Identifier: BSD-3-Clause
"""Maps that follow the poses of their scans."""

import math
import threading

import numpy as np
import pytest
from histories import mapped_anew

import ndtree


def cells(m: ndtree.AdaptiveMap) -> tuple[np.ndarray, ...]:
    leaves = m.leaves()
    return leaves.lower, leaves.size, leaves.log_odds, leaves.hits, leaves.misses, leaves.observed


def assert_same(a: ndtree.AdaptiveMap, b: ndtree.AdaptiveMap) -> None:
    for one, other in zip(cells(a), cells(b)):
        np.testing.assert_array_equal(one, other)


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
