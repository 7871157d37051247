// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// How many numbers loops take at a time, 1, 8 or 16, found out at run time: no compiler flag is
/// needed; and products that no compiler fuses with a sum (FMA): they are rounded first.
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
/// Compiles a function for AVX-512. Clang's implies FMA: such a function must contain no sum of a product.
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
#include <atomic>

#include "ndtree/core/inline.hpp"

namespace ndtree {

/// x itself, hiding from the compiler that it was a product. It may else make `a * b + c` one step that
/// rounds once (FMA), and GCC does so unasked for every processor that has such a step: ARM's, and those of
/// `-march=native`. Then cells would not meet at their borders to the last bit, loops of eight would not tell
/// what loops of one do, and a map would depend on the machine. So where a map depends on a sum, it is
/// `unfused(a * b) + c`, which costs no instruction. No flag of the compiler is needed.
template <class Real>
[[nodiscard]] NDTREE_ALWAYS_INLINE Real unfused(Real x) {
#if defined(__x86_64__) && defined(__FMA__) && defined(__GNUC__)
  __asm__("" : "+x"(x));
#elif defined(__aarch64__) && \
    defined(__GNUC__)  // GCC's __builtin_assoc_barrier() is lost in vectors of loops.
  __asm__("" : "+w"(x));
#endif
  return x;
}

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

}  // namespace ndtree
