// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Reads the laser scans of CARMEN logs, the format of most published 2-D data sets (the logs of Sec. IV).
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <istream>
#include <limits>
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

/// What a FLASER record does not say about its laser; ROBOTLASER1 records say it themselves.
struct CarmenOptions {
  /// Readings at or above this mean that nothing was hit [m]. A SICK LMS measures up to 80 m and reports its
  /// faults as distances from 81.83 to 81.91 m.
  double max_range = 80.0;
  /// Angle from the first to the last beam of an odd number of beams, centred ahead [rad]. An even number
  /// leaves the last one out: 180 and 181 beams are both 1 degree apart. None: what PARAM records declare,
  /// else that of the laser that is known for its number of beams, else pi.
  std::optional<double> field_of_view;

  /// @throws std::invalid_argument that names the first value out of its limits.
  void validate() const {
    if (!(max_range > 0.0))
      throw std::invalid_argument("max_range = " + describe_number(max_range) + " m: must be > 0");
    if (field_of_view && !(*field_of_view > 0.0 && *field_of_view <= 6.2831853071795865))
      throw std::invalid_argument("field_of_view = " + describe_number(*field_of_view) +
                                  " rad: must be in (0, 2 pi]");
  }
};

/// What a field of view was taken from.
enum class FieldOfViewSource { option, param, beams, none };

/// Turns FLASER and ROBOTLASER1 records into scans in the map frame, one line at a time.
///
///     FLASER n range*n  x y theta  odom_x odom_y odom_theta  stamp host logger_stamp
///     ROBOTLASER1 type start_angle field_of_view angular_resolution maximum_range accuracy remission_mode
///                 n range*n  m remission*m  x y theta  robot_x robot_y robot_theta
///                 tv rv forward_safety side_safety turn_axis  stamp host logger_stamp
///
/// x y theta is the laser's pose [m, rad], ranges are in metres, stamps in seconds. A record may end after
/// the pose; its stamp is then 0. Where a host name is present, the numbers before it are counted, so that a
/// wrong n, or too few of them, is an error and never a shifted pose.
///
/// A FLASER record does not say its field of view. Before it, the log may:
///
///     PARAM laser_front_laser_fov 240        (or laser_laser1_fov, robot_front_laser_fov; [deg])
///     PARAM laser_front_laser_resolution 0.352
///
/// The resolution decides where neither the field of view nor the number of beams does. Where both are
/// declared and do not fit the number of beams, a laser that is known for it and fits one of them is taken,
/// or the field of view where each n-th beam was kept; else that is an error.
class CarmenParser {
 public:
  explicit CarmenParser(CarmenOptions options = {}) : options_(options) { options_.validate(); }

  /// The scan of a laser record; none for any other record, a comment or a blank line.
  /// Beams keep the order of the file. A reading at or above the maximum range did not return: its end point
  /// is at the reading, and for ROBOTLASER1 not beyond the maximum that the record states. A reading of 0
  /// ends at the origin, a negative one or NaN in NaN: beams that say nothing.
  /// @throws std::runtime_error with the line's number, the record and what was expected. The line counts.
  std::optional<Scan<2>> parse_line(std::string_view line) {
    ++line_number_;
    constexpr std::string_view byte_order_mark = "\xEF\xBB\xBF";
    if (line_number_ == 1 && line.substr(0, 3) == byte_order_mark) line.remove_prefix(3);
    std::string_view rest = line;
    const std::string_view record = detail::next_field(rest);
    if (record == "PARAM") read_param(rest);
    if (record == "FLASER") return parse_flaser(split("FLASER", rest));
    if (record == "ROBOTLASER1") return parse_robot_laser(split("ROBOTLASER1", rest));
    return std::nullopt;
  }

  /// Number of lines read so far, and so the number of the last one.
  [[nodiscard]] std::size_t line_number() const { return line_number_; }

  /// Field of view of the last FLASER record [rad], and what it was taken from; none before the first.
  [[nodiscard]] std::optional<std::pair<double, FieldOfViewSource>> field_of_view() const { return used_; }

 private:
  /// The fields of one record up to the host name, which is the last but one if it is there at all.
  struct Record {
    std::string name;
    std::vector<double> numbers;
    bool has_host = false;
  };

  [[noreturn]] void fail(const Record& record, const std::string& what) const {
    detail::throw_at_line(line_number_, record.name + ": " + what);
  }

  Record split(const char* name, std::string_view rest) const {
    Record record{name, {}, false};
    record.numbers.reserve(rest.size() / 5);
    while (true) {
      const std::string_view field = detail::next_field(rest);
      if (field.empty()) return record;
      if (const std::optional<double> number = detail::parse_number(field)) {
        record.numbers.push_back(*number);
        continue;
      }
      std::string_view behind = rest;
      const bool is_host = !detail::next_field(behind).empty() && detail::next_field(behind).empty();
      if (!is_host)
        fail(record, "expected a number in field " + std::to_string(record.numbers.size() + 2) + ", found " +
                         detail::quoted(field));
      record.has_host = true;
      return record;
    }
  }

  std::size_t count_at(const Record& record, std::size_t i, const std::string& what) const {
    constexpr double most = 1e7;  // far above any laser, far below an overflow
    if (i >= record.numbers.size()) fail(record, "expected the number of " + what + ", found the end");
    const double value = record.numbers[i];
    if (!(value >= 0.0 && value <= most && std::floor(value) == value))
      fail(record, "expected the number of " + what + ", found " + describe_number(value));
    return static_cast<std::size_t>(value);
  }

  /// Checks that `count` values start at `first`, with a pose behind them and, before a host name, exactly
  /// `trailer` numbers. @returns where the pose starts.
  std::size_t checked_end(const Record& record, std::size_t first, std::size_t count, std::size_t trailer,
                          const char* what) const {
    const std::size_t behind = record.has_host ? trailer : 0;
    const std::size_t available = record.numbers.size() - first;
    if (available < behind)
      fail(record, "expected " + std::to_string(count) + " " + what + " and " + std::to_string(behind) +
                       " more numbers before the host name, found " + std::to_string(available) + " numbers");
    const std::size_t found = available - behind;
    if (found < count || (record.has_host && found > count))
      fail(record, "expected " + std::to_string(count) + " " + what + ", found " + std::to_string(found));
    if (found - count + behind < 3)
      fail(record, "expected x y theta behind " + std::to_string(count) + " " + what + ", found " +
                       std::to_string(found - count + behind) + " numbers");
    return first + count;
  }

  /// Keeps what a PARAM record says of the laser in front [rad]. Up to 2 pi, a field of view is in radians:
  /// no laser looks at 6 degrees. Values that are no angle are passed over.
  void read_param(std::string_view rest) {
    const std::string_view name = detail::next_field(rest);
    const auto ends_with = [&](std::string_view end) {
      return name.size() >= end.size() && name.substr(name.size() - end.size()) == end;
    };
    const bool is_front =
        name.find("laser") != std::string_view::npos &&
        (name.find("front") != std::string_view::npos || name.find("laser1") != std::string_view::npos ||
         name.substr(0, 6) == "laser_") &&
        name.find("rear") == std::string_view::npos && name.find("laser2") == std::string_view::npos &&
        name.find("laser3") == std::string_view::npos && name.find("laser4") == std::string_view::npos &&
        name.find("laser5") == std::string_view::npos;
    if (!is_front || !(ends_with("_fov") || ends_with("_resolution"))) return;
    const double value = detail::parse_number(detail::next_field(rest)).value_or(0.0);
    constexpr double degree = kPi / 180.0;
    if (ends_with("_fov")) {
      if (value > 0.0 && value <= 360.0) declared_fov_ = value <= 2 * kPi + 1e-6 ? value : value * degree;
    } else if (value > 0.0 && value <= 10.0) {
      declared_step_ = value * degree;
    }
  }

  /// The field of view of the lasers that are known by their number of beams [deg]: SICK's LMS 200 with 1 and
  /// 0.5 degrees, and its mode of 100 degrees; Hokuyo's URG-04LX; 270 degrees of the LMS 100, TiM and
  /// UTM-30LX.
  static std::optional<double> known_degrees(std::size_t beams) {
    switch (beams) {
      case 180:
      case 181:
      case 360:
      case 361:
        return 180.0;
      case 401:
        return 100.0;
      case 681:
      case 682:
      case 683:
        return 240.0;
      case 541:
      case 811:
      case 1080:
      case 1081:
        return 270.0;
      default:
        return std::nullopt;
    }
  }

  std::pair<double, FieldOfViewSource> field_of_view_of(const Record& record, std::size_t beams,
                                                        std::size_t steps) const {
    constexpr double degree = kPi / 180.0;
    if (options_.field_of_view) return {*options_.field_of_view, FieldOfViewSource::option};
    const std::optional<double> known = known_degrees(beams);
    const double by_steps = declared_step_.value_or(0.0) * static_cast<double>(steps);
    const auto fits_steps = [&](double angle) {  // Steps are rounded, and beams at the ends may be left out.
      return std::abs(angle - by_steps) <= 0.01 * angle + 2.5 * *declared_step_;
    };
    if (declared_fov_ && (steps == 0 || !declared_step_ || fits_steps(*declared_fov_)))
      return {*declared_fov_, FieldOfViewSource::param};
    if (known && (!declared_fov_ || fits_steps(*known * degree) ||
                  std::abs(*declared_fov_ - *known * degree) < degree))
      return {*known * degree, FieldOfViewSource::beams};
    const bool is_subsampled =  // Each second beam, or third; more than all around is no resolution.
        declared_fov_ &&
        (by_steps > 2 * kPi || std::abs(std::remainder(*declared_fov_ / by_steps, 1.0)) < 0.02);
    if (is_subsampled && !known) return {*declared_fov_, FieldOfViewSource::param};
    if (declared_fov_)
      fail(record, std::to_string(beams) + " ranges, but PARAM records declare " +
                       describe_number(*declared_fov_ / degree) + " degrees in steps of " +
                       describe_number(*declared_step_ / degree) +
                       ", expected them to fit, or the field of view as an option (fov)");
    if (by_steps > 0.0 && by_steps <= 2 * kPi + 1e-9) return {by_steps, FieldOfViewSource::param};
    return {kPi, FieldOfViewSource::none};
  }

  Scan<2> parse_flaser(const Record& record) {
    constexpr std::size_t trailer = 7;  // pose, odometry, stamp
    const std::size_t n = count_at(record, 0, "ranges");
    const std::size_t pose = checked_end(record, 1, n, trailer, "ranges");
    const std::size_t steps = n % 2 == 0 ? n : n - 1;
    used_ = field_of_view_of(record, n, steps);
    const double fov = used_->first;
    const double step = steps == 0 ? 0.0 : fov / static_cast<double>(steps);
    return make_scan(record, 1, n, pose, pose + trailer - 1, -0.5 * fov, step, options_.max_range,
                     std::numeric_limits<double>::infinity());
  }

  Scan<2> parse_robot_laser(const Record& record) const {
    constexpr std::size_t header = 8;    // type to n
    constexpr std::size_t trailer = 12;  // two poses, five numbers of the robot's state, stamp
    const std::size_t n = count_at(record, header - 1, "ranges");
    const std::size_t available = record.numbers.size() - header;
    if (available < n)
      fail(record, "expected " + std::to_string(n) + " ranges, found " + std::to_string(available));
    const std::size_t m = count_at(record, header + n, "remissions behind " + std::to_string(n) + " ranges");
    const std::size_t pose = checked_end(record, header + n + 1, m, trailer, "remissions");
    const double stated = record.numbers[4];
    const bool is_stated = stated > 0.0;
    return make_scan(record, header, n, pose, pose + trailer - 1, record.numbers[1], record.numbers[3],
                     is_stated ? stated : options_.max_range,
                     is_stated ? stated : std::numeric_limits<double>::infinity());
  }

  static Scan<2> make_scan(const Record& record, std::size_t first, std::size_t n, std::size_t pose,
                           std::size_t stamp, double start_angle, double step, double max_range,
                           double longest) {
    const std::vector<double>& numbers = record.numbers;
    Scan<2> scan;
    scan.origins.resize(2, 1);
    scan.origins << numbers[pose], numbers[pose + 1];
    scan.endpoints.resize(2, static_cast<Eigen::Index>(n));
    scan.returned.resize(static_cast<Eigen::Index>(n));
    if (stamp < numbers.size()) scan.stamp = numbers[stamp];
    for (std::size_t i = 0; i < n; ++i) {
      const auto column = static_cast<Eigen::Index>(i);
      const double angle = numbers[pose + 2] + start_angle + static_cast<double>(i) * step;
      const double reading = numbers[first + i];
      scan.returned[column] = !(reading >= max_range);
      const double range =
          reading >= 0.0 ? std::min(reading, longest) : std::numeric_limits<double>::quiet_NaN();
      scan.endpoints.col(column) = scan.origins.col(0) + range * Vector<2>(std::cos(angle), std::sin(angle));
    }
    return scan;
  }

  static constexpr double kPi = 3.14159265358979323846;

  CarmenOptions options_;
  std::optional<double> declared_fov_;   // [rad]
  std::optional<double> declared_step_;  // [rad]
  std::optional<std::pair<double, FieldOfViewSource>> used_;
  std::size_t line_number_ = 0;
};

/// Calls `visit(Scan<2>&&)` for each laser record of a CARMEN log, in the order of the file.
/// @throws std::runtime_error as CarmenParser::parse_line(), or if the stream breaks.
template <typename Visitor>
void read_carmen(std::istream& in, Visitor&& visit, const CarmenOptions& options = {}) {
  CarmenParser parser(options);
  std::string line;
  while (std::getline(in, line))
    if (std::optional<Scan<2>> scan = parser.parse_line(line)) visit(std::move(*scan));
  if (in.bad()) detail::throw_at_line(parser.line_number() + 1, "cannot be read");
}

}  // namespace ndtree
