// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// A small random generator whose numbers do not depend on the standard library.
#pragma once

#include <cmath>
#include <cstdint>

namespace ndtree {

/// SplitMix64 (Steele, Lea, Flood, "Fast splittable pseudorandom number generators", 2014).
/// Equal seed and stream give equal numbers on every platform; different ones are unrelated.
class Random {
 public:
  explicit Random(std::uint64_t seed, std::uint64_t stream = 0) : state_(mix(seed + kStep) ^ mix(~stream)) {}

  std::uint64_t next() { return mix(state_ += kStep); }

  /// Uniform in [0, 1), a multiple of 2^-53.
  double uniform() { return static_cast<double>(next() >> 11) * 0x1.0p-53; }

  /// Uniform in [lower, upper).
  double uniform(double lower, double upper) { return lower + (upper - lower) * uniform(); }

  /// Standard normal by Box and Muller's transform. Takes two numbers and keeps none, so that the next draw
  /// does not depend on what was drawn before.
  double normal() {
    constexpr double kTwoPi = 6.28318530717958648;
    const double radius = std::sqrt(-2.0 * std::log(1.0 - uniform()));
    return radius * std::cos(kTwoPi * uniform());
  }

 private:
  static constexpr std::uint64_t kStep = 0x9E3779B97F4A7C15ULL;

  static std::uint64_t mix(std::uint64_t z) {
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9ULL;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBULL;
    return z ^ (z >> 31);
  }

  std::uint64_t state_;
};

}  // namespace ndtree
