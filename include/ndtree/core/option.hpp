// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Between which bounds options lie, and what is said of one that does not.
#pragma once

#include <cstddef>
#include <cstdio>
#include <stdexcept>
#include <string>
#include <string_view>

namespace ndtree {

/// Values of an option for which all arithmetic holds, both ends included.
struct OptionBounds {
  double least;
  double most;
  const char* unit = "";  ///< With a blank before it, or empty.

  [[nodiscard]] bool contain(double value) const { return value >= least && value <= most; }
};

/// A number as messages show it: nine digits at most, and never without a point or an exponent.
[[nodiscard]] inline std::string describe_number(double value) {
  char buffer[32];
  std::snprintf(buffer, sizeof buffer, "%.9g", value);
  const std::string text = buffer;
  return text.find_first_not_of("-0123456789") == std::string::npos ? text + ".0" : text;
}

/// A point as messages show it: "(1.0, 2.5)".
template <class Point>
[[nodiscard]] std::string describe_point(const Point& point) {
  std::string text = "(";
  for (int a = 0; a < static_cast<int>(point.size()); ++a)
    text += (a > 0 ? ", " : "") + describe_number(point[a]);
  return text + ")";
}

/// Text of a file as messages show it: in quotes, 40 characters of it at most, on one line.
[[nodiscard]] inline std::string describe_text(std::string_view text) {
  constexpr std::size_t kMost = 40;
  std::string shown(text.substr(0, kMost));
  for (char& c : shown)
    if (static_cast<unsigned char>(c) < ' ' || c == '\x7f') c = '?';
  return "'" + shown + (text.size() > kMost ? "...'" : "'");
}

/// @throws std::invalid_argument naming the option, its value and what it must be, unless it is valid.
inline void require_option(bool valid, const char* name, double value, const std::string& limit) {
  if (valid) return;
  throw std::invalid_argument(std::string(name) + " = " + describe_number(value) + ": must be " + limit);
}

/// @throws std::invalid_argument naming the option, its value and its bounds if it is outside, or NaN.
inline void require_within(const char* name, double value, const OptionBounds& bounds) {
  if (value >= bounds.least && value <= bounds.most) return;
  char limits[64];
  std::snprintf(limits, sizeof limits, "in [%.9g, %.9g]", bounds.least, bounds.most);
  require_option(false, name, value, std::string(limits) + bounds.unit);
}

}  // namespace ndtree
