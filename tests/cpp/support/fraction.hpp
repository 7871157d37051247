// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Exact quotients of 64-bit integers, for oracles that must not round.
#pragma once

#include <cstdint>
#include <limits>

namespace ndtree::test {

__extension__ typedef __int128 Int128;

/// numerator / denominator; {1, 0} is above all others.
struct Fraction {
  std::int64_t numerator = 0;
  std::int64_t denominator = 1;  // Never negative.

  Fraction(std::int64_t value = 0) : numerator(value) {}  // NOLINT: a whole number is a fraction.
  Fraction(std::int64_t n, std::int64_t d) : numerator(d < 0 ? -n : n), denominator(d < 0 ? -d : d) {}
  static Fraction infinity() { return {1, 0}; }

  /// The nearest double, if numerator and denominator are below 2^53.
  [[nodiscard]] double value() const {
    if (denominator == 0) return std::numeric_limits<double>::infinity();
    return static_cast<double>(numerator) / static_cast<double>(denominator);
  }
  friend bool operator<(const Fraction& a, const Fraction& b) {
    return static_cast<Int128>(a.numerator) * b.denominator <
           static_cast<Int128>(b.numerator) * a.denominator;
  }
};

}  // namespace ndtree::test
