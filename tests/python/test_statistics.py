# SPDX-License-Identifier: BSD-3-Clause
"""The formulae of the library against SciPy."""

import numpy as np
import pytest

from ndtree._native import _core

stats = pytest.importorskip("scipy.stats", reason="SciPy is the oracle here: pip install scipy")
integrate = pytest.importorskip("scipy.integrate")


def test_normal_quantile():
    p = np.concatenate(
        [10.0 ** -np.arange(1, 300, 7), np.linspace(0.001, 0.999, 999), 1 - 10.0 ** -np.arange(1, 15)]
    )
    np.testing.assert_allclose(_core.normal_quantile(p), stats.norm.ppf(p), rtol=1e-12, atol=1e-14)
    assert _core.normal_quantile(0.0) == -np.inf and _core.normal_quantile(1.0) == np.inf


def test_chi_square_quantile():
    significance = np.array([1e-6, 0.01, 0.5, 0.9, 0.95, 0.99, 0.995, 0.999, 1 - 1e-9])
    np.testing.assert_allclose(
        _core.chi_square_quantile(significance), stats.chi2.ppf(significance, 1), rtol=1e-6
    )
    assert _core.chi_square_quantile(0.995) == pytest.approx(7.879438576622417, rel=1e-12)


@pytest.mark.parametrize(
    "miss_occ, hit_free, significance", [(0.05, 0.01, 0.995), (0.3, 0.1, 0.95), (0.5, 0.5, 0.9)]
)
def test_split_test_is_two_chi_square_tests(miss_occ, hit_free, significance):
    hits, misses = (a.ravel() for a in np.meshgrid(np.arange(0, 80), np.arange(0, 80)))
    ours = _core.splits(
        hits, misses, miss_given_occupied=miss_occ, hit_given_free=hit_free, significance=significance
    )
    n = hits + misses
    tested = (misses > n * miss_occ) & (
        hits > n * hit_free
    )  # the others: cleaner than the error rates predict
    h, m, n = hits[tested], misses[tested], n[tested]
    occupied = stats.chisquare([h, m], [n * (1 - miss_occ), n * miss_occ]).pvalue
    free = stats.chisquare([h, m], [n * hit_free, n * (1 - hit_free)]).pvalue
    expected = np.zeros(len(hits), bool)
    expected[tested] = np.maximum(occupied, free) < 1 - significance
    np.testing.assert_array_equal(ours, expected)
    assert 0.1 < expected.mean() < 0.99 or miss_occ == 0.5


def test_sensor_model_is_the_integral_of_its_derivation():
    random = np.random.default_rng(3)
    for _ in range(200):
        distance, sigma = random.uniform(0.5, 30), random.uniform(0.005, 0.5)
        entry = distance + random.uniform(-5, 5) * sigma
        leave = entry + random.uniform(0.01, 8) * sigma
        density = stats.norm(distance, sigma).pdf
        before = (
            integrate.quad(density, distance - 12 * sigma, entry)[0] if entry > distance - 12 * sigma else 0.0
        )
        inside = integrate.quad(density, entry, leave)[0]
        expected = (
            inside + 0.5 * before
        )  # occupied if the obstacle is inside, unknown if before, free if behind
        assert _core.sensor_probability(entry, leave, distance, sigma) == pytest.approx(expected, abs=1e-9)
