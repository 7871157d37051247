// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// One measurement, and what it says: a surface, free space only, or nothing.
#pragma once

#include <cmath>
#include <limits>

#include "ndtree/core/simd.hpp"
#include "ndtree/core/types.hpp"

namespace ndtree {

/// What a beam measured.
enum class BeamOutcome {
  returned,          ///< A surface at the end point, free space before it.
  not_returned,      ///< Free space up to the end point or `max_range`, no surface.
  beyond_max_range,  ///< Returned from farther than `max_range`: free space up to there, no surface.
  invalid            ///< Not finite, or of zero length: says nothing.
};

/// No limit to the range.
inline constexpr double kUnlimitedRange = std::numeric_limits<double>::infinity();

/// Length of a vector, of squares that are rounded one by one.
template <int D>
[[nodiscard]] double length_of(const Vector<D>& v) {
  Vector<D> squares = v.cwiseAbs2();
  for (int a = 0; a < D; ++a) squares[a] = unfused(squares[a]);
  return std::sqrt(squares.sum());
}

/// One measurement in the map frame. Its points are origin + t * displacement; the end point is at t = 1.
template <int D>
struct Beam {
  Vector<D> origin;
  Vector<D> endpoint;
  Vector<D> displacement;  ///< endpoint - origin [m].
  double range = 0.0;      ///< Length of the displacement [m].
  double t_free = 0.0;     ///< Up to here nothing was hit: 1, or max_range / range if that is less.
  BeamOutcome outcome = BeamOutcome::invalid;

  Beam(const Vector<D>& from, const Vector<D>& to, bool returned = true, double max_range = kUnlimitedRange)
      : origin(from), endpoint(to), displacement(to - from), range(length_of<D>(displacement)) {
    if (std::isinf(range)) range = long_range();
    if (!(range >= kShortest) || !std::isfinite(range) || !origin.allFinite()) return;
    const bool in_reach = range <= max_range;
    t_free = in_reach ? 1.0 : max_range / range;
    outcome = !returned  ? BeamOutcome::not_returned
              : in_reach ? BeamOutcome::returned
                         : BeamOutcome::beyond_max_range;
  }

  static constexpr double kShortest = 1e-18;  ///< Shorter ones have no direction [m].

  [[nodiscard]] Vector<D> point(double t) const {
    Vector<D> result;
    for (int a = 0; a < D; ++a) result[a] = origin[a] + unfused(t * displacement[a]);
    return result;
  }
  /// Where the free part ends: the end point itself if all of the beam is in range.
  [[nodiscard]] Vector<D> free_end() const { return t_free == 1.0 ? endpoint : point(t_free); }

 private:
  /// The plain norm squares too far.
  [[nodiscard]] double long_range() const { return displacement.stableNorm(); }
};

}  // namespace ndtree
