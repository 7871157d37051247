// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// What the beams of a list have seen of the children of the leaf that they cross.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "ndtree/core/simd.hpp"
#include "ndtree/mapping/coverage.hpp"
#include "ndtree/mapping/scan/beams.hpp"
#include "ndtree/mapping/scan/crossings.hpp"

namespace ndtree {

/// How wide the beams of a list are, in edges of a child.
struct BeamWidths {
  float per_depth = 0.0f;  ///< At a depth of 1 m [1/m]; 0 if it is the same everywhere:
  float fixed = 0.0f;
};

/// Sums over lists of one child each.
template <int N, int D>
class LeafCoverage {
  using Seen = typename ScanCoverage<N, D>::Seen;

 public:
  explicit LeafCoverage(const ScanBeams<D>& beams) : beams_(beams), width_(Simd::width()) {}

  /// Beams see up to their end points. @param per_child 1 / edge of the child [1/m].
  [[nodiscard]] Seen operator()(const Crossings& list, float per_child, const BeamWidths& widths) const {
    Seen sum;
    for (std::size_t first = 0; first < list.size; first += kChunk) {
      const Crossings chunk = list.part(first, std::min(list.size, first + kChunk));
#ifdef NDTREE_HAS_AVX2
      if constexpr (integer_power(N, D - 1) <= kLargestSum) {
        if (width_ >= 8) {
          add_by_eights(chunk, per_child, widths, sum);
          continue;
        }
      }
#endif
      add_one_by_one(chunk, per_child, widths, sum);
    }
    return sum;
  }

 private:
  static constexpr std::size_t kChunk = 64;
  static constexpr std::int64_t kLargestSum =
      64;  // Widths up to it, eight times, are whole numbers in 32 bits.

  void add_one_by_one(const Crossings& list, float per_child, const BeamWidths& widths, Seen& sum) const {
    const float* const range = beams_.range();
    const float* const slant = beams_.slant();
    for (std::size_t i = 0; i < list.size; ++i) {
      const float enter = list.enter()[i];
      const float exit = std::min(list.exit()[i], range[list.beam[i]]);
      if (!(exit > enter)) continue;
      const float along = slant[list.beam[i]];
      const float middle = 0.5f * (enter + exit) * along;
      const Seen seen =
          ScanCoverage<N, D>::seen((exit - enter) * along * per_child,
                                   widths.per_depth > 0.0f ? middle * widths.per_depth : widths.fixed);
      sum.child += seen.child;
      sum.cell += seen.cell;
      sum.way += seen.way;
    }
  }

#ifdef NDTREE_HAS_AVX2
  NDTREE_AVX2 void add_by_eights(const Crossings& list, float per_child, const BeamWidths& widths,
                                 Seen& sum) const {
    __m256i child = _mm256_setzero_si256();
    __m256i cell = child;
    __m256i way = child;
    const __m256 per_depth = _mm256_set1_ps(widths.per_depth);
    const __m256 fixed = _mm256_set1_ps(widths.fixed);
    for (std::size_t i = 0; i < list.size; i += 8) {
      const __m256i live = detail::first_of_eight(list.size - i);
      const __m256i beam = detail::load_live(list.beam + i, live);
      const __m256 enter = _mm256_loadu_ps(list.enter() + i);
      const __m256 exit =
          _mm256_min_ps(_mm256_loadu_ps(list.exit() + i), _mm256_i32gather_ps(beams_.range(), beam, 4));
      const __m256 along = _mm256_i32gather_ps(beams_.slant(), beam, 4);
      const __m256i sees =
          _mm256_and_si256(live, _mm256_castps_si256(_mm256_cmp_ps(exit, enter, _CMP_GT_OQ)));
      const __m256 middle =
          _mm256_mul_ps(_mm256_mul_ps(_mm256_set1_ps(0.5f), _mm256_add_ps(enter, exit)), along);
      const __m256 width = widths.per_depth > 0.0f ? _mm256_mul_ps(middle, per_depth) : fixed;
      const __m256 units = _mm256_mul_ps(
          _mm256_mul_ps(_mm256_mul_ps(_mm256_sub_ps(exit, enter), along), _mm256_set1_ps(per_child)),
          _mm256_set1_ps(ScanCoverage<N, D>::kUnitsOfOne));
      child = _mm256_add_epi32(
          child, _mm256_and_si256(sees, in_units(units, _mm256_min_ps(width, _mm256_set1_ps(1.0f)))));
      cell = _mm256_add_epi32(
          cell, _mm256_and_si256(sees, in_units(units, _mm256_min_ps(width, _mm256_set1_ps(N)))));
      way = _mm256_add_epi32(way, _mm256_and_si256(sees, _mm256_cvtps_epi32(units)));
    }
    sum.child += sum_of(child);
    sum.cell += sum_of(cell);
    sum.way += sum_of(way);
  }
  NDTREE_AVX2 [[nodiscard]] static __m256i in_units(__m256 units, __m256 width) {
    __m256 area = _mm256_set1_ps(1.0f);
    for (int a = 1; a < D; ++a) area = _mm256_mul_ps(area, width);
    return _mm256_cvtps_epi32(_mm256_mul_ps(units, area));
  }
  NDTREE_AVX2 [[nodiscard]] static std::int64_t sum_of(__m256i v) {
    const __m256i low = _mm256_and_si256(v, _mm256_set1_epi64x(0xffffffff));
    const __m256i both = _mm256_add_epi64(low, _mm256_srli_epi64(v, 32));
    const __m128i half = _mm_add_epi64(_mm256_castsi256_si128(both), _mm256_extracti128_si256(both, 1));
    return _mm_cvtsi128_si64(_mm_add_epi64(half, _mm_unpackhi_epi64(half, half)));
  }
#endif

  const ScanBeams<D>& beams_;
  int width_;
};

}  // namespace ndtree
