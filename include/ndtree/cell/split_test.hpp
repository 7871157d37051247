// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// When hits and misses contradict both "entirely occupied" and "entirely free" (Sec. III-A).
#pragma once

#include <algorithm>

#include "ndtree/cell/occupancy_cell.hpp"
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

struct SplitOptions {
  double miss_given_occupied = 0.1;  ///< p(miss|occ): fraction of beams that pass an occupied cell.
  double hit_given_free = 0.05;      ///< p(hit|free): fraction of beams that end in a free cell.
  double significance = 0.995;       ///< Confidence with which both hypotheses must be rejected.
  /// Probability of partial occupancy above which an occupied cell splits, unless predicted to re-merge.
  double split_probability = 0.7;
  /// Least probability of a smallest cell that would split if it could; 0: all its beams decide.
  double partial_probability = 0.45;
};

/// Chi-square test that a cell is neither entirely occupied nor entirely free (Sec. III-A).
/// Skipped where the counts are cleaner than the error rates predict: no more misses than an occupied cell
/// would show, or no more hits than a free one. O(1).
class ChiSquareSplitTest {
 public:
  explicit ChiSquareSplitTest(const SplitOptions& options)
      : options_(options), critical_value_(chi_square_quantile(options.significance)) {}

  /// @returns true if both hypotheses are rejected: the cell should split.
  [[nodiscard]] bool operator()(std::uint32_t hits, std::uint32_t misses) const {
    if (hits == 0 || misses == 0) return false;
    const double n = static_cast<double>(hits) + static_cast<double>(misses);
    const double misses_if_occupied = n * options_.miss_given_occupied;
    const double hits_if_free = n * options_.hit_given_free;
    if (misses <= misses_if_occupied || hits <= hits_if_free) return false;
    const double occupied = chi_square_statistic(hits, misses, n - misses_if_occupied, misses_if_occupied);
    const double free = chi_square_statistic(hits, misses, hits_if_free, n - hits_if_free);
    return std::min(occupied, free) > critical_value_;
  }
  [[nodiscard]] bool operator()(const OccupancyCell& cell) const {
    return (*this)(cell.hits(), cell.misses());
  }

  [[nodiscard]] double critical_value() const { return critical_value_; }

 private:
  SplitOptions options_;
  double critical_value_;
};

}  // namespace ndtree
