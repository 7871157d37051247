// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// How noisy the beams of a scan are, and what they have surely passed.
#pragma once

#include <algorithm>
#include <array>
#include <limits>

#include "ndtree/core/rounded.hpp"
#include "ndtree/core/simd.hpp"

namespace ndtree {

/// How far before its reach a beam has surely passed all cells, of any size, that end there: so much, and as
/// noise grows with the square of the range, so much for each square metre of it.
struct FreeMargin {
  float fixed = 0.0f;
  float growth = 0.0f;
};

/// The least and the largest noise of some beams, and the margin that they need.
class BeamNoise {
 public:
  explicit BeamNoise(float margin_growth = 0.0f) : growth_(margin_growth) {
    smallest_.fill(std::numeric_limits<float>::infinity());
    largest_.fill(0.0f);
    margin_.fill(0.0f);
  }
  /// @param pass what the beam has surely passed ends before this distance.
  void add(float sigma, float reach, float pass) {
    smallest_[0] = std::min(smallest_[0], sigma);
    largest_[0] = std::max(largest_[0], sigma);
    const float grown = rounded(rounded(growth_ * reach) * reach);
    margin_[0] = std::max(margin_[0], rounded(reach * kAboveRounding) - pass - grown);
  }
#ifdef NDTREE_HAS_EIGHTS
  NDTREE_BY_EIGHTS NDTREE_ALWAYS_INLINE void add(__m256 sigma, __m256 reach, __m256 pass) {
    _mm256_store_ps(smallest_.data(), _mm256_min_ps(_mm256_load_ps(smallest_.data()), sigma));
    _mm256_store_ps(largest_.data(), _mm256_max_ps(_mm256_load_ps(largest_.data()), sigma));
    const __m256 grown = _mm256_mul_ps(_mm256_mul_ps(_mm256_set1_ps(growth_), reach), reach);
    const __m256 margin =
        _mm256_sub_ps(_mm256_sub_ps(_mm256_mul_ps(reach, _mm256_set1_ps(kAboveRounding)), pass), grown);
    _mm256_store_ps(margin_.data(), _mm256_max_ps(_mm256_load_ps(margin_.data()), margin));
  }
#endif
  void add(const BeamNoise& other) {
    smallest_[0] = std::min(smallest_[0], other.smallest());
    largest_[0] = std::max(largest_[0], other.largest());
    margin_[0] = std::max(margin_[0], other.margin().fixed);
  }
  // Of standard deviations [m].
  [[nodiscard]] float smallest() const { return *std::min_element(smallest_.begin(), smallest_.end()); }
  [[nodiscard]] float largest() const { return *std::max_element(largest_.begin(), largest_.end()); }
  [[nodiscard]] FreeMargin margin() const {
    return {*std::max_element(margin_.begin(), margin_.end()), growth_};
  }

 private:
  static constexpr float kAboveRounding = 1.0f + 0x1p-21f;
  float growth_;
  // Of every eighth of them; the first alone without vectors.
  alignas(32) std::array<float, 8> smallest_;
  alignas(32) std::array<float, 8> largest_;
  alignas(32) std::array<float, 8> margin_;
};

}  // namespace ndtree
