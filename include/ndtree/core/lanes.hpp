// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Numbers side by side: rules that are written once, for one number and for several.
///
/// Strategy. A rule is a template on its numbers, NDTREE_ALWAYS_INLINE, with `Floats` a float or EightFloats,
/// and `Doubles` a double or FourDoubles:
/// @code
/// template <class Floats>
/// NDTREE_ALWAYS_INLINE Floats plane_at(const Floats& inverse) const { return unfused(p_ * inverse); }
/// @endcode
/// A loop over vectors is a function with NDTREE_BY_EIGHTS (AVX2) or NDTREE_BY_SIXTEENS (AVX-512), which a
/// caller chooses by Simd::width(). Processors' instructions stand in lanes_avx2.hpp and lanes_avx512.hpp
/// alone: another instruction set is another such header, with what is below for one number, and the types'
/// members.
///
/// Invariants. The same expression gives the same bits for each number, whatever the width: products are
/// rounded before they are added (unfused(); in vectors they always are), the functions here are defined by a
/// comparison where the standard library's would differ for 0 and -0. Rules take vectors by reference, and
/// all that takes or returns them is inlined: then callers and callees need not be compiled for the same
/// processor.
#pragma once

#include <cmath>
#include <cstdint>
#include <cstring>

#include "ndtree/core/inline.hpp"
#include "ndtree/core/lanes_avx512.hpp"
#include "ndtree/core/simd.hpp"

namespace ndtree {

/// a < b ? a : b.
[[nodiscard]] NDTREE_ALWAYS_INLINE float min_of(float a, float b) { return a < b ? a : b; }
/// a > b ? a : b.
[[nodiscard]] NDTREE_ALWAYS_INLINE float max_of(float a, float b) { return a > b ? a : b; }
[[nodiscard]] NDTREE_ALWAYS_INLINE double min_of(double a, double b) { return a < b ? a : b; }
[[nodiscard]] NDTREE_ALWAYS_INLINE double max_of(double a, double b) { return a > b ? a : b; }
[[nodiscard]] NDTREE_ALWAYS_INLINE std::int32_t max_of(std::int32_t a, std::int32_t b) {
  return a < b ? b : a;
}
[[nodiscard]] NDTREE_ALWAYS_INLINE float abs_of(float x) { return std::abs(x); }
[[nodiscard]] NDTREE_ALWAYS_INLINE double abs_of(double x) { return std::abs(x); }
/// x >= 0 with the sign of another number.
[[nodiscard]] NDTREE_ALWAYS_INLINE float with_sign(float x, float sign) { return std::copysign(x, sign); }
/// For each number the first where a condition holds, else the second.
[[nodiscard]] NDTREE_ALWAYS_INLINE float select(bool condition, float yes, float no) {
  return condition ? yes : no;
}
[[nodiscard]] NDTREE_ALWAYS_INLINE double select(bool condition, double yes, double no) {
  return condition ? yes : no;
}
/// Towards 0. @pre |x| < 2^31.
[[nodiscard]] NDTREE_ALWAYS_INLINE std::int32_t truncated(float x) { return static_cast<std::int32_t>(x); }
[[nodiscard]] NDTREE_ALWAYS_INLINE float to_floats(std::int32_t x) { return static_cast<float>(x); }
[[nodiscard]] NDTREE_ALWAYS_INLINE float to_floats(double x) { return static_cast<float>(x); }
[[nodiscard]] NDTREE_ALWAYS_INLINE std::int32_t bits_of(float x) {
  std::int32_t bits = 0;
  std::memcpy(&bits, &x, sizeof bits);
  return bits;
}
/// The bits without sign.
[[nodiscard]] NDTREE_ALWAYS_INLINE std::uint32_t words_of(float x) {
  return static_cast<std::uint32_t>(bits_of(x));
}
[[nodiscard]] NDTREE_ALWAYS_INLINE float float_of(std::int32_t bits) {
  float x = 0.0f;
  std::memcpy(&x, &bits, sizeof x);
  return x;
}
[[nodiscard]] NDTREE_ALWAYS_INLINE std::int32_t shifted_left(std::int32_t x, int by) {
  return static_cast<std::int32_t>(static_cast<std::uint32_t>(x) << by);
}
/// Copies of the sign move in from the left.
[[nodiscard]] NDTREE_ALWAYS_INLINE std::int32_t shifted_right(std::int32_t x, int by) { return x >> by; }
/// Zeros move in from the left.
[[nodiscard]] NDTREE_ALWAYS_INLINE std::uint32_t unsigned_shifted_right(std::uint32_t x, int by) {
  return x >> by;
}
/// As many numbers as the first argument has, from memory and to it.
NDTREE_ALWAYS_INLINE void load_from(float& x, const float* from) { x = *from; }
NDTREE_ALWAYS_INLINE void store_to(float x, float* to) { *to = x; }
/// One of eight numbers in memory.
[[nodiscard]] NDTREE_ALWAYS_INLINE float one_of_eight(const float* table, std::int32_t at) {
  return table[at];
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

}  // namespace ndtree
