// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Pearson's chi-square statistic of two counts, and its critical value with one degree of freedom.
#pragma once

#include "ndtree/core/log_odds.hpp"

namespace ndtree {

/// Value that a chi-square variable with one degree of freedom stays below with probability `significance`:
/// the square of a standard normal quantile (K. Pearson 1900; 0.995 gives 7.879).
[[nodiscard]] inline double chi_square_quantile(double significance) {
  const double z = normal_quantile(0.5 * (1.0 - significance));
  return z * z;
}

/// Sum of (observed - expected)² / expected over hits and misses (Sec. III-A). Both expectations must be > 0.
[[nodiscard]] inline double chi_square_statistic(double hits, double misses, double expected_hits,
                                                 double expected_misses) {
  const double dh = hits - expected_hits;
  const double dm = misses - expected_misses;
  return dh * dh / expected_hits + dm * dm / expected_misses;
}

}  // namespace ndtree
