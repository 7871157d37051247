// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Random numbers for properties: the same on every platform, from a seed that a failure shows.
#pragma once

#include <cstdint>
#include <string>

namespace ndtree::test {

/// A counter that strides by an odd number, and a hash of it.
class Random {
 public:
  explicit Random(std::uint64_t seed) : seed_(seed), counter_(seed * 0xD1342543DE82EF95u) {}

  /// For SCOPED_TRACE.
  [[nodiscard]] std::string trace() const { return "seed " + std::to_string(seed_); }

  std::uint64_t bits() {
    std::uint64_t z = counter_ += 0x9E3779B97F4A7C15u;
    z = (z ^ (z >> 32)) * 0xD6E8FEB86659FD93u;
    z = (z ^ (z >> 32)) * 0xD6E8FEB86659FD93u;
    return z ^ (z >> 32);
  }
  /// In [0, 1).
  double uniform() { return static_cast<double>(bits() >> 11) * 0x1p-53; }
  /// In [lower, upper).
  double uniform(double lower, double upper) { return lower + (upper - lower) * uniform(); }
  /// In [first, last], both included.
  int integer(int first, int last) {
    return first + static_cast<int>(bits() % static_cast<std::uint64_t>(last - first + 1));
  }
  /// The sum of twelve uniform numbers: nearly normal, and never beyond six.
  double normal() {
    double sum = -6.0;
    for (int i = 0; i < 12; ++i) sum += uniform();
    return sum;
  }
  bool chance(double probability) { return uniform() < probability; }

 private:
  std::uint64_t seed_;
  std::uint64_t counter_;
};

}  // namespace ndtree::test
