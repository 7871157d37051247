// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Whether loops may work on eight numbers at a time, found out at run time: no compiler flag is needed.
#pragma once

#if defined(__x86_64__) && (defined(__GNUC__) || defined(__clang__))
#include <immintrin.h>
#define NDTREE_HAS_EIGHTS 1
/// Functions with this attribute may use AVX2, whatever the rest is compiled for. They must not multiply and
/// add in one step (FMA), which rounds once instead of twice.
#if defined(__FMA__) && defined(__clang__)  // Then functions of AVX2 do not go into one that lacks FMA.
#define NDTREE_BY_EIGHTS [[gnu::target("avx2,popcnt")]]  // Fuses within an expression alone.
#elif defined(__FMA__)
#define NDTREE_BY_EIGHTS [[gnu::target("avx2,popcnt"), gnu::optimize("fp-contract=off")]]
#else
#define NDTREE_BY_EIGHTS [[gnu::target("avx2,popcnt,no-fma")]]
#endif
#define NDTREE_HAS_SIXTEENS 1
/// Compiles a function with AVX-512, which Clang enables with FMA only: it must not add to products at all.
#define NDTREE_BY_SIXTEENS [[gnu::target("avx2,popcnt,avx512f,avx512dq")]]
#elif defined(NDTREE_USE_SIMDE) && defined(__aarch64__) && defined(__GNUC__)
// SIMDe writes the same functions with NEON, which every such processor has. NDTREE_USE_SIMDE asks for it.
#define SIMDE_ENABLE_NATIVE_ALIASES
#define SIMDE_NO_FAST_NANS  // The smaller and the larger of two are those of x86, also of 0 and -0.
#include <simde/x86/avx2.h>
#if !defined(SIMDE_X86_AVX2_ENABLE_NATIVE_ALIASES) || defined(SIMDE_FAST_NANS)
#error "NDTREE_USE_SIMDE: include ndtree before SIMDe, and compile without -ffast-math"
#endif
#define NDTREE_HAS_EIGHTS 1
#if defined(__clang__)
#define NDTREE_BY_EIGHTS
#else
#define NDTREE_BY_EIGHTS [[gnu::optimize("fp-contract=off")]]
#endif
#endif

#if defined(__aarch64__) && (defined(__GNUC__) || defined(__clang__))
#include <arm_neon.h>
#endif

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "ndtree/core/inline.hpp"

namespace ndtree {

/// Which loops run: all give the same bits.
class Simd {
 public:
  static constexpr int kWidest = 16;
  /// Numbers at a time: 16 with AVX-512, 8 with AVX2, or on ARM with NDTREE_USE_SIMDE, else 1.
  [[nodiscard]] static int width() { return width_of_process().load(std::memory_order_relaxed); }
  /// @param most numbers at a time from now on, at least 1: for tests, and to measure what it is worth.
  static void limit(int most) {
    const int width = std::min(machine_width(), most >= kWidest ? kWidest : most >= 8 ? 8 : 1);
    width_of_process().store(width, std::memory_order_relaxed);
  }

 private:
  [[nodiscard]] static int machine_width() {
#if defined(NDTREE_HAS_EIGHTS) && defined(__x86_64__)
    if (!__builtin_cpu_supports("avx2") || !__builtin_cpu_supports("popcnt")) return 1;
    return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") ? 16 : 8;
#elif defined(NDTREE_HAS_EIGHTS)
    return 8;
#else
    return 1;
#endif
  }
  [[nodiscard]] static std::atomic<int>& width_of_process() {
    static std::atomic<int> width{machine_width()};
    return width;
  }
};

/// Lets memory be read that will be asked for soon. @tparam kCount values from there on.
template <int kCount, class T>
NDTREE_ALWAYS_INLINE void prefetch([[maybe_unused]] const T* values) {
#if defined(__GNUC__) || defined(__clang__)
  constexpr int kOfLine = 64 / sizeof(T);
  static_assert(kOfLine > 0, "values that fit a cache line");
  for (int k = 0; k < kCount; k += kOfLine) __builtin_prefetch(values + k);
#endif
}

/// To the nearest whole number, the even one if two are: as vectors of numbers are rounded.
/// @pre |x| < 2^31.
[[nodiscard]] inline std::int32_t nearest_integer(float x) {
#if defined(__x86_64__) && defined(NDTREE_HAS_EIGHTS)
  return _mm_cvtss_si32(_mm_set_ss(x));
#elif defined(__aarch64__) && (defined(__GNUC__) || defined(__clang__))
  return vcvtns_s32_f32(x);
#else
  return static_cast<std::int32_t>(std::lrint(x));
#endif
}

#ifdef NDTREE_HAS_EIGHTS
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

/// How many of eight are in a set.
struct BitCountTable {
  std::array<std::uint8_t, 256> of{};
  constexpr BitCountTable() {
    for (unsigned set = 1; set < 256; ++set) of[set] = static_cast<std::uint8_t>(of[set / 2] + set % 2);
  }
  constexpr std::uint8_t operator[](std::size_t set) const { return of[set]; }
};
inline constexpr BitCountTable kBitCount{};

/// The order that brings those of a set to the front.
NDTREE_BY_EIGHTS inline __m256i packing(unsigned set) {
  return _mm256_cvtepu8_epi32(_mm_loadl_epi64(reinterpret_cast<const __m128i*>(&kPackTable.places[set])));
}
NDTREE_BY_EIGHTS inline __m256 joined(__m128 low, __m128 high) {
  return _mm256_insertf128_ps(_mm256_castps128_ps256(low), high, 1);
}
NDTREE_BY_EIGHTS inline __m256d joined(__m128d low, __m128d high) {
  return _mm256_insertf128_pd(_mm256_castpd128_pd256(low), high, 1);
}
/// The sums of four vectors.
NDTREE_BY_EIGHTS inline __m128i sums_of(__m256i a, __m256i b, __m256i c, __m256i d) {
  const __m256i quarters = _mm256_hadd_epi32(_mm256_hadd_epi32(a, b), _mm256_hadd_epi32(c, d));
  return _mm_add_epi32(_mm256_castsi256_si128(quarters), _mm256_extracti128_si256(quarters, 1));
}
/// Turns rows of four into columns, in each half.
NDTREE_BY_EIGHTS NDTREE_ALWAYS_INLINE void turn_four(const __m256* row, __m256* column) {
  const __m256 ab = _mm256_unpacklo_ps(row[0], row[1]);
  const __m256 cd = _mm256_unpackhi_ps(row[0], row[1]);
  const __m256 ab_next = _mm256_unpacklo_ps(row[2], row[3]);
  const __m256 cd_next = _mm256_unpackhi_ps(row[2], row[3]);
  column[0] = _mm256_shuffle_ps(ab, ab_next, 0x44);
  column[1] = _mm256_shuffle_ps(ab, ab_next, 0xee);
  column[2] = _mm256_shuffle_ps(cd, cd_next, 0x44);
  column[3] = _mm256_shuffle_ps(cd, cd_next, 0xee);
}
/// All ones in the first n of eight. @pre n < 2^31.
NDTREE_BY_EIGHTS inline __m256i first_of_eight(std::size_t n) {
  return _mm256_cmpgt_epi32(_mm256_set1_epi32(static_cast<int>(n)),
                            _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7));
}
/// All ones in those of eight that are in a set.
NDTREE_BY_EIGHTS inline __m256i lanes_of(unsigned set) {
  const __m256i bit = _mm256_setr_epi32(1, 2, 4, 8, 16, 32, 64, 128);
  return _mm256_cmpeq_epi32(_mm256_and_si256(_mm256_set1_epi32(static_cast<int>(set)), bit), bit);
}
NDTREE_BY_EIGHTS inline __m256i load(const std::uint32_t* eight) {
  return _mm256_loadu_si256(reinterpret_cast<const __m256i*>(eight));
}
// Many processors gather numbers from different places more slowly than plain loads do. So what belongs
// together lies in one row of a table, and eight rows are turned into columns.

/// Eight numbers where single ones are read from memory, as offsets: out of a register each would take two
/// steps, which is what compilers make of it that may choose. Out of a store of sixteen, processors with
/// AVX-512 find single ones far more slowly.
struct Offsets {
  alignas(32) std::array<std::uint32_t, 8> at;
  NDTREE_BY_EIGHTS NDTREE_ALWAYS_INLINE explicit Offsets(__m256i numbers) {
    _mm256_store_si256(reinterpret_cast<__m256i*>(at.data()), numbers);
    __asm__("" : "+m"(at));
  }
  NDTREE_ALWAYS_INLINE std::uint32_t operator[](std::size_t i) const { return at[i]; }
};

/// The columns of a table whose rows are made of floats, or of numbers as large.
/// @param rows of the table, eight of them, in memory: each is loaded by itself. As a vector, they would be
/// waited for until all that has just been written there, which was not all at once.
template <class Row>
NDTREE_BY_EIGHTS NDTREE_ALWAYS_INLINE void load_columns(const Row* table, const std::uint32_t* rows,
                                                        __m256* columns) {
  static_assert(sizeof(Row) % 16 == 0 && alignof(Row) % 16 == 0, "Row is loaded by four numbers");
  constexpr std::size_t kGroups = sizeof(Row) / 16;
  __m256 pair[kGroups][4];
#pragma GCC unroll 4
  for (std::size_t k = 0; k < 4; ++k) {
    const auto* const low = reinterpret_cast<const float*>(table + rows[k]);
    const auto* const high = reinterpret_cast<const float*>(table + rows[k + 4]);
#pragma GCC unroll 8
    for (std::size_t g = 0; g < kGroups; ++g)
      pair[g][k] = joined(_mm_load_ps(low + 4 * g), _mm_load_ps(high + 4 * g));
  }
#pragma GCC unroll 8
  for (std::size_t g = 0; g < kGroups; ++g) turn_four(pair[g], columns + 4 * g);
}
#ifdef NDTREE_HAS_SIXTEENS
/// load_columns() of sixteen rows.
template <class Row>
NDTREE_BY_SIXTEENS NDTREE_ALWAYS_INLINE void load_columns(const Row* table, const std::uint32_t* rows,
                                                          __m512* columns) {
  static_assert(sizeof(Row) % 16 == 0 && alignof(Row) % 16 == 0, "Row is loaded by four numbers");
  constexpr __mmask16 kAll = 0xffff;  // Without a mask, GCC takes part of the result for not initialised.
#pragma GCC unroll 8
  for (std::size_t g = 0; g < sizeof(Row) / 16; ++g) {
    const auto four = [&](std::size_t k) {
      return _mm_load_ps(reinterpret_cast<const float*>(table + rows[k]) + 4 * g);
    };
    __m512 quarters[4];  // Of the rows k, k + 4, k + 8 and k + 12.
#pragma GCC unroll 4
    for (std::size_t k = 0; k < 4; ++k) {
      __m512 row = _mm512_castps128_ps512(four(k));
      row = _mm512_insertf32x4(row, four(k + 4), 1);
      row = _mm512_insertf32x4(row, four(k + 8), 2);
      quarters[k] = _mm512_insertf32x4(row, four(k + 12), 3);
    }
    const __m512 ab = _mm512_maskz_unpacklo_ps(kAll, quarters[0], quarters[1]);
    const __m512 cd = _mm512_maskz_unpackhi_ps(kAll, quarters[0], quarters[1]);
    const __m512 ab_next = _mm512_maskz_unpacklo_ps(kAll, quarters[2], quarters[3]);
    const __m512 cd_next = _mm512_maskz_unpackhi_ps(kAll, quarters[2], quarters[3]);
    columns[4 * g] = _mm512_shuffle_ps(ab, ab_next, 0x44);
    columns[4 * g + 1] = _mm512_shuffle_ps(ab, ab_next, 0xee);
    columns[4 * g + 2] = _mm512_shuffle_ps(cd, cd_next, 0x44);
    columns[4 * g + 3] = _mm512_shuffle_ps(cd, cd_next, 0xee);
  }
}
#endif
/// The opposite, for eight rows that follow each other.
template <class Row>
NDTREE_BY_EIGHTS NDTREE_ALWAYS_INLINE void store_columns(const __m256* columns, Row* rows) {
  static_assert(sizeof(Row) % 16 == 0 && alignof(Row) % 16 == 0, "Row is stored by four numbers");
#pragma GCC unroll 8
  for (std::size_t group = 0; group < sizeof(Row) / 16; ++group) {
    __m256 pair[4];
    turn_four(columns + 4 * group, pair);
#pragma GCC unroll 4
    for (std::size_t k = 0; k < 4; ++k) {
      _mm_store_ps(reinterpret_cast<float*>(rows + k) + 4 * group, _mm256_castps256_ps128(pair[k]));
      _mm_store_ps(reinterpret_cast<float*>(rows + k + 4) + 4 * group, _mm256_extractf128_ps(pair[k], 1));
    }
  }
}

}  // namespace detail
#endif

}  // namespace ndtree
