// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Probability and log-odds, and the normal distribution that the sensor model needs.
#pragma once

#include <cmath>

#include "ndtree/core/simd.hpp"

namespace ndtree {

/// ln(p / (1 - p)) for p in (0, 1).
[[nodiscard]] inline double log_odds(double probability) {
  return std::log(probability / (1.0 - probability));
}

/// Inverse of log_odds(); 0.5 for 0.
[[nodiscard]] inline double probability(double log_odds) { return 1.0 / (1.0 + std::exp(-log_odds)); }

/// F(x; 0, 1): the standard normal distribution function, with full relative precision in the lower tail.
[[nodiscard]] inline double normal_cdf(double x) {
  return unfused(0.5 * std::erfc(-x * 0.70710678118654752440));
}

/// Inverse of normal_cdf() for p in (0, 1), by Newton's method on the monotone function; to about 1e-15.
/// @returns -inf for p <= 0 and +inf for p >= 1.
[[nodiscard]] inline double normal_quantile(double p) {
  if (!(p > 0.0)) return -HUGE_VAL;
  if (!(p < 1.0)) return HUGE_VAL;
  if (p > 0.5) return -normal_quantile(1.0 - p);
  // Start where exp(-x² / 2) / 2, which is nowhere below normal_cdf for x <= 0, equals p: left of the root.
  // There normal_cdf is convex, so the first step passes the root and the others return to it, ever shorter.
  double x = -std::sqrt(-2.0 * std::log(2.0 * p));
  for (int step = 0; step < 100; ++step) {
    const double density = 0.39894228040143267794 * std::exp(-0.5 * x * x);
    const double next = x + (p - normal_cdf(x)) / density;
    if (!(std::abs(next - x) > 1e-16 * std::abs(x))) return next;
    x = next;
  }
  return x;
}

}  // namespace ndtree
