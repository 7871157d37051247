# SPDX-License-Identifier: BSD-3-Clause
"""Beams without return can be left out, from a scan and from a whole comparison; beams keep their sigmas."""

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


def test_the_sigma_of_each_beam_is_kept_checked_and_handed_on():
    sigma = np.arange(4, dtype=np.float32) + 1
    scan = ndtree.Scan(ENDPOINTS, np.zeros(2), RETURNED, range_sigma=sigma)
    np.testing.assert_array_equal(scan.returned_only().range_sigma, sigma[[0, 2]])
    assert scan.range_sigma.dtype == np.float32
    assert ndtree.Scan(ENDPOINTS, np.zeros(2), RETURNED).returned_only().range_sigma is None

    class Target:
        def insert(self, endpoints, origin, **options):
            return options

    np.testing.assert_array_equal(scan.insert_into(Target())["range_sigma"], sigma)
    assert "range_sigma" not in ndtree.Scan(ENDPOINTS, np.zeros(2)).insert_into(Target())


@pytest.mark.parametrize(
    "sigma, message",
    [
        (np.ones(3), r"range_sigma has shape \(3,\): must be \(4,\) for endpoints of shape \(4, 2\)"),
        ([1, 2, 0, 4], "range_sigma = 0 m of beam 2: must be > 0 and finite"),
        ([1, -1, 2, 4], "range_sigma = -1 m of beam 1: must be > 0 and finite"),
        ([1, 1, 2, np.inf], "range_sigma = inf m of beam 3"),
        ([np.nan, 1, 2, 3], "range_sigma = nan m of beam 0"),
    ],
)
def test_a_wrong_sigma_is_refused(sigma, message):
    with pytest.raises(ValueError, match=message):
        ndtree.Scan(ENDPOINTS, np.zeros(2), range_sigma=sigma)


def test_a_comparison_without_the_beams_that_did_not_return():
    log = [ndtree.Scan(ENDPOINTS, np.zeros(2), RETURNED)] * 4
    free = ndtree.compare(log, ["adaptive"], held_out=0, no_return="free")
    ignored = ndtree.compare(log, ["adaptive"], held_out=0, no_return="ignore")
    assert free["beams"]["not_returned"] == 8 and ignored["beams"]["not_returned"] == 0
    assert free["beams"]["returned"] == ignored["beams"]["returned"] == 8
    assert ignored["parameters"]["no_return"] == "ignore"
    with pytest.raises(ValueError, match="no_return = 'guess': must be one of free, ignore"):
        ndtree.compare(log, no_return="guess")
