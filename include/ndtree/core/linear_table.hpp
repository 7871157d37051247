// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Functions that are needed for every beam, from tables.
#pragma once

#include <array>
#include <cstddef>

#include "ndtree/core/log_odds.hpp"

namespace ndtree {

/// A function of one variable by linear interpolation between equal steps over [lower, upper]; outside, its
/// value at the nearer end. The error is at most max |f''| h² / 8 for steps of length h, and rounding to
/// float.
template <int Steps>
class LinearTable {
 public:
  template <class Function>
  LinearTable(double lower, double upper, Function&& function)
      : lower_(lower), steps_per_unit_(Steps / (upper - lower)) {
    for (int i = 0; i <= Steps; ++i)
      values_[static_cast<std::size_t>(i)] =
          static_cast<float>(function(lower + (upper - lower) * i / Steps));
  }

  [[nodiscard]] double operator()(double x) const {
    const double place = (x - lower_) * steps_per_unit_;
    if (!(place > 0.0)) return static_cast<double>(values_.front());
    if (!(place < Steps)) return static_cast<double>(values_.back());
    const auto step = static_cast<std::size_t>(static_cast<int>(place));
    const auto below = static_cast<double>(values_[step]);
    return below + (place - static_cast<double>(step)) * (static_cast<double>(values_[step + 1]) - below);
  }

 private:
  double lower_;
  double steps_per_unit_;
  std::array<float, Steps + 1> values_;
};

/// normal_cdf() within 1e-6.
[[nodiscard]] inline const LinearTable<2560>& normal_cdf_table() {
  static const LinearTable<2560> table(-5.0, 5.0, normal_cdf);
  return table;
}

}  // namespace ndtree
