// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Eight floats or whole numbers and four doubles side by side, with the instructions of AVX2; see lanes.hpp.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "ndtree/core/inline.hpp"
#include "ndtree/core/simd.hpp"

#ifdef NDTREE_HAS_EIGHTS
namespace ndtree {

// Functions that one instruction is. Its vectors are those in the types, `v`.
#define NDTREE_OF_ONE(Result, name, Type, instruction) \
  [[nodiscard]] NDTREE_BY_EIGHTS inline Result name(const Type& x) { return Result::from(instruction(x.v)); }
#define NDTREE_OF_TWO(Type, name, instruction)                                    \
  [[nodiscard]] NDTREE_BY_EIGHTS inline Type name(const Type& a, const Type& b) { \
    return Type::from(instruction(a.v, b.v));                                     \
  }
#define NDTREE_COMPARED(Mask, Type, name, instruction, how)                       \
  [[nodiscard]] NDTREE_BY_EIGHTS inline Mask name(const Type& a, const Type& b) { \
    return {instruction(a.v, b.v, how)};                                          \
  }

/// Conditions of eight numbers.
struct EightMask {
  __m256 v;

  /// Of the first n of eight. @pre n < 2^31.
  NDTREE_BY_EIGHTS [[nodiscard]] static inline EightMask first(std::size_t n) {
    return {_mm256_castsi256_ps(_mm256_cmpgt_epi32(_mm256_set1_epi32(static_cast<int>(n)),
                                                   _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7)))};
  }
  /// Of those whose bit is set.
  NDTREE_BY_EIGHTS [[nodiscard]] static inline EightMask of_set(unsigned set) {
    const __m256i bit = _mm256_setr_epi32(1, 2, 4, 8, 16, 32, 64, 128);
    return {_mm256_castsi256_ps(
        _mm256_cmpeq_epi32(_mm256_and_si256(_mm256_set1_epi32(static_cast<int>(set)), bit), bit))};
  }
  NDTREE_BY_EIGHTS [[nodiscard]] static inline EightMask none() { return {_mm256_setzero_ps()}; }
  NDTREE_BY_EIGHTS [[nodiscard]] static inline EightMask all() {
    return {_mm256_castsi256_ps(_mm256_set1_epi32(-1))};
  }
  /// Bit k is number k's condition.
  NDTREE_BY_EIGHTS [[nodiscard]] inline unsigned set() const {
    return static_cast<unsigned>(_mm256_movemask_ps(v));
  }
  NDTREE_BY_EIGHTS [[nodiscard]] inline unsigned count() const {
    return static_cast<unsigned>(__builtin_popcount(set()));
  }
  NDTREE_BY_EIGHTS [[nodiscard]] inline EightMask without(const EightMask& others) const {
    return {_mm256_andnot_ps(others.v, v)};
  }
  /// Whether each that holds here also holds there.
  NDTREE_BY_EIGHTS [[nodiscard]] inline bool is_within(const EightMask& others) const {
    return _mm256_testc_si256(_mm256_castps_si256(others.v), _mm256_castps_si256(v)) != 0;
  }
  NDTREE_BY_EIGHTS [[nodiscard]] inline bool overlaps(const EightMask& others) const {
    return _mm256_testz_si256(_mm256_castps_si256(others.v), _mm256_castps_si256(v)) == 0;
  }
  NDTREE_BY_EIGHTS friend inline EightMask operator&(const EightMask& a, const EightMask& b) {
    return {_mm256_and_ps(a.v, b.v)};
  }
  NDTREE_BY_EIGHTS friend inline EightMask operator|(const EightMask& a, const EightMask& b) {
    return {_mm256_or_ps(a.v, b.v)};
  }
};

/// Eight whole numbers of 32 bits; sums and products wrap around.
struct EightInts {
  __m256i v;

  EightInts() = default;                                                          // Not initialised.
  NDTREE_BY_EIGHTS inline EightInts(std::int32_t x) : v(_mm256_set1_epi32(x)) {}  // NOLINT: a number is eight
  NDTREE_BY_EIGHTS inline EightInts(std::uint32_t x)                              // NOLINT: a number is eight
      : v(_mm256_set1_epi32(static_cast<std::int32_t>(x))) {}
  NDTREE_BY_EIGHTS [[nodiscard]] static inline EightInts from(__m256i x) {
    EightInts result;
    result.v = x;
    return result;
  }
  NDTREE_BY_EIGHTS [[nodiscard]] static inline EightInts load(const std::uint32_t* eight) {
    return from(_mm256_loadu_si256(reinterpret_cast<const __m256i*>(eight)));
  }
  NDTREE_BY_EIGHTS inline void store(std::uint32_t* eight) const {
    _mm256_storeu_si256(reinterpret_cast<__m256i*>(eight), v);
  }
  /// 0 to 7.
  NDTREE_BY_EIGHTS [[nodiscard]] static inline EightInts places() {
    return from(_mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7));
  }
  /// -1 where a condition holds, else 0.
  NDTREE_BY_EIGHTS [[nodiscard]] static inline EightInts minus_one_where(const EightMask& mask) {
    return from(_mm256_castps_si256(mask.v));
  }
  NDTREE_BY_EIGHTS friend inline EightMask operator==(const EightInts& a, const EightInts& b) {
    return {_mm256_castsi256_ps(_mm256_cmpeq_epi32(a.v, b.v))};
  }
  NDTREE_BY_EIGHTS friend inline EightMask operator>(const EightInts& a, const EightInts& b) {
    return {_mm256_castsi256_ps(_mm256_cmpgt_epi32(a.v, b.v))};
  }
  /// 0 where a condition does not hold.
  NDTREE_BY_EIGHTS friend inline EightInts operator&(const EightInts& x, const EightMask& mask) {
    return from(_mm256_and_si256(x.v, _mm256_castps_si256(mask.v)));
  }
  /// 0 where a condition holds.
  NDTREE_BY_EIGHTS [[nodiscard]] inline EightInts without(const EightMask& mask) const {
    return from(_mm256_andnot_si256(_mm256_castps_si256(mask.v), v));
  }
  NDTREE_BY_EIGHTS inline EightInts& operator+=(const EightInts& b) {
    v = _mm256_add_epi32(v, b.v);
    return *this;
  }
};
NDTREE_OF_TWO(EightInts, operator+, _mm256_add_epi32)
NDTREE_OF_TWO(EightInts, operator-, _mm256_sub_epi32)
NDTREE_OF_TWO(EightInts, operator*, _mm256_mullo_epi32)
NDTREE_OF_TWO(EightInts, operator&, _mm256_and_si256)
NDTREE_OF_TWO(EightInts, operator|, _mm256_or_si256)
NDTREE_OF_TWO(EightInts, operator^, _mm256_xor_si256)

NDTREE_OF_TWO(EightInts, max_of, _mm256_max_epi32)
/// Of numbers without sign.
NDTREE_OF_TWO(EightInts, unsigned_max_of, _mm256_max_epu32)
NDTREE_OF_TWO(EightInts, unsigned_min_of, _mm256_min_epu32)
[[nodiscard]] NDTREE_BY_EIGHTS inline EightInts select(const EightMask& condition, const EightInts& yes,
                                                       const EightInts& no) {
  return EightInts::from(_mm256_blendv_epi8(no.v, yes.v, _mm256_castps_si256(condition.v)));
}
[[nodiscard]] NDTREE_BY_EIGHTS inline EightInts shifted_left(const EightInts& x, int by) {
  return EightInts::from(_mm256_slli_epi32(x.v, by));
}
[[nodiscard]] NDTREE_BY_EIGHTS inline EightInts shifted_right(const EightInts& x, int by) {
  return EightInts::from(_mm256_srai_epi32(x.v, by));
}
/// Zeros move in from the left.
[[nodiscard]] NDTREE_BY_EIGHTS inline EightInts unsigned_shifted_right(const EightInts& x, int by) {
  return EightInts::from(_mm256_srli_epi32(x.v, by));
}
/// Each by a number of its own.
NDTREE_OF_TWO(EightInts, shifted_left, _mm256_sllv_epi32)
NDTREE_OF_TWO(EightInts, unsigned_shifted_right, _mm256_srlv_epi32)

/// Eight floats.
struct EightFloats {
  using Ints = EightInts;
  using Mask = EightMask;
  static constexpr std::size_t kWidth = 8;
  __m256 v;

  EightFloats() = default;                                                // Not initialised.
  NDTREE_BY_EIGHTS inline EightFloats(float x) : v(_mm256_set1_ps(x)) {}  // NOLINT: a number is eight
  NDTREE_BY_EIGHTS [[nodiscard]] static inline EightFloats from(__m256 x) {
    EightFloats result;
    result.v = x;
    return result;
  }
  NDTREE_BY_EIGHTS [[nodiscard]] static inline EightFloats load(const float* eight) {
    return from(_mm256_loadu_ps(eight));
  }
  NDTREE_BY_EIGHTS inline void store(float* eight) const { _mm256_storeu_ps(eight, v); }
  /// 0 where a condition does not hold.
  NDTREE_BY_EIGHTS friend inline EightFloats operator&(const EightFloats& x, const EightMask& mask) {
    return from(_mm256_and_ps(x.v, mask.v));
  }
};
NDTREE_OF_TWO(EightFloats, operator+, _mm256_add_ps)
NDTREE_OF_TWO(EightFloats, operator-, _mm256_sub_ps)
NDTREE_OF_TWO(EightFloats, operator*, _mm256_mul_ps)
NDTREE_OF_TWO(EightFloats, operator/, _mm256_div_ps)
NDTREE_COMPARED(EightMask, EightFloats, operator<, _mm256_cmp_ps, _CMP_LT_OQ)
NDTREE_COMPARED(EightMask, EightFloats, operator<=, _mm256_cmp_ps, _CMP_LE_OQ)
NDTREE_COMPARED(EightMask, EightFloats, operator>, _mm256_cmp_ps, _CMP_GT_OQ)
NDTREE_COMPARED(EightMask, EightFloats, operator>=, _mm256_cmp_ps, _CMP_GE_OQ)
NDTREE_COMPARED(EightMask, EightFloats, operator==, _mm256_cmp_ps, _CMP_EQ_OQ)

NDTREE_BY_EIGHTS inline void load_from(EightFloats& x, const float* from) { x = EightFloats::load(from); }
NDTREE_BY_EIGHTS inline void store_to(const EightFloats& x, float* to) { x.store(to); }
NDTREE_OF_TWO(EightFloats, min_of, _mm256_min_ps)
NDTREE_OF_TWO(EightFloats, max_of, _mm256_max_ps)
[[nodiscard]] NDTREE_BY_EIGHTS inline EightFloats abs_of(const EightFloats& x) {
  return EightFloats::from(_mm256_andnot_ps(_mm256_set1_ps(-0.0f), x.v));
}
[[nodiscard]] NDTREE_BY_EIGHTS inline EightFloats with_sign(const EightFloats& x, const EightFloats& sign) {
  return EightFloats::from(_mm256_or_ps(x.v, _mm256_and_ps(_mm256_set1_ps(-0.0f), sign.v)));
}
NDTREE_OF_ONE(EightFloats, sqrt_of, EightFloats, _mm256_sqrt_ps)
[[nodiscard]] NDTREE_BY_EIGHTS inline EightFloats select(const EightMask& condition, const EightFloats& yes,
                                                         const EightFloats& no) {
  return EightFloats::from(_mm256_blendv_ps(no.v, yes.v, condition.v));
}
NDTREE_OF_ONE(EightInts, truncated, EightFloats, _mm256_cvttps_epi32)
/// As the function for one float: the even one if two are as near.
NDTREE_OF_ONE(EightInts, nearest_integer, EightFloats, _mm256_cvtps_epi32)
NDTREE_OF_ONE(EightFloats, to_floats, EightInts, _mm256_cvtepi32_ps)
NDTREE_OF_ONE(EightInts, bits_of, EightFloats, _mm256_castps_si256)
[[nodiscard]] NDTREE_BY_EIGHTS inline EightInts words_of(const EightFloats& x) { return bits_of(x); }
NDTREE_OF_ONE(EightFloats, float_of, EightInts, _mm256_castsi256_ps)
/// Numbers of a table in memory where a condition holds, else 0; others are not read.
[[nodiscard]] NDTREE_BY_EIGHTS inline EightFloats gathered(const float* table, const EightInts& at,
                                                           const EightMask& where) {
  return EightFloats::from(_mm256_mask_i32gather_ps(_mm256_setzero_ps(), table, at.v, where.v, 4));
}
/// One permutation of a register; no gather.
[[nodiscard]] NDTREE_BY_EIGHTS inline EightFloats one_of_eight(const float* table, const EightInts& at) {
  return EightFloats::from(_mm256_permutevar8x32_ps(_mm256_loadu_ps(table), at.v));
}
/// Eight of four numbers in memory.
[[nodiscard]] NDTREE_BY_EIGHTS inline EightFloats of_four(const float* table, const std::uint32_t* at) {
  return EightFloats::from(_mm256_permutevar_ps(_mm256_broadcast_ps(reinterpret_cast<const __m128*>(table)),
                                                EightInts::load(at).v));
}
/// Products of vectors are rounded in any case.
[[nodiscard]] NDTREE_BY_EIGHTS inline EightFloats unfused(const EightFloats& x) { return x; }

/// Conditions of four doubles.
struct FourMask {
  __m256d v;
  NDTREE_BY_EIGHTS [[nodiscard]] static inline FourMask none() { return {_mm256_setzero_pd()}; }
  NDTREE_BY_EIGHTS [[nodiscard]] inline unsigned set() const {
    return static_cast<unsigned>(_mm256_movemask_pd(v));
  }
  NDTREE_BY_EIGHTS friend inline FourMask operator|(const FourMask& a, const FourMask& b) {
    return {_mm256_or_pd(a.v, b.v)};
  }
};

/// Four doubles.
struct FourDoubles {
  __m256d v;

  FourDoubles() = default;                                                 // Not initialised.
  NDTREE_BY_EIGHTS inline FourDoubles(double x) : v(_mm256_set1_pd(x)) {}  // NOLINT: a number is four
  NDTREE_BY_EIGHTS [[nodiscard]] static inline FourDoubles from(__m256d x) {
    FourDoubles result;
    result.v = x;
    return result;
  }
  NDTREE_BY_EIGHTS [[nodiscard]] static inline FourDoubles load(const double* four) {
    return from(_mm256_loadu_pd(four));
  }
  NDTREE_BY_EIGHTS [[nodiscard]] static inline FourDoubles of(double a, double b, double c, double d) {
    return from(_mm256_setr_pd(a, b, c, d));
  }
  NDTREE_BY_EIGHTS inline void store(double* four) const { _mm256_storeu_pd(four, v); }
  NDTREE_BY_EIGHTS friend inline FourDoubles operator&(const FourDoubles& x, const FourMask& mask) {
    return from(_mm256_and_pd(x.v, mask.v));
  }
};
NDTREE_OF_TWO(FourDoubles, operator+, _mm256_add_pd)
NDTREE_OF_TWO(FourDoubles, operator-, _mm256_sub_pd)
NDTREE_OF_TWO(FourDoubles, operator*, _mm256_mul_pd)
NDTREE_OF_TWO(FourDoubles, operator/, _mm256_div_pd)
NDTREE_COMPARED(FourMask, FourDoubles, operator<, _mm256_cmp_pd, _CMP_LT_OQ)
NDTREE_COMPARED(FourMask, FourDoubles, operator<=, _mm256_cmp_pd, _CMP_LE_OQ)
NDTREE_COMPARED(FourMask, FourDoubles, operator>, _mm256_cmp_pd, _CMP_GT_OQ)

NDTREE_OF_TWO(FourDoubles, min_of, _mm256_min_pd)
NDTREE_OF_TWO(FourDoubles, max_of, _mm256_max_pd)
[[nodiscard]] NDTREE_BY_EIGHTS inline FourDoubles abs_of(const FourDoubles& x) {
  return FourDoubles::from(_mm256_andnot_pd(_mm256_set1_pd(-0.0), x.v));
}
NDTREE_OF_ONE(FourDoubles, floor_of, FourDoubles, _mm256_floor_pd)
[[nodiscard]] NDTREE_BY_EIGHTS inline FourDoubles select(const FourMask& condition, const FourDoubles& yes,
                                                         const FourDoubles& no) {
  return FourDoubles::from(_mm256_blendv_pd(no.v, yes.v, condition.v));
}
[[nodiscard]] NDTREE_BY_EIGHTS inline FourDoubles unfused(const FourDoubles& x) { return x; }

/// Eight doubles, as two times four.
struct EightDoubles {
  FourDoubles low;
  FourDoubles high;
};
[[nodiscard]] NDTREE_BY_EIGHTS inline EightFloats to_floats(const FourDoubles& low, const FourDoubles& high) {
  return EightFloats::from(
      _mm256_insertf128_ps(_mm256_castps128_ps256(_mm256_cvtpd_ps(low.v)), _mm256_cvtpd_ps(high.v), 1));
}
[[nodiscard]] NDTREE_BY_EIGHTS inline EightInts to_ints(const FourDoubles& low, const FourDoubles& high) {
  return EightInts::from(_mm256_inserti128_si256(_mm256_castsi128_si256(_mm256_cvtpd_epi32(low.v)),
                                                 _mm256_cvtpd_epi32(high.v), 1));
}
[[nodiscard]] NDTREE_BY_EIGHTS inline EightDoubles to_doubles(const EightFloats& x) {
  return {FourDoubles::from(_mm256_cvtps_pd(_mm256_castps256_ps128(x.v))),
          FourDoubles::from(_mm256_cvtps_pd(_mm256_extractf128_ps(x.v, 1)))};
}
/// Four doubles, stored as floats.
NDTREE_BY_EIGHTS inline void store_as_floats(const FourDoubles& x, float* four) {
  _mm_storeu_ps(four, _mm256_cvtpd_ps(x.v));
}

/// Of four normal doubles x > 0: x = 2^exponent mantissa, and the first bits of the mantissa behind the
/// point.
struct FourLogParts {
  FourDoubles exponent;
  FourDoubles mantissa;  ///< In [1, 2).
  alignas(16) std::array<std::uint32_t, 4> bits;
};
NDTREE_BY_EIGHTS [[nodiscard]] inline FourLogParts log_parts_of(const FourDoubles& x, int num_bits) {
  constexpr std::int64_t kMantissa = (std::int64_t{1} << 52) - 1;
  const __m256i bits = _mm256_castpd_si256(x.v);
  const __m128i upper = _mm256_castsi256_si128(  // Words of 32 bits: sign, exponent, and 20 of the mantissa.
      _mm256_permutevar8x32_epi32(bits, _mm256_setr_epi32(1, 3, 5, 7, 1, 3, 5, 7)));
  FourLogParts parts;
  parts.exponent.v = _mm256_cvtepi32_pd(_mm_sub_epi32(_mm_srli_epi32(upper, 20), _mm_set1_epi32(1023)));
  parts.mantissa.v = _mm256_or_pd(_mm256_castsi256_pd(_mm256_and_si256(bits, _mm256_set1_epi64x(kMantissa))),
                                  _mm256_set1_pd(1.0));
  _mm_store_si128(reinterpret_cast<__m128i*>(parts.bits.data()),
                  _mm_and_si128(_mm_srli_epi32(upper, 20 - num_bits), _mm_set1_epi32((1 << num_bits) - 1)));
  return parts;
}
/// The first and the second of each of four pairs that are aligned.
NDTREE_BY_EIGHTS inline void load_pairs(const double* a, const double* b, const double* c, const double* d,
                                        FourDoubles& first, FourDoubles& second) {
  const __m256d even = _mm256_insertf128_pd(_mm256_castpd128_pd256(_mm_load_pd(a)), _mm_load_pd(c), 1);
  const __m256d odd = _mm256_insertf128_pd(_mm256_castpd128_pd256(_mm_load_pd(b)), _mm_load_pd(d), 1);
  first.v = _mm256_unpacklo_pd(even, odd);
  second.v = _mm256_unpackhi_pd(even, odd);
}

/// Four whole numbers of 32 bits.
struct FourInts {
  __m128i v;
  template <int kAt>
  NDTREE_BY_EIGHTS [[nodiscard]] inline std::uint32_t get() const {
    return static_cast<std::uint32_t>(_mm_extract_epi32(v, kAt));
  }
  NDTREE_BY_EIGHTS inline void store(std::uint32_t* four) const {
    _mm_storeu_si128(reinterpret_cast<__m128i*>(four), v);
  }
};
/// The sums of the numbers of four vectors.
NDTREE_BY_EIGHTS [[nodiscard]] inline FourInts sums_of(const EightInts& a, const EightInts& b,
                                                       const EightInts& c, const EightInts& d) {
  const __m256i quarters = _mm256_hadd_epi32(_mm256_hadd_epi32(a.v, b.v), _mm256_hadd_epi32(c.v, d.v));
  return {_mm_add_epi32(_mm256_castsi256_si128(quarters), _mm256_extracti128_si256(quarters, 1))};
}

/// The bits that any of eight numbers has.
NDTREE_BY_EIGHTS [[nodiscard]] inline std::uint32_t any_bits_of(const EightInts& x) {
  __m128i bits = _mm_or_si128(_mm256_castsi256_si128(x.v), _mm256_extracti128_si256(x.v, 1));
  bits = _mm_or_si128(bits, _mm_shuffle_epi32(bits, 0x4e));
  bits = _mm_or_si128(bits, _mm_shuffle_epi32(bits, 0xb1));
  return static_cast<std::uint32_t>(_mm_cvtsi128_si32(bits));
}
NDTREE_BY_EIGHTS [[nodiscard]] inline std::uint32_t unsigned_largest_of(const EightInts& x) {
  __m128i most = _mm_max_epu32(_mm256_castsi256_si128(x.v), _mm256_extracti128_si256(x.v, 1));
  most = _mm_max_epu32(most, _mm_shuffle_epi32(most, 0x4e));
  most = _mm_max_epu32(most, _mm_shuffle_epi32(most, 0xb1));
  return static_cast<std::uint32_t>(_mm_cvtsi128_si32(most));
}

namespace detail {
/// For each set of eight numbers, where to find those that are in it: their places, one byte each.
struct PackTable {
  std::array<std::uint64_t, 256> places{};
  constexpr PackTable() {
    for (unsigned set = 0; set < 256; ++set) {
      unsigned n = 0;
      for (unsigned i = 0; i < 8; ++i)
        if ((set >> i & 1u) != 0) places[set] |= static_cast<std::uint64_t>(i) << (8 * n++);
    }
  }
};
inline constexpr PackTable kPackTable{};
/// How many of eight are in a set, where no instruction counts bits.
struct BitCountTable {
  std::array<std::uint8_t, 256> of{};
  constexpr BitCountTable() {
    for (unsigned set = 1; set < 256; ++set) of[set] = static_cast<std::uint8_t>(of[set / 2] + set % 2);
  }
  constexpr std::uint8_t operator[](std::size_t set) const { return of[set]; }
};
inline constexpr BitCountTable kBitCount{};
}  // namespace detail

/// Bit k is set if flag k is.
NDTREE_BY_EIGHTS [[nodiscard]] inline unsigned set_of_eight(const bool* flags) {
  const __m128i bytes = _mm_loadl_epi64(reinterpret_cast<const __m128i*>(flags));
  return ~static_cast<unsigned>(_mm_movemask_epi8(_mm_cmpeq_epi8(bytes, _mm_setzero_si128()))) & 0xff;
}
/// The order that brings the numbers of a set to the front.
NDTREE_BY_EIGHTS [[nodiscard]] inline EightInts packing(unsigned set) {
  return EightInts::from(_mm256_cvtepu8_epi32(
      _mm_loadl_epi64(reinterpret_cast<const __m128i*>(&detail::kPackTable.places[set]))));
}
NDTREE_BY_EIGHTS [[nodiscard]] inline EightInts in_order(const EightInts& x, const EightInts& order) {
  return EightInts::from(_mm256_permutevar8x32_epi32(x.v, order.v));
}
/// Stores the numbers for which a condition holds one behind the other; the rest of eight places is
/// overwritten.
/// @returns how many they are.
NDTREE_BY_EIGHTS inline std::size_t store_packed(const EightInts& x, const EightMask& mask,
                                                 std::uint32_t* to) {
  const unsigned set = mask.set();
  in_order(x, packing(set)).store(to);
  return static_cast<std::size_t>(__builtin_popcount(set));
}
/// Eight offsets, stored so that single ones are read back from memory: faster than to extract each from a
/// register, which compilers do if they may choose. Not for sixteen: AVX-512 reads single ones back slowly.
struct Offsets {
  alignas(32) std::array<std::uint32_t, 8> at;
  NDTREE_BY_EIGHTS explicit inline Offsets(const EightInts& numbers) {
    _mm256_store_si256(reinterpret_cast<__m256i*>(at.data()), numbers.v);
    __asm__("" : "+m"(at));
  }
  NDTREE_ALWAYS_INLINE std::uint32_t operator[](std::size_t i) const { return at[i]; }
};

namespace detail {
/// Turns rows of four into columns, in each half.
NDTREE_BY_EIGHTS inline void turn_four(const __m256* row, EightFloats* column) {
  const __m256 ab = _mm256_unpacklo_ps(row[0], row[1]);
  const __m256 cd = _mm256_unpackhi_ps(row[0], row[1]);
  const __m256 ab_next = _mm256_unpacklo_ps(row[2], row[3]);
  const __m256 cd_next = _mm256_unpackhi_ps(row[2], row[3]);
  column[0].v = _mm256_shuffle_ps(ab, ab_next, 0x44);
  column[1].v = _mm256_shuffle_ps(ab, ab_next, 0xee);
  column[2].v = _mm256_shuffle_ps(cd, cd_next, 0x44);
  column[3].v = _mm256_shuffle_ps(cd, cd_next, 0xee);
}
NDTREE_BY_EIGHTS [[nodiscard]] inline __m256 joined(__m128 low, __m128 high) {
  return _mm256_insertf128_ps(_mm256_castps128_ps256(low), high, 1);
}
}  // namespace detail

// Many processors gather numbers from different places more slowly than plain loads do. So what belongs
// together lies in one row of a table, and rows are turned into columns.

/// The columns of eight rows of a table, whose rows are made of floats, or of numbers as large.
/// @param rows of the table, eight of them, in memory. Each is loaded by itself: they were stored just
/// before, in smaller pieces, and a load of all would wait for these (no store forwarding).
template <class Row>
NDTREE_BY_EIGHTS NDTREE_ALWAYS_INLINE void load_columns(const Row* table, const std::uint32_t* rows,
                                                        EightFloats* columns) {
  static_assert(sizeof(Row) % 16 == 0 && alignof(Row) % 16 == 0, "Row is loaded by four numbers");
  constexpr std::size_t kGroups = sizeof(Row) / 16;
  __m256 pair[kGroups][4];
#pragma GCC unroll 4
  for (std::size_t k = 0; k < 4; ++k) {
    const auto* const low = reinterpret_cast<const float*>(table + rows[k]);
    const auto* const high = reinterpret_cast<const float*>(table + rows[k + 4]);
#pragma GCC unroll 8
    for (std::size_t g = 0; g < kGroups; ++g)
      pair[g][k] = detail::joined(_mm_load_ps(low + 4 * g), _mm_load_ps(high + 4 * g));
  }
#pragma GCC unroll 8
  for (std::size_t g = 0; g < kGroups; ++g) detail::turn_four(pair[g], columns + 4 * g);
}
/// load_columns() as an ordinary function: templates that are not compiled for a processor of their own
/// cannot inline it else.
template <class Row>
NDTREE_BY_EIGHTS inline void load_columns_once(const Row* table, const std::uint32_t* rows,
                                               EightFloats* columns) {
  load_columns(table, rows, columns);
}
/// The opposite, for eight rows that follow each other.
template <class Row>
NDTREE_BY_EIGHTS NDTREE_ALWAYS_INLINE void store_columns(const EightFloats* columns, Row* rows) {
  static_assert(sizeof(Row) % 16 == 0 && alignof(Row) % 16 == 0, "Row is stored by four numbers");
#pragma GCC unroll 8
  for (std::size_t group = 0; group < sizeof(Row) / 16; ++group) {
    const EightFloats* const from = columns + 4 * group;
    const __m256 row[4] = {from[0].v, from[1].v, from[2].v, from[3].v};
    EightFloats pair[4];
    detail::turn_four(row, pair);
#pragma GCC unroll 4
    for (std::size_t k = 0; k < 4; ++k) {
      _mm_store_ps(reinterpret_cast<float*>(rows + k) + 4 * group, _mm256_castps256_ps128(pair[k].v));
      _mm_store_ps(reinterpret_cast<float*>(rows + k + 4) + 4 * group, _mm256_extractf128_ps(pair[k].v, 1));
    }
  }
}

/// The columns of eight rows of three numbers that follow each other.
NDTREE_BY_EIGHTS inline void load_eight_rows_of_three(const std::uint32_t* rows, EightInts& first,
                                                      EightInts& second, EightInts& third) {
  const auto* const words = reinterpret_cast<const __m256i*>(rows);
  const __m256i low = _mm256_loadu_si256(words);         // Of rows 0 0 0 1 1 1 2 2,
  const __m256i middle = _mm256_loadu_si256(words + 1);  // 2 3 3 3 4 4 4 5,
  const __m256i high = _mm256_loadu_si256(words + 2);    // 5 5 6 6 6 7 7 7.
  first.v = _mm256_blend_epi32(_mm256_blend_epi32(low, middle, 0x92), high, 0x24);
  const __m256i turned_once = _mm256_blend_epi32(_mm256_blend_epi32(low, middle, 0x24), high, 0x49);
  const __m256i turned_twice = _mm256_blend_epi32(_mm256_blend_epi32(low, middle, 0x49), high, 0x92);
  second.v = _mm256_permutevar8x32_epi32(turned_once, _mm256_setr_epi32(1, 2, 3, 4, 5, 6, 7, 0));
  third.v = _mm256_permutevar8x32_epi32(turned_twice, _mm256_setr_epi32(2, 3, 4, 5, 6, 7, 0, 1));
}
/// The columns of four rows of three numbers, each number twice.
NDTREE_BY_EIGHTS inline void load_four_rows_of_three(const std::uint32_t* rows, EightInts& first,
                                                     EightInts& second, EightInts& third) {
  const auto* const words = reinterpret_cast<const __m128i*>(rows);
  const __m128i low = _mm_loadu_si128(words);         // Of rows 0 0 0 1,
  const __m128i middle = _mm_loadu_si128(words + 1);  // 1 1 2 2,
  const __m128i high = _mm_loadu_si128(words + 2);    // 2 3 3 3.
  const __m128i turned_once = _mm_blend_epi32(_mm_blend_epi32(middle, low, 0x2), high, 0x4);
  const __m128i turned_twice = _mm_blend_epi32(_mm_blend_epi32(high, middle, 0x2), low, 0x4);
  first.v = _mm256_broadcastsi128_si256(_mm_blend_epi32(_mm_blend_epi32(low, high, 0x2), middle, 0x4));
  second.v = _mm256_broadcastsi128_si256(_mm_shuffle_epi32(turned_once, 0x39));
  third.v = _mm256_broadcastsi128_si256(_mm_shuffle_epi32(turned_twice, 0x4e));
}

#undef NDTREE_OF_ONE
#undef NDTREE_OF_TWO
#undef NDTREE_COMPARED

}  // namespace ndtree
#endif
