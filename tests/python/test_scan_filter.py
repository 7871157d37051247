# SPDX-License-Identifier: BSD-3-Clause
"""Beams without return can be left out, from a scan and from a whole comparison."""

import numpy as np
import pytest

import ndtree

ENDPOINTS = np.arange(8.0).reshape(4, 2) + 1
RETURNED = np.array([True, False, True, False])


def test_returned_only_keeps_the_order_and_the_origins():
    one = ndtree.Scan(ENDPOINTS, np.zeros(2), RETURNED, stamp=3.0).returned_only()
    np.testing.assert_array_equal(one.endpoints, ENDPOINTS[[0, 2]])
    assert one.returned is None and one.stamp == 3.0 and one.origin.shape == (2,)
    each = ndtree.Scan(ENDPOINTS, ENDPOINTS + 9, RETURNED).returned_only()
    np.testing.assert_array_equal(each.origin, ENDPOINTS[[0, 2]] + 9)
    whole = ndtree.Scan(ENDPOINTS, np.zeros(2))
    assert whole.returned_only() is whole


def test_a_comparison_without_the_beams_that_did_not_return():
    log = [ndtree.Scan(ENDPOINTS, np.zeros(2), RETURNED)] * 4
    free = ndtree.compare(log, ["adaptive"], held_out=0)
    ignored = ndtree.compare(log, ["adaptive"], held_out=0, no_return="ignore")
    assert free["beams"]["not_returned"] == 8 and ignored["beams"]["not_returned"] == 0
    assert free["beams"]["returned"] == ignored["beams"]["returned"] == 8
    assert ignored["parameters"]["no_return"] == "ignore"
    with pytest.raises(ValueError, match="no_return = 'guess': must be one of free, ignore"):
        ndtree.compare(log, no_return="guess")
