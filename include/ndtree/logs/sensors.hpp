// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Simulated range sensors: where their beams point, and how well they measure.
#pragma once

#include <Eigen/Core>
#include <cmath>
#include <stdexcept>
#include <string>

#include "ndtree/core/option.hpp"
#include "ndtree/core/types.hpp"

namespace ndtree {

/// What a sensor says of a beam that found nothing up to its maximum range.
enum class NoEcho {
  free_to_max_range,  ///< A beam that did not return, its end point at the maximum range, as lasers do.
  no_measurement      ///< An end point of NaN, as depth cameras do: it may have been free or not.
};

/// How well a sensor measures ranges. A surface nearer than `min_range` is never measured (NaN).
struct RangeModel {
  double min_range = 0.05;       ///< [m], >= 0.
  double max_range = 30.0;       ///< [m].
  double sigma = 0.02;           ///< Standard deviation of a range r is sigma + sigma_quadratic r² [m].
  double sigma_quadratic = 0.0;  ///< [1/m].
  NoEcho no_echo = NoEcho::free_to_max_range;

  [[nodiscard]] double sigma_at(double range) const { return sigma + sigma_quadratic * range * range; }

  /// @throws std::invalid_argument that names the first value out of its limits.
  void validate() const;
};

/// A laser that turns in the plane; x points ahead.
struct PlanarLaser {
  double field_of_view = 3.14159265358979324;  ///< From the first to the last beam [rad].
  int beams = 361;
  RangeModel range;

  void validate() const;
  /// Unit directions from the right, -field_of_view / 2, to the left, both ends included.
  [[nodiscard]] Points<2> directions() const;
};

/// A pinhole depth camera; x points right, y down, z ahead. The defaults are close to a Kinect's.
struct DepthCamera {
  int width = 160;              ///< Pixels a row.
  int height = 120;             ///< Rows.
  double field_of_view = 1.02;  ///< From the left to the right border of the image [rad].
  RangeModel range{0.4, 6.0, 0.002, 0.0015, NoEcho::no_measurement};

  void validate() const;
  /// Unit directions through the centres of the pixels, row by row from the top left.
  [[nodiscard]] Points<3> directions() const;
};

/// A lidar of rings that turns about its z axis; x points ahead.
struct RingLidar {
  int rings = 64;
  int azimuths = 512;             ///< Beams a ring.
  double lowest = -0.4363323130;  ///< Elevation of the first ring [rad]: -25 degrees.
  double highest = 0.2617993878;  ///< Elevation of the last ring [rad]: 15 degrees.
  RangeModel range{0.5, 60.0, 0.02, 0.0, NoEcho::free_to_max_range};

  void validate() const;
  /// Unit directions ring by ring from the lowest, each counter-clockwise from ahead.
  [[nodiscard]] Points<3> directions() const;
};

namespace detail {

inline void require(bool holds, const char* name, double value, const char* expected) {
  if (!holds) throw std::invalid_argument(std::string(name) + " = " + describe_number(value) + expected);
}

inline void require(bool holds, const char* name, int value, const char* expected) {
  if (!holds) throw std::invalid_argument(std::string(name) + " = " + std::to_string(value) + expected);
}

/// The i-th of n values from `first` to `last`, both included; their middle if there is only one.
inline double spread(double first, double last, int i, int n) {
  return n == 1 ? 0.5 * (first + last) : first + (last - first) * i / (n - 1);
}

}  // namespace detail

inline void RangeModel::validate() const {
  using detail::require;
  require(min_range >= 0.0 && std::isfinite(min_range), "min_range", min_range, " m: must be >= 0");
  require(max_range > min_range && std::isfinite(max_range), "max_range", max_range,
          " m: must be > min_range");
  require(sigma >= 0.0 && std::isfinite(sigma), "sigma", sigma, " m: must be >= 0");
  require(sigma_quadratic >= 0.0 && std::isfinite(sigma_quadratic), "sigma_quadratic", sigma_quadratic,
          " 1/m: must be >= 0");
}

inline void PlanarLaser::validate() const {
  detail::require(field_of_view > 0.0 && field_of_view <= 6.2831853071795865, "field_of_view", field_of_view,
                  " rad: must be in (0, 2 pi]");
  detail::require(beams >= 1, "beams", beams, ": must be >= 1");
  range.validate();
}

inline Points<2> PlanarLaser::directions() const {
  Points<2> all(2, beams);
  for (int i = 0; i < beams; ++i) {
    const double angle = detail::spread(-0.5 * field_of_view, 0.5 * field_of_view, i, beams);
    all.col(i) << std::cos(angle), std::sin(angle);
  }
  return all;
}

inline void DepthCamera::validate() const {
  detail::require(width >= 1, "width", width, " pixels: must be >= 1");
  detail::require(height >= 1, "height", height, " pixels: must be >= 1");
  detail::require(field_of_view > 0.0 && field_of_view < 3.14159265358979324, "field_of_view", field_of_view,
                  " rad: must be in (0, pi)");
  range.validate();
}

inline Points<3> DepthCamera::directions() const {
  const double focal_length = 0.5 * width / std::tan(0.5 * field_of_view);
  Points<3> all(3, Eigen::Index{width} * height);
  for (int v = 0; v < height; ++v)
    for (int u = 0; u < width; ++u)
      all.col(Eigen::Index{v} * width + u) =
          Vector<3>(u + 0.5 - 0.5 * width, v + 0.5 - 0.5 * height, focal_length).normalized();
  return all;
}

inline void RingLidar::validate() const {
  constexpr double right_angle = 1.57079632679489662;
  detail::require(rings >= 1, "rings", rings, ": must be >= 1");
  detail::require(azimuths >= 1, "azimuths", azimuths, ": must be >= 1");
  detail::require(lowest >= -right_angle && lowest <= right_angle, "lowest", lowest,
                  " rad: must be in [-pi / 2, pi / 2]");
  detail::require(highest >= lowest && highest <= right_angle, "highest", highest,
                  " rad: must be in [lowest, pi / 2]");
  range.validate();
}

inline Points<3> RingLidar::directions() const {
  constexpr double two_pi = 6.28318530717958648;
  Points<3> all(3, Eigen::Index{rings} * azimuths);
  for (int ring = 0; ring < rings; ++ring) {
    const double elevation = detail::spread(lowest, highest, ring, rings);
    for (int i = 0; i < azimuths; ++i) {
      const double azimuth = two_pi * i / azimuths;
      all.col(Eigen::Index{ring} * azimuths + i) << std::cos(elevation) * std::cos(azimuth),
          std::cos(elevation) * std::sin(azimuth), std::sin(elevation);
    }
  }
  return all;
}

}  // namespace ndtree
