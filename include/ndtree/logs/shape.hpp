// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Solid shapes of simulated worlds, with exact containment and exact ray intersection.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>

#include "ndtree/core/types.hpp"

namespace ndtree {

namespace detail {

/// Part of a line, in units of its direction. Empty if exit < enter.
struct Interval {
  double enter = -std::numeric_limits<double>::infinity();
  double exit = std::numeric_limits<double>::infinity();

  /// Keeps what lies in the slab lower <= origin + t direction <= upper.
  void clip(double origin, double direction, double lower, double upper) {
    if (direction == 0.0) {
      if (origin < lower || origin > upper) exit = -std::numeric_limits<double>::infinity();
      return;
    }
    const double to_lower = (lower - origin) / direction;
    const double to_upper = (upper - origin) / direction;
    enter = std::max(enter, std::min(to_lower, to_upper));
    exit = std::min(exit, std::max(to_lower, to_upper));
  }
};

}  // namespace detail

/// A closed convex solid, turned about the vertical (in 2-D: in the plane). One equation covers all kinds:
/// with q the point in the shape's own frame, divided by `half` along each axis,
///
///     q_1² + ... + q_R² <= 1  and  |q_k| <= 1 for k > R,  R = round_axes.
///
/// R = 0 is a box, R = 2 an upright cylinder, R = D an ellipsoid.
template <int D>
struct Shape {
  Vector<D> center;                   ///< [m].
  Vector<D> half;                     ///< Half the extent along each own axis [m], > 0.
  Eigen::Vector2d heading{1.0, 0.0};  ///< Unit vector of the shape's own first axis.
  int round_axes = 0;                 ///< 0 <= R <= D.

  /// Turns a map vector into the shape's own frame.
  [[nodiscard]] Vector<D> to_own(Vector<D> v) const {
    if constexpr (D >= 2) {
      const double x = heading.x() * v[0] + heading.y() * v[1];
      v[1] = heading.x() * v[1] - heading.y() * v[0];
      v[0] = x;
    }
    return v;
  }

  /// The surface belongs to the shape.
  [[nodiscard]] bool contains(const Vector<D>& point) const {
    const Vector<D> q = to_own(point - center).cwiseQuotient(half);
    double square = 0.0;
    for (int k = 0; k < round_axes; ++k) square += q[k] * q[k];
    bool inside = square <= 1.0;
    for (int k = round_axes; k < D; ++k) inside = inside && std::abs(q[k]) <= 1.0;
    return inside;
  }

  /// Distance along a unit direction to where the beam first is in the shape; 0 if it starts there.
  [[nodiscard]] std::optional<double> distance(const Vector<D>& origin, const Vector<D>& direction) const {
    const Vector<D> o = to_own(origin - center).cwiseQuotient(half);
    const Vector<D> d = to_own(direction).cwiseQuotient(half);
    detail::Interval inside{0.0, std::numeric_limits<double>::infinity()};
    for (int k = round_axes; k < D; ++k) inside.clip(o[k], d[k], -1.0, 1.0);
    if (round_axes > 0 && inside.enter <= inside.exit) clip_round(o, d, inside);
    if (!(inside.enter <= inside.exit)) return std::nullopt;
    return inside.enter;
  }

  /// Smallest axis-parallel box around the shape; for turned round shapes, around their box.
  [[nodiscard]] Box<D> bounds() const {
    Vector<D> reach = half;
    if constexpr (D >= 2) {
      const double c = std::abs(heading.x());
      const double s = std::abs(heading.y());
      reach[0] = c * half[0] + s * half[1];
      reach[1] = s * half[0] + c * half[1];
    }
    return {center - reach, center + reach};
  }

 private:
  // a t² + 2 b t + c <= 0, with the roots in the form that does not cancel.
  void clip_round(const Vector<D>& o, const Vector<D>& d, detail::Interval& inside) const {
    double a = 0.0;
    double b = 0.0;
    double c = -1.0;
    for (int k = 0; k < round_axes; ++k) {
      a += d[k] * d[k];
      b += o[k] * d[k];
      c += o[k] * o[k];
    }
    const double discriminant = b * b - a * c;
    if (a == 0.0 || discriminant < 0.0) {
      if (c > 0.0 || a != 0.0) inside.exit = -std::numeric_limits<double>::infinity();
      return;
    }
    const double root = std::sqrt(discriminant);
    const double sum = b > 0.0 ? -b - root : -b + root;  // 0 only if b = c = 0: the surface is touched
    const double first = b > 0.0 ? sum / a : (sum == 0.0 ? 0.0 : c / sum);
    const double second = b > 0.0 ? (sum == 0.0 ? 0.0 : c / sum) : sum / a;
    inside.enter = std::max(inside.enter, first);
    inside.exit = std::min(inside.exit, second);
  }
};

}  // namespace ndtree
