# SPDX-License-Identifier: BSD-3-Clause
"""Maps that follow the poses of their scans."""

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from histories import mapped_anew

import ndtree

LAYERS = {"color": "mean3", "intensity": "mean", "label": "majority", "stamp": "latest"}


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
    for error, said, call in (
        (ValueError, "key 1: is there already", lambda: history.insert(1, [[1.0, 0.0]], (0, 0, 0))),
        (ValueError, r"pose has shape \(2,\): must be", lambda: history.insert(2, [[1.0, 0.0]], (0, 0))),
        (ValueError, "points", lambda: history.insert(2, [[1.0, 0.0, 0.0]], (0, 0, 0))),
        (ValueError, "max_range", lambda: history.insert(2, [[1.0, 0.0]], (0, 0, 0), max_range=-1)),
        (ValueError, "pose of key 1: must be finite", lambda: history.move({1: (math.nan, 0, 0)})),
        (ValueError, "pose of key 1", lambda: history.move({1: -np.eye(3)})),
        (KeyError, "key 5: no such scan", lambda: history.move({1: (1, 0, 0), 5: (0, 0, 0)})),
        (KeyError, "key 5", lambda: history.remove([5])),
        (ValueError, "given twice", lambda: history.remove([1, 1])),
        (KeyError, "7", lambda: history.pose(7)),
        (KeyError, "7", lambda: history.scan(7)),
        (TypeError, "one", lambda: history.move({"one": (0, 0, 0)})),
        (ValueError, "dim = 4", lambda: ndtree.ScanHistory(dim=4)),
        (TypeError, "dim", lambda: ndtree.ScanHistory()),
        (TypeError, "min_cell_siez", lambda: ndtree.ScanHistory(dim=2, min_cell_siez=0.1)),
    ):
        with pytest.raises(error, match=said):
            call()
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

    with ThreadPoolExecutor(3) as pool:
        list(pool.map(work, (0, 100, 200)))
    assert len(history) == 60
    numbers = {key: i for i, key in enumerate(history.keys())}
    assert_same(history.map, mapped_anew(history, numbers, min_cell_size=0.1))


def test_what_was_measured_is_kept() -> None:
    points = np.array([[1.0, 0.0], [0.0, 0.0], [math.nan, 1.0], [0.0, 2.0], [1.5, 1.0]])
    returned = np.array([True, True, True, False, True])
    given = {
        "color": np.arange(15.0).reshape(5, 3) + 0.5,
        "intensity": np.array([1.25, math.nan, math.nan, math.nan, -3.5]),  # Where no beam ends, anything.
        "label": np.array([65535, -7, 3, 99999, 0]),
        "stamp": np.full(5, 1e9),
    }
    history = ndtree.ScanHistory(dim=2, layers=LAYERS)
    report = history.insert(3, points, (0, 0, 0), returned=returned, layers=given)
    assert (report.beams, report.invalid, report.returned) == (5, 2, 2)
    kept = history.measurements(3)
    assert list(kept) == list(given) and len(history.scan(3)) == 3
    np.testing.assert_array_equal(kept["color"], [given["color"][0], [math.nan] * 3, given["color"][4]])
    np.testing.assert_array_equal(kept["intensity"], [1.25, math.nan, -3.5])
    np.testing.assert_array_equal(kept["label"], [65535, -1, 0])
    np.testing.assert_array_equal(kept["stamp"], [1e9, math.nan, 1e9])
    assert kept["label"].dtype == np.int64 and kept["color"].dtype == np.float64
    np.testing.assert_array_equal(history.map.layer("label", points[[0, 4]]), [65535, 0])
    history.move({3: (0, 5, 0)})
    assert history.measurements(3)["stamp"][0] == 1e9
    np.testing.assert_array_equal(history.map.layer("label", [[1.0, 0.0], [1.0, 5.0]]), [-1, 65535])
    history.insert(4, points, (0, 0, 0), layers={"stamp": np.zeros(5)})
    assert list(history.measurements(4)) == ["stamp"]
    with pytest.raises(KeyError, match="key 9"):
        history.measurements(9)
    assert ndtree.ScanHistory(dim=3).layers == {}
