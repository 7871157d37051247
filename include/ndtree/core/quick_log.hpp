// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The natural logarithm where cells are updated: a table and a short polynomial.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>

namespace ndtree {

namespace detail {

/// 1 / c and log c for the middles c of 128 equal parts of [1, 2), but for the first: c = 1, so that log 1 is
/// 0.
class LogTable {
 public:
  static constexpr int kBits = 7;
  struct Entry {
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

}  // namespace detail

/// log x within 1e-12, for normal numbers x > 0. With x = 2^e m and a c near m, see LogTable,
/// log x = e log 2 + log c + log(1 + r), r = m / c - 1, |r| <= 2^-7.
[[nodiscard]] inline double quick_log(double x) {
  constexpr int kMantissaBits = 52;
  constexpr std::uint64_t kMantissa = (std::uint64_t{1} << kMantissaBits) - 1;
  constexpr std::int64_t kBias = 1023;
  constexpr double kLog2 = 0.69314718055994531;
  std::uint64_t bits = 0;
  std::memcpy(&bits, &x, sizeof bits);
  const auto exponent = static_cast<double>(static_cast<std::int64_t>(bits >> kMantissaBits) - kBias);
  const detail::LogTable::Entry& part = detail::kLogTable[static_cast<std::size_t>(
      (bits & kMantissa) >> (kMantissaBits - detail::LogTable::kBits))];
  bits = (bits & kMantissa) | static_cast<std::uint64_t>(kBias) << kMantissaBits;
  double m = 0.0;
  std::memcpy(&m, &bits, sizeof m);
  const double r = m * part.inverse - 1.0;
  return exponent * kLog2 + part.log +
         r * (1.0 + r * (-1.0 / 2.0 + r * (1.0 / 3.0 + r * (-1.0 / 4.0 + r * (1.0 / 5.0)))));
}

}  // namespace ndtree
