// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Functions that are needed for every beam, from tables that fit registers.
#pragma once

#include <array>
#include <cstddef>

#include "ndtree/core/lanes.hpp"
#include "ndtree/core/simd.hpp"

namespace ndtree {

/// A smooth function of x >= 0 by eight cubics, each of an eighth of [0, upper], behind which it keeps the
/// value that it has there, but for rounding. A cubic has the function's values at both ends of its part and
/// at a quarter of it from each, so that the error is at most max |f''''| h⁴ / 1536 for parts of length h,
/// and rounding to float. Eight numbers are found in a register by others, without asking memory for each.
class CubicTable {
 public:
  template <class Function>
  CubicTable(double upper, Function&& function) : parts_per_unit_(static_cast<float>(kParts / upper)) {
    for (std::size_t part = 0; part < kParts; ++part) {
      const auto at = [&](double quarters) {
        return function(upper * ((static_cast<double>(part) + 0.25 * quarters) / kParts));
      };
      const double first = at(0.0);
      const double low = at(1.0) - first;
      const double high = at(3.0) - first;
      const double last = at(4.0) - first;
      // With t = 1/4, 3/4 and 1 in their equations.
      factors_[0][part] = static_cast<float>(first);
      factors_[1][part] = static_cast<float>(unfused(8.0 * low) - unfused(8.0 / 3.0 * high) + last);
      factors_[2][part] = static_cast<float>(unfused(40.0 / 3.0 * high) - unfused(56.0 / 3.0 * low) -
                                             unfused(16.0 / 3.0 * last));
      factors_[3][part] = static_cast<float>(unfused(32.0 / 3.0 * low) - unfused(32.0 / 3.0 * high) +
                                             unfused(16.0 / 3.0 * last));
    }
  }

  /// @param x >= 0; one number, or eight: see lanes.hpp.
  template <class Floats>
  [[nodiscard]] NDTREE_ALWAYS_INLINE Floats operator()(const Floats& x) const {
    const Floats place = min_of(unfused(x * parts_per_unit_), kEnd);  // Of NaN, the end.
    const auto part = truncated(place);
    const Floats t = place - to_floats(part);
    Floats value = one_of_eight(factors_[3].data(), part);
#pragma GCC unroll 4
    for (std::size_t left = 3; left > 0; --left)
      value = unfused(value * t) + one_of_eight(factors_[left - 1].data(), part);
    return value;
  }

 private:
  static constexpr std::size_t kParts = 8;
  static constexpr float kEnd = 0x1.fffffep2f;  // The largest below 8.
  float parts_per_unit_;
  std::array<std::array<float, kParts>, 4> factors_;  // Of each power of the place in a part, from 0 to 1.
};

}  // namespace ndtree
