// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Reads beams from plain text, one a line: origin, end point and, if known, whether the beam returned.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <istream>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "ndtree/core/option.hpp"
#include "ndtree/core/scan.hpp"
#include "ndtree/logs/text.hpp"

namespace ndtree {

/// Dimension of a plain-text log, 2 or 3, from its first line with numbers: 4 or 5 are a beam in 2-D, 6 or 7
/// one in 3-D. The stream is left where it was, and so must be able to seek.
/// @throws std::runtime_error if that line has another number of numbers, or if there is none.
int xyz_dimension(std::istream& in);

/// Collects scans from lines of 2 D numbers, origin then end point [m], or 2 D + 1 with a last 0 or 1:
/// 0 where nothing was hit up to the end point, else 1, which is also what its absence means.
/// Numbers are separated by blanks, tabs, or one comma or semicolon each; `#` starts a comment; the decimal
/// sign is a point whatever the locale. Consecutive lines with an equal origin are one scan.
/// A `nan` end point is kept: a beam that says nothing.
template <int D>
class XyzParser {
 public:
  /// The scan that ends because this line starts another; none while a scan goes on.
  /// @throws std::runtime_error with the line's number and what was expected. The line counts.
  std::optional<Scan<D>> parse_line(std::string_view line);

  /// The last scan, which no further line ended; none if no beam is waiting.
  std::optional<Scan<D>> finish() {
    if (returned_.empty()) return std::nullopt;
    const auto n = static_cast<Eigen::Index>(returned_.size());
    Scan<D> scan;
    scan.origins = origin_;
    scan.endpoints = Eigen::Map<const Points<D>>(endpoints_.data(), D, n);
    scan.returned = Eigen::Map<const Eigen::Array<char, Eigen::Dynamic, 1>>(returned_.data(), n) != 0;
    endpoints_.clear();
    returned_.clear();
    return scan;
  }

  /// Number of lines read so far, and so the number of the last one.
  [[nodiscard]] std::size_t line_number() const { return line_number_; }

 private:
  Vector<D> origin_;
  std::vector<double> endpoints_;  // D a beam
  std::vector<char> returned_;
  std::size_t line_number_ = 0;
};

/// Calls `visit(Scan<D>&&)` for each scan of a plain-text log, in the order of the file.
/// @throws std::runtime_error as XyzParser::parse_line(), or if the stream breaks.
template <int D, typename Visitor>
void read_xyz(std::istream& in, Visitor&& visit) {
  XyzParser<D> parser;
  std::string line;
  while (std::getline(in, line))
    if (std::optional<Scan<D>> scan = parser.parse_line(line)) visit(std::move(*scan));
  if (in.bad()) detail::throw_at_line(parser.line_number() + 1, "cannot be read");
  if (std::optional<Scan<D>> scan = parser.finish()) visit(std::move(*scan));
}

namespace detail {

/// Numbers of one plain-text line, into `numbers`. @returns how many there are, counting those that found no
/// room; 0 for a blank line or a comment.
template <std::size_t Room>
std::size_t parse_xyz_fields(std::string_view line, std::size_t line_number,
                             std::array<double, Room>& numbers) {
  constexpr std::string_view byte_order_mark = "\xEF\xBB\xBF";
  if (line_number == 1 && line.substr(0, 3) == byte_order_mark) line.remove_prefix(3);
  line = line.substr(0, line.find('#'));
  std::size_t count = 0;
  while (true) {
    const std::size_t begin = line.find_first_not_of(" \t\r");
    if (begin == std::string_view::npos) return count;
    line.remove_prefix(begin);
    const std::size_t end = std::min(line.find_first_of(" \t\r,;"), line.size());
    const std::string_view field = line.substr(0, end);
    const std::optional<double> number = parse_number(field);
    if (!number)
      throw_at_line(line_number,
                    "expected a number in column " + std::to_string(count + 1) + ", found " + quoted(field));
    if (count < Room) numbers[count] = *number;
    ++count;
    line.remove_prefix(end);
    const std::size_t separator = std::min(line.find_first_not_of(" \t\r"), line.size());
    line.remove_prefix(separator);
    if (!line.empty() && (line.front() == ',' || line.front() == ';')) line.remove_prefix(1);
  }
}

}  // namespace detail

inline int xyz_dimension(std::istream& in) {
  const std::istream::pos_type start = in.tellg();
  std::array<double, 7> numbers{};
  std::string line;
  std::size_t line_number = 0;
  std::size_t count = 0;
  while (count == 0 && std::getline(in, line)) count = detail::parse_xyz_fields(line, ++line_number, numbers);
  in.clear();
  in.seekg(start);
  if (count == 0)
    throw std::runtime_error("no line with numbers: expected an origin and an end point a line");
  if (count < 4 || count > 7)
    detail::throw_at_line(line_number,
                          "expected 4 or 5 numbers in 2-D, 6 or 7 in 3-D, found " + std::to_string(count));
  return count < 6 ? 2 : 3;
}

template <int D>
std::optional<Scan<D>> XyzParser<D>::parse_line(std::string_view line) {
  ++line_number_;
  constexpr std::size_t dim = D;
  std::array<double, 2 * dim + 1> numbers{};
  const std::size_t count = detail::parse_xyz_fields(line, line_number_, numbers);
  if (count == 0) return std::nullopt;
  if (count != 2 * dim && count != 2 * dim + 1)
    detail::throw_at_line(line_number_, "expected " + std::to_string(2 * dim) + " or " +
                                            std::to_string(2 * dim + 1) + " numbers, found " +
                                            std::to_string(count));
  const double flag = count == 2 * dim ? 1.0 : numbers[2 * dim];
  if (flag != 0.0 && flag != 1.0)
    detail::throw_at_line(line_number_, "expected 0 or 1 in column " + std::to_string(2 * dim + 1) +
                                            ", found " + describe_number(flag));
  const Eigen::Map<const Vector<D>> origin(numbers.data());
  std::optional<Scan<D>> ended;
  if (!returned_.empty() && origin != origin_) ended = finish();
  origin_ = origin;
  endpoints_.insert(endpoints_.end(), numbers.data() + dim, numbers.data() + 2 * dim);
  returned_.push_back(flag != 0.0);
  return ended;
}

}  // namespace ndtree
