# SPDX-License-Identifier: BSD-3-Clause
"""Layers of maps that follow the poses of their scans."""

import math
import struct

import numpy as np
import pytest

import ndtree

LAYERS = {"color": "mean3", "intensity": "mean", "label": "majority", "stamp": "latest"}
OPTIONS = {"min_cell_size": 0.1, "max_cell_size": 1.6, "range_sigma": 0.02}


def without_counters(m: ndtree.AdaptiveMap) -> bytes:
    """A map's file, but for how many updates, splits and merges made it."""
    data = bytearray(m.to_bytes()[:-4])  # The checksum is of all.
    at = data.index(b"evidence") + len(b"evidence")
    (options,) = struct.unpack_from("<I", data, at)
    at += 4
    for _ in range(options):
        (length,) = struct.unpack_from("<H", data, at)
        at += 2 + length + 8
    data[at : at + 24] = bytes(24)
    return bytes(data)


def some_scan(random: np.random.Generator, dim: int, n: int = 150) -> np.ndarray:
    points = random.normal(size=(n, dim))
    return points * (random.uniform(1, 3, n) / np.linalg.norm(points, axis=1))[:, None]


def some_measurements(random: np.random.Generator, n: int, stamp: float) -> dict[str, np.ndarray]:
    return {
        "color": random.uniform(0, 255, (n, 3)),
        "intensity": random.uniform(-1, 1, n),
        "label": random.integers(0, 5, n),
        "stamp": np.full(n, stamp),
    }


def some_pose(random: np.random.Generator, dim: int, reach: float = 6.0) -> np.ndarray:
    if dim == 2:
        return random.uniform([-reach, -reach, -3], [reach, reach, 3])
    q = random.normal(size=4)
    return np.concatenate([random.uniform(-reach, reach, 3), q / np.linalg.norm(q)])


def test_frozen_scans_leave_their_layers() -> None:
    random = np.random.default_rng(5)
    history, free = (ndtree.ScanHistory(dim=2, layers=LAYERS, **OPTIONS) for _ in range(2))
    for key in range(12):
        points, pose = some_scan(random, 2), some_pose(random, 2)
        given = some_measurements(random, len(points), key)
        for one in (history, free):
            one.insert(key, points, pose, layers=given)
        if key == 7:
            history.freeze(4)
    poses = {key: some_pose(random, 2) for key in (4, 9, 11)}
    for one in (history, free):
        one.move(poses)
    assert without_counters(history.map) == without_counters(free.map)
    assert history.num_frozen == 4 and len(free) == 12


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
