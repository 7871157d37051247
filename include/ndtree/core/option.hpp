// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Between which bounds options lie, and what is said of one that does not.
#pragma once

#include <cstddef>
#include <cstdio>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>

namespace ndtree {

/// Values of an option for which all arithmetic holds, both ends included.
struct OptionBounds {
  double least;
  double most;
  const char* unit = "";  ///< With a blank before it, or empty.

  [[nodiscard]] bool contain(double value) const { return value >= least && value <= most; }
};

/// A count, as 1,234,567.
[[nodiscard]] inline std::string describe_count(std::size_t count) {
  std::string text = std::to_string(count);
  for (std::size_t at = text.size(); at > 3;) text.insert(at -= 3, 1, ',');
  return text;
}

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

/// A value that cannot be taken. It carries the field and the value, so that each front end spells them in
/// its own way: `min_cell_size = -1.0`, `--min-cell-size -1`, a parameter of ROS.
class OptionError : public std::invalid_argument {
 public:
  /// @param value as it is written, with its unit; empty: the message is `expected` alone.
  /// @param expected behind "must be". @param other a field whose value stands behind `expected`, or empty.
  OptionError(std::string field, std::string value, std::string expected, std::string other = {},
              std::string value_of_other = {})
      : std::invalid_argument(field + (value.empty() ? ": " : " = " + value + ": must be ") + expected +
                              other + value_of_other),
        field_(std::move(field)),
        value_(std::move(value)),
        expected_(std::move(expected)),
        other_(std::move(other)),
        value_of_other_(std::move(value_of_other)) {}

  [[nodiscard]] const std::string& field() const { return field_; }
  [[nodiscard]] const std::string& value() const { return value_; }
  [[nodiscard]] const std::string& expected() const { return expected_; }
  [[nodiscard]] const std::string& other() const { return other_; }
  [[nodiscard]] const std::string& value_of_other() const { return value_of_other_; }

 private:
  std::string field_, value_, expected_, other_, value_of_other_;
};

/// @throws OptionError naming the option, its value and what it must be, unless it is valid.
inline void require_option(bool valid, const char* name, double value, const std::string& limit) {
  if (!valid) throw OptionError(name, describe_number(value), limit);
}

/// @throws OptionError naming the option, its value and its bounds if it is outside, or NaN.
inline void require_within(const char* name, double value, const OptionBounds& bounds) {
  if (value >= bounds.least && value <= bounds.most) return;
  char limits[64];
  std::snprintf(limits, sizeof limits, "in [%.9g, %.9g]", bounds.least, bounds.most);
  require_option(false, name, value, std::string(limits) + bounds.unit);
}

}  // namespace ndtree
