// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Functions that are needed for every beam, from tables.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>

#include "ndtree/core/log_odds.hpp"
#include "ndtree/core/rounded.hpp"
#include "ndtree/core/simd.hpp"

namespace ndtree {

/// A function of one variable by linear interpolation between equal steps over [lower, upper]; outside, its
/// value at the nearer end. The error is at most max |f''| h² / 8 for steps of length h, and rounding to
/// float.
template <int Steps>
class LinearTable {
 public:
  template <class Function>
  LinearTable(double lower, double upper, Function&& function)
      : lower_(static_cast<float>(lower)), steps_per_unit_(static_cast<float>(Steps / (upper - lower))) {
    for (int i = 0; i <= Steps; ++i)
      values_[static_cast<std::size_t>(i)] =
          static_cast<float>(function(lower + rounded((upper - lower) * i / Steps)));
    values_.back() = values_[Steps];
  }

  /// Of NaN, the value at the lower end.
  [[nodiscard]] float operator()(float x) const {
    constexpr auto kSteps = static_cast<float>(Steps);
    const float place = std::min(kSteps, std::max(0.0f, rounded((x - lower_) * steps_per_unit_)));
    const auto step = static_cast<std::size_t>(static_cast<int>(place));
    const float below = values_[step];
    return below +
           rounded((place - static_cast<float>(static_cast<int>(step))) * (values_[step + 1] - below));
  }
#ifdef NDTREE_HAS_EIGHTS
  /// The same of eight numbers, to the last bit.
  NDTREE_BY_EIGHTS [[nodiscard]] NDTREE_ALWAYS_INLINE __m256 operator()(__m256 x) const {
    const __m256 place = _mm256_min_ps(_mm256_max_ps(_mm256_mul_ps(_mm256_sub_ps(x, _mm256_set1_ps(lower_)),
                                                                   _mm256_set1_ps(steps_per_unit_)),
                                                     _mm256_setzero_ps()),
                                       _mm256_set1_ps(static_cast<float>(Steps)));
    const __m256i step = _mm256_cvttps_epi32(place);
    __m256 below;
    __m256 above;
    detail::load_pairs(values_.data(), step, below, above);
    return _mm256_add_ps(
        below, _mm256_mul_ps(_mm256_sub_ps(place, _mm256_cvtepi32_ps(step)), _mm256_sub_ps(above, below)));
  }
#endif

 private:
  float lower_;
  float steps_per_unit_;
  std::array<float, std::size_t{Steps + 2}> values_;  // The last twice.
};

/// normal_cdf() within 1e-6.
[[nodiscard]] inline const LinearTable<2560>& normal_cdf_table() {
  static const LinearTable<2560> table(-5.0, 5.0, normal_cdf);
  return table;
}

}  // namespace ndtree
