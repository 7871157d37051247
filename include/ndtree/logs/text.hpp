// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Fields and numbers of a text line, independent of the locale; shared by the line-based log readers.
#pragma once

#include <charconv>
#include <cstddef>
#include <limits>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <system_error>

#include "ndtree/core/option.hpp"

namespace ndtree::detail {

/// The error of every text reader: "line 17: <what>".
[[noreturn]] inline void throw_at_line(std::size_t line_number, const std::string& what) {
  throw std::runtime_error("line " + std::to_string(line_number) + ": " + what);
}

/// A field as it is quoted in an error.
inline std::string quoted(std::string_view field) { return describe_text(field); }

/// The number that is all of `field`, with an optional sign; "nan" and "inf" are numbers. A magnitude below
/// the smallest double is 0, one above the largest is infinite.
inline std::optional<double> parse_number(std::string_view field) {
  if (!field.empty() && field.front() == '+') {
    field.remove_prefix(1);
    if (!field.empty() && field.front() == '-') return std::nullopt;
  }
  double value = 0.0;
  const char* const end = field.data() + field.size();
  const auto [stop, error] = std::from_chars(field.data(), end, value);
  if (stop != end || error == std::errc::invalid_argument) return std::nullopt;
  if (error == std::errc::result_out_of_range) {
    const std::size_t exponent = field.find_first_of("eE");
    const bool tiny =
        exponent != std::string_view::npos && exponent + 1 < field.size() && field[exponent + 1] == '-';
    const double magnitude = tiny ? 0.0 : std::numeric_limits<double>::infinity();
    return field.front() == '-' ? -magnitude : magnitude;
  }
  return value;
}

/// Takes the next field off the front of `rest`; empty at the end. Fields are separated by any number of
/// blanks, tabs and carriage returns.
inline std::string_view next_field(std::string_view& rest) {
  constexpr std::string_view blanks = " \t\r\n";
  const std::size_t begin = rest.find_first_not_of(blanks);
  if (begin == std::string_view::npos) return rest = {};
  const std::size_t end = rest.find_first_of(blanks, begin);
  const std::string_view field = rest.substr(begin, end - begin);
  rest = end == std::string_view::npos ? std::string_view{} : rest.substr(end);
  return field;
}

}  // namespace ndtree::detail
