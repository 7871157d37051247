// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The natural logarithm where cells split and merge: a table and a short polynomial; and where beams weigh.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>

#include "ndtree/core/rounded.hpp"
#include "ndtree/core/simd.hpp"

namespace ndtree {

namespace detail {

/// 1 / c and log c for the middles c of 256 equal parts of [1, 2), but for the first: c = 1, so that log 1 is
/// 0.
class LogTable {
 public:
  static constexpr int kBits = 8;
  struct alignas(2 * sizeof(double)) Entry {
    double inverse;
    double log;
  };

  LogTable() {
    for (std::size_t i = 0; i < entries_.size(); ++i) {
      const double c =
          i == 0 ? 1.0 : 1.0 + (static_cast<double>(i) + 0.5) / static_cast<double>(entries_.size());
      entries_[i] = {1.0 / c, std::log(c)};
    }
  }
  [[nodiscard]] const Entry& operator[](std::size_t i) const { return entries_[i]; }
#ifdef NDTREE_HAS_EIGHTS
  [[nodiscard]] NDTREE_ALWAYS_INLINE __m128d pair(std::size_t i) const {
    return _mm_load_pd(&entries_[i].inverse);
  }
#endif

 private:
  std::array<Entry, std::size_t{1} << kBits> entries_;
};
inline const LogTable kLogTable;

inline constexpr double kLog2 = 0.69314718055994531;
inline constexpr int kMantissaBits = 52;  // Of a double.
inline constexpr std::uint64_t kMantissa = (std::uint64_t{1} << kMantissaBits) - 1;
inline constexpr int kExponentBias = 1023;

}  // namespace detail

/// log x within 1e-12, for normal numbers x > 0. With x = 2^e m and a c near m, see LogTable,
/// log x = e log 2 + log c + log(1 + r), r = m / c - 1, |r| <= 2^-8. Its latency is short: few of the
/// terms depend on each other.
[[nodiscard]] NDTREE_ALWAYS_INLINE double quick_log(double x) {
  using detail::kMantissa;
  using detail::kMantissaBits;
  constexpr std::int64_t kBias = detail::kExponentBias;
  std::uint64_t bits = 0;
  std::memcpy(&bits, &x, sizeof bits);
  const auto exponent = static_cast<double>(static_cast<std::int64_t>(bits >> kMantissaBits) - kBias);
  const detail::LogTable::Entry& part = detail::kLogTable[static_cast<std::size_t>(
      (bits & kMantissa) >> (kMantissaBits - detail::LogTable::kBits))];
  bits = (bits & kMantissa) | static_cast<std::uint64_t>(kBias) << kMantissaBits;
  double m = 0.0;
  std::memcpy(&m, &bits, sizeof m);
  const double r = rounded(m * part.inverse) - 1.0;
  const double r2 = rounded(r * r);
  const double low = r - rounded(r2 * (1.0 / 2.0));
  const double high = rounded(rounded(r2 * r) * (1.0 / 3.0 - rounded(r * (1.0 / 4.0))));
  return (rounded(exponent * detail::kLog2) + part.log) + (low + high);
}

#ifdef NDTREE_HAS_EIGHTS
/// Of four numbers, to the same bits.
NDTREE_BY_EIGHTS [[nodiscard]] inline __m256d quick_log(__m256d x) {
  const __m256i bits = _mm256_castpd_si256(x);
  const __m256i mantissa =
      _mm256_and_si256(bits, _mm256_set1_epi64x(static_cast<std::int64_t>(detail::kMantissa)));
  const __m128i upper = _mm256_castsi256_si128(  // Words of 32 bits: sign, exponent, and 20 of the mantissa.
      _mm256_permutevar8x32_epi32(bits, _mm256_setr_epi32(1, 3, 5, 7, 1, 3, 5, 7)));
  const __m256d exponent =
      _mm256_cvtepi32_pd(_mm_sub_epi32(_mm_srli_epi32(upper, 20), _mm_set1_epi32(detail::kExponentBias)));
  alignas(16) std::array<std::uint32_t, 4> at;
  _mm_store_si128(reinterpret_cast<__m128i*>(at.data()),
                  _mm_and_si128(_mm_srli_epi32(upper, 20 - detail::LogTable::kBits),
                                _mm_set1_epi32((1 << detail::LogTable::kBits) - 1)));
  const __m256d even = detail::joined(detail::kLogTable.pair(at[0]), detail::kLogTable.pair(at[2]));
  const __m256d odd = detail::joined(detail::kLogTable.pair(at[1]), detail::kLogTable.pair(at[3]));
  const __m256d inverse = _mm256_unpacklo_pd(even, odd);
  const __m256d log = _mm256_unpackhi_pd(even, odd);
  const __m256d one = _mm256_set1_pd(1.0);
  const __m256d m = _mm256_or_pd(_mm256_castsi256_pd(mantissa), one);
  const __m256d r = _mm256_sub_pd(_mm256_mul_pd(m, inverse), one);
  const __m256d r2 = _mm256_mul_pd(r, r);
  const __m256d low = _mm256_sub_pd(r, _mm256_mul_pd(r2, _mm256_set1_pd(1.0 / 2.0)));
  const __m256d high =
      _mm256_mul_pd(_mm256_mul_pd(r2, r),
                    _mm256_sub_pd(_mm256_set1_pd(1.0 / 3.0), _mm256_mul_pd(r, _mm256_set1_pd(1.0 / 4.0))));
  return _mm256_add_pd(_mm256_add_pd(_mm256_mul_pd(exponent, _mm256_set1_pd(detail::kLog2)), log),
                       _mm256_add_pd(low, high));
}
#endif

namespace detail {
/// log(1 + x) / x for 1 + x in [1 / sqrt 2, sqrt 2], so that the product with x is within 1.1e-5.
inline constexpr std::array<float, 5> kRoughLog{0.999919f, -0.4992329f, 0.3373424f, -0.2735059f, 0.1751486f};
inline constexpr std::int32_t kSqrtHalf = 0x3f3504f3;  // As a float.
inline constexpr int kMantissaBitsOfFloat = 23;
}  // namespace detail

/// log x within 1.1e-5, and rounding to float, for normal floats x > 0.
[[nodiscard]] NDTREE_ALWAYS_INLINE float rough_log(float x) {
  constexpr auto& c = detail::kRoughLog;
  std::int32_t bits = 0;
  std::memcpy(&bits, &x, sizeof bits);
  const std::int32_t exponent = (bits - detail::kSqrtHalf) >> detail::kMantissaBitsOfFloat;
  bits -= static_cast<std::int32_t>(static_cast<std::uint32_t>(exponent) << detail::kMantissaBitsOfFloat);
  float m = 0.0f;
  std::memcpy(&m, &bits, sizeof m);
  const float r = m - 1.0f;
  const float r2 = rounded(r * r);
  const float low = c[0] + rounded(c[1] * r);
  const float high = (c[2] + rounded(c[3] * r)) + rounded(c[4] * r2);
  return (rounded(static_cast<float>(exponent) * static_cast<float>(detail::kLog2)) + rounded(low * r)) +
         rounded(high * rounded(r2 * r));
}
#ifdef NDTREE_HAS_EIGHTS
/// Of eight numbers, to the same bits.
NDTREE_BY_EIGHTS [[nodiscard]] NDTREE_ALWAYS_INLINE __m256 rough_log(__m256 x) {
  constexpr auto& c = detail::kRoughLog;
  const __m256i bits = _mm256_castps_si256(x);
  const __m256i exponent = _mm256_srai_epi32(_mm256_sub_epi32(bits, _mm256_set1_epi32(detail::kSqrtHalf)),
                                             detail::kMantissaBitsOfFloat);
  const __m256 m =
      _mm256_castsi256_ps(_mm256_sub_epi32(bits, _mm256_slli_epi32(exponent, detail::kMantissaBitsOfFloat)));
  const __m256 r = _mm256_sub_ps(m, _mm256_set1_ps(1.0f));
  const __m256 r2 = _mm256_mul_ps(r, r);
  const __m256 low = _mm256_add_ps(_mm256_set1_ps(c[0]), _mm256_mul_ps(_mm256_set1_ps(c[1]), r));
  const __m256 high =
      _mm256_add_ps(_mm256_add_ps(_mm256_set1_ps(c[2]), _mm256_mul_ps(_mm256_set1_ps(c[3]), r)),
                    _mm256_mul_ps(_mm256_set1_ps(c[4]), r2));
  return _mm256_add_ps(_mm256_add_ps(_mm256_mul_ps(_mm256_cvtepi32_ps(exponent),
                                                   _mm256_set1_ps(static_cast<float>(detail::kLog2))),
                                     _mm256_mul_ps(low, r)),
                       _mm256_mul_ps(high, _mm256_mul_ps(r2, r)));
}
#endif

}  // namespace ndtree
