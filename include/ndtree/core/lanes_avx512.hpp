// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Sixteen floats side by side, as the partition of lists takes them, with the instructions of AVX-512; see
/// lanes.hpp.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ndtree/core/inline.hpp"
#include "ndtree/core/lanes_avx2.hpp"
#include "ndtree/core/simd.hpp"

#ifdef NDTREE_HAS_SIXTEENS
namespace ndtree {

/// Conditions of sixteen numbers.
struct SixteenMask {
  __mmask16 v;
  [[nodiscard]] static SixteenMask first(std::size_t n) {
    return {static_cast<__mmask16>(n < 16 ? (1u << n) - 1 : 0xffffu)};
  }
  friend SixteenMask operator&(SixteenMask a, SixteenMask b) { return {static_cast<__mmask16>(a.v & b.v)}; }
};

struct SixteenInts {
  __m512i v;
  NDTREE_BY_SIXTEENS [[nodiscard]] static inline SixteenInts load(const std::uint32_t* sixteen) {
    return {_mm512_loadu_si512(sixteen)};
  }
};

/// Sixteen floats: what the partition of lists needs. Functions with a mask of all, as GCC falsely warns
/// about those without (not initialised).
struct SixteenFloats {
  using Ints = SixteenInts;
  using Mask = SixteenMask;
  static constexpr std::size_t kWidth = 16;
  static constexpr __mmask16 kAll = 0xffff;
  __m512 v;

  SixteenFloats() = default;                                                  // Not initialised.
  NDTREE_BY_SIXTEENS inline SixteenFloats(float x) : v(_mm512_set1_ps(x)) {}  // NOLINT: a number is sixteen
  NDTREE_BY_SIXTEENS [[nodiscard]] static inline SixteenFloats from(__m512 x) {
    SixteenFloats result;
    result.v = x;
    return result;
  }
  NDTREE_BY_SIXTEENS friend inline SixteenFloats operator*(const SixteenFloats& a, const SixteenFloats& b) {
    return from(_mm512_mul_ps(a.v, b.v));
  }
  NDTREE_BY_SIXTEENS friend inline SixteenMask operator>(const SixteenFloats& a, const SixteenFloats& b) {
    return {_mm512_cmp_ps_mask(a.v, b.v, _CMP_GT_OQ)};
  }
  /// 0 where a condition does not hold.
  NDTREE_BY_SIXTEENS friend inline SixteenFloats operator&(const SixteenFloats& x, SixteenMask mask) {
    return from(_mm512_maskz_mov_ps(mask.v, x.v));
  }
};
NDTREE_BY_SIXTEENS [[nodiscard]] inline SixteenFloats min_of(const SixteenFloats& a, const SixteenFloats& b) {
  return SixteenFloats::from(_mm512_maskz_min_ps(SixteenFloats::kAll, a.v, b.v));
}
NDTREE_BY_SIXTEENS [[nodiscard]] inline SixteenFloats max_of(const SixteenFloats& a, const SixteenFloats& b) {
  return SixteenFloats::from(_mm512_maskz_max_ps(SixteenFloats::kAll, a.v, b.v));
}
[[nodiscard]] NDTREE_BY_SIXTEENS inline SixteenFloats unfused(const SixteenFloats& x) { return x; }
/// store_packed() of sixteen. In registers: straight to memory takes some processors a hundred cycles.
NDTREE_BY_SIXTEENS inline std::size_t store_packed(const SixteenInts& x, SixteenMask mask,
                                                   std::uint32_t* to) {
  _mm512_storeu_si512(to, _mm512_maskz_compress_epi32(mask.v, x.v));
  return static_cast<std::size_t>(__builtin_popcount(mask.v));
}
/// load_columns() of sixteen rows.
template <class Row>
NDTREE_BY_SIXTEENS NDTREE_ALWAYS_INLINE void load_columns(const Row* table, const std::uint32_t* rows,
                                                          SixteenFloats* columns) {
  static_assert(sizeof(Row) % 16 == 0 && alignof(Row) % 16 == 0, "Row is loaded by four numbers");
  constexpr __mmask16 kAll = SixteenFloats::kAll;
#pragma GCC unroll 8
  for (std::size_t g = 0; g < sizeof(Row) / 16; ++g) {
    __m512 quarters[4];  // Of the rows k, k + 4, k + 8 and k + 12.
#pragma GCC unroll 4
    for (std::size_t k = 0; k < 4; ++k) {
      const float* const first = reinterpret_cast<const float*>(table + rows[k]) + 4 * g;
      const float* const second = reinterpret_cast<const float*>(table + rows[k + 4]) + 4 * g;
      const float* const third = reinterpret_cast<const float*>(table + rows[k + 8]) + 4 * g;
      const float* const last = reinterpret_cast<const float*>(table + rows[k + 12]) + 4 * g;
      __m512 row = _mm512_castps128_ps512(_mm_load_ps(first));
      row = _mm512_insertf32x4(row, _mm_load_ps(second), 1);
      row = _mm512_insertf32x4(row, _mm_load_ps(third), 2);
      quarters[k] = _mm512_insertf32x4(row, _mm_load_ps(last), 3);
    }
    const __m512 ab = _mm512_maskz_unpacklo_ps(kAll, quarters[0], quarters[1]);
    const __m512 cd = _mm512_maskz_unpackhi_ps(kAll, quarters[0], quarters[1]);
    const __m512 ab_next = _mm512_maskz_unpacklo_ps(kAll, quarters[2], quarters[3]);
    const __m512 cd_next = _mm512_maskz_unpackhi_ps(kAll, quarters[2], quarters[3]);
    columns[4 * g].v = _mm512_shuffle_ps(ab, ab_next, 0x44);
    columns[4 * g + 1].v = _mm512_shuffle_ps(ab, ab_next, 0xee);
    columns[4 * g + 2].v = _mm512_shuffle_ps(cd, cd_next, 0x44);
    columns[4 * g + 3].v = _mm512_shuffle_ps(cd, cd_next, 0xee);
  }
}
/// load_columns_once() of sixteen rows.
template <class Row>
NDTREE_BY_SIXTEENS inline void load_columns_once(const Row* table, const std::uint32_t* rows,
                                                 SixteenFloats* columns) {
  load_columns(table, rows, columns);
}

}  // namespace ndtree
#endif
