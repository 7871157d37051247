# SPDX-License-Identifier: BSD-3-Clause
"""Layers of maps that follow the poses of their scans."""

import math

import numpy as np
import pytest

import ndtree

LAYERS = {"color": "mean3", "intensity": "mean", "label": "majority", "stamp": "latest"}
OPTIONS = {"min_cell_size": 0.1, "max_cell_size": 1.6, "range_sigma": 0.02}


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
