// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The natural logarithm where cells split and merge: a table and a short polynomial; and where beams weigh.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>

#include "ndtree/core/lanes.hpp"
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

 private:
  std::array<Entry, std::size_t{1} << kBits> entries_;
};
inline const LogTable kLogTable;

inline constexpr double kLog2 = 0.69314718055994531;
inline constexpr int kMantissaBits = 52;  // Of a double.
inline constexpr std::uint64_t kMantissa = (std::uint64_t{1} << kMantissaBits) - 1;
inline constexpr int kExponentBias = 1023;

/// x = 2^exponent m, and the table's entry for m.
template <class Doubles>
struct LogTerms {
  Doubles exponent, m, inverse, log;
};
[[nodiscard]] NDTREE_ALWAYS_INLINE LogTerms<double> log_terms(double x) {
  constexpr std::int64_t kBias = kExponentBias;
  std::uint64_t bits = 0;
  std::memcpy(&bits, &x, sizeof bits);
  const auto exponent = static_cast<double>(static_cast<std::int64_t>(bits >> kMantissaBits) - kBias);
  const LogTable::Entry& part =
      kLogTable[static_cast<std::size_t>((bits & kMantissa) >> (kMantissaBits - LogTable::kBits))];
  bits = (bits & kMantissa) | static_cast<std::uint64_t>(kBias) << kMantissaBits;
  double m = 0.0;
  std::memcpy(&m, &bits, sizeof m);
  return {exponent, m, part.inverse, part.log};
}
#ifdef NDTREE_HAS_EIGHTS
NDTREE_BY_EIGHTS [[nodiscard]] inline LogTerms<FourDoubles> log_terms(const FourDoubles& x) {
  const FourLogParts parts = log_parts_of(x, LogTable::kBits);
  const LogTable::Entry& a = kLogTable[parts.bits[0]];
  const LogTable::Entry& b = kLogTable[parts.bits[1]];
  const LogTable::Entry& c = kLogTable[parts.bits[2]];
  const LogTable::Entry& d = kLogTable[parts.bits[3]];
  LogTerms<FourDoubles> terms{parts.exponent, parts.mantissa, {}, {}};
  load_pairs(&a.inverse, &b.inverse, &c.inverse, &d.inverse, terms.inverse, terms.log);
  return terms;
}
#endif

}  // namespace detail

/// log x within 1e-12, for normal numbers x > 0, of one double or four. With x = 2^e m and a c near m, see
/// LogTable, log x = e log 2 + log c + log(1 + r), r = m / c - 1, |r| <= 2^-8. Its latency is short: few of
/// the terms depend on each other.
template <class Doubles>
[[nodiscard]] NDTREE_ALWAYS_INLINE Doubles quick_log(const Doubles& x) {
  const auto terms = detail::log_terms(x);
  const Doubles r = unfused(terms.m * terms.inverse) - 1.0;
  const Doubles r2 = unfused(r * r);
  const Doubles low = r - unfused(r2 * (1.0 / 2.0));
  const Doubles high = unfused(unfused(r2 * r) * (1.0 / 3.0 - unfused(r * (1.0 / 4.0))));
  return (unfused(terms.exponent * detail::kLog2) + terms.log) + (low + high);
}

namespace detail {
/// log(1 + x) / x for 1 + x in [1 / sqrt 2, sqrt 2], so that the product with x is within 1.1e-5.
inline constexpr std::array<float, 5> kRoughLog{0.999919f, -0.4992329f, 0.3373424f, -0.2735059f, 0.1751486f};
inline constexpr std::int32_t kSqrtHalf = 0x3f3504f3;  // As a float.
inline constexpr int kMantissaBitsOfFloat = 23;
}  // namespace detail

/// log x within 1.1e-5, and rounding to float, for normal floats x > 0; of one or eight.
template <class Floats>
[[nodiscard]] NDTREE_ALWAYS_INLINE Floats rough_log(const Floats& x) {
  constexpr auto& c = detail::kRoughLog;
  const auto bits = bits_of(x);
  const auto exponent = shifted_right(bits - detail::kSqrtHalf, detail::kMantissaBitsOfFloat);
  const Floats m = float_of(bits - shifted_left(exponent, detail::kMantissaBitsOfFloat));
  const Floats r = m - 1.0f;
  const Floats r2 = unfused(r * r);
  const Floats low = c[0] + unfused(c[1] * r);
  const Floats high = (c[2] + unfused(c[3] * r)) + unfused(c[4] * r2);
  return (unfused(to_floats(exponent) * static_cast<float>(detail::kLog2)) + unfused(low * r)) +
         unfused(high * unfused(r2 * r));
}

}  // namespace ndtree
