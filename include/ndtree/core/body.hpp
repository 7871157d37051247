// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// What a robot is made of, for questions of collision and for changes by hand: spheres, capsules and boxes
/// in any pose.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <variant>
#include <vector>

#include "ndtree/core/types.hpp"

namespace ndtree {

/// All points at most `radius` away from the segment from a to b [m]; a sphere if they are one point.
template <int D>
struct Capsule {
  Vector<D> a;
  Vector<D> b;
  double radius;
};

/// A box around a centre, with axes of its own: the columns of a rotation.
template <int D>
struct OrientedBox {
  Vector<D> center;
  Vector<D> half_size;
  Eigen::Matrix<double, D, D> axes;
};

/// A piece of a robot's body.
template <int D>
using BodyPart = std::variant<Capsule<D>, OrientedBox<D>>;
/// The union of its pieces.
template <int D>
using Body = std::vector<BodyPart<D>>;

/// A rigid motion: x -> rotation x + translation.
template <int D>
struct Pose {
  Eigen::Matrix<double, D, D> rotation = Eigen::Matrix<double, D, D>::Identity();
  Vector<D> translation = Vector<D>::Zero();

  [[nodiscard]] Vector<D> operator*(const Vector<D>& point) const { return rotation * point + translation; }
};

/// A shape in a pose.
template <int D>
[[nodiscard]] BodyPart<D> moved(const BodyPart<D>& part, const Pose<D>& pose) {
  if (const auto* const capsule = std::get_if<Capsule<D>>(&part))
    return Capsule<D>{pose * capsule->a, pose * capsule->b, capsule->radius};
  const auto& box = std::get<OrientedBox<D>>(part);
  return OrientedBox<D>{pose * box.center, box.half_size, pose.rotation * box.axes};
}

/// All shapes of a body in a pose.
template <int D>
[[nodiscard]] Body<D> moved(const Body<D>& body, const Pose<D>& pose) {
  Body<D> result;
  result.reserve(body.size());
  for (const BodyPart<D>& part : body) result.push_back(moved(part, pose));
  return result;
}

/// The smallest box with sides along the axes of the map around a shape.
template <int D>
[[nodiscard]] Box<D> bounds_of(const BodyPart<D>& part) {
  if (const auto* const capsule = std::get_if<Capsule<D>>(&part))
    return {(capsule->a.cwiseMin(capsule->b).array() - capsule->radius).matrix(),
            (capsule->a.cwiseMax(capsule->b).array() + capsule->radius).matrix()};
  const auto& box = std::get<OrientedBox<D>>(part);
  const Vector<D> reach = box.axes.cwiseAbs() * box.half_size;
  return {box.center - reach, box.center + reach};
}

/// The farthest that a point of a shape lies from 0 [m], or a little more.
template <int D>
[[nodiscard]] double reach_of(const BodyPart<D>& part) {
  if (const auto* const capsule = std::get_if<Capsule<D>>(&part))
    return std::max(capsule->a.norm(), capsule->b.norm()) + capsule->radius;
  const auto& box = std::get<OrientedBox<D>>(part);
  return box.center.norm() + box.half_size.norm();
}

/// The farthest that a point of a body lies from its origin [m], or a little more.
template <int D>
[[nodiscard]] double reach_of(const Body<D>& body) {
  double reach = 0.0;
  for (const BodyPart<D>& part : body) reach = std::max(reach, reach_of(part));
  return reach;
}

/// Squared distance between a segment and a closed box [m²]; 0 if they meet. Along the segment it is convex,
/// and a parabola between the planes of the box: its slope is 0 where it is least, or changes its sign at an
/// end.
template <int D>
[[nodiscard]] double squared_distance(const Vector<D>& a, const Vector<D>& b, const Box<D>& box) {
  const Vector<D> way = b - a;
  const auto slope = [&](double t) {  // Half of it.
    double sum = 0.0;
    for (int k = 0; k < D; ++k) {
      const double at = a[k] + t * way[k];
      sum += way[k] * (at < box.lower[k] ? at - box.lower[k] : at > box.upper[k] ? at - box.upper[k] : 0.0);
    }
    return sum;
  };
  const auto distance = [&](double t) { return box.squared_distance(Vector<D>(a + t * way)); };
  if (slope(0.0) >= 0.0) return distance(0.0);
  if (slope(1.0) <= 0.0) return distance(1.0);
  double low = 0.0;  // Where it falls, and where it does not: planes between them are taken in.
  double high = 1.0;
  for (int k = 0; k < D; ++k)
    for (const double plane : {box.lower[k], box.upper[k]}) {
      if (way[k] == 0.0) continue;
      const double t = (plane - a[k]) / way[k];
      if (!(t > low) || !(t < high)) continue;
      (slope(t) < 0.0 ? low : high) = t;
    }
  const double falls = slope(low);  // It is linear between them.
  const double rises = slope(high);
  const double t = rises > falls ? low + (high - low) * falls / (falls - rises) : low;
  return std::min({distance(t), distance(low), distance(high)});
}

/// Whether a shape and a closed box share a point.
template <int D>
[[nodiscard]] bool touch(const Capsule<D>& capsule, const Box<D>& box) {
  return squared_distance<D>(capsule.a, capsule.b, box) <= capsule.radius * capsule.radius;
}
/// By separating axes: the sides of both, and in 3-D what is at right angles to an edge of each.
template <int D>
[[nodiscard]] bool touch(const OrientedBox<D>& oriented, const Box<D>& box) {
  static_assert(D == 2 || D == 3, "in the plane or in space");
  const Vector<D> half = 0.5 * (box.upper - box.lower);
  const Vector<D> between = oriented.center - 0.5 * (box.upper + box.lower);
  const auto separates = [&](const Vector<D>& axis) {
    const double own = half.dot(axis.cwiseAbs());
    const double others = oriented.half_size.dot((oriented.axes.transpose() * axis).cwiseAbs());
    return std::abs(between.dot(axis)) > own + others;
  };
  for (int k = 0; k < D; ++k)
    if (separates(Vector<D>::Unit(k)) || separates(oriented.axes.col(k))) return false;
  if constexpr (D == 3) {
    for (int k = 0; k < D; ++k)
      for (int m = 0; m < D; ++m) {
        // Unit(k) x axes.col(m), written out: Eigen's cross() needs another header.
        Vector<D> axis = Vector<D>::Zero();
        axis[(k + 1) % 3] = -oriented.axes((k + 2) % 3, m);
        axis[(k + 2) % 3] = oriented.axes((k + 1) % 3, m);
        if (separates(axis)) return false;
      }
  }
  return true;
}
template <int D>
[[nodiscard]] bool touch(const BodyPart<D>& part, const Box<D>& box) {
  return std::visit([&](const auto& one) { return touch(one, box); }, part);
}

/// Whether a shape contains all of a closed box: shapes are convex, so its corners decide.
template <int D>
[[nodiscard]] bool encloses(const BodyPart<D>& part, const Box<D>& box) {
  const auto contains = [&](const Vector<D>& point) {
    if (const auto* const capsule = std::get_if<Capsule<D>>(&part))
      return squared_distance<D>(capsule->a, capsule->b, {point, point}) <= capsule->radius * capsule->radius;
    const auto& oriented = std::get<OrientedBox<D>>(part);
    const Vector<D> place = oriented.axes.transpose() * (point - oriented.center);
    return (place.cwiseAbs().array() <= oriented.half_size.array()).all();
  };
  for (int corner = 0; corner < 1 << D; ++corner) {
    Vector<D> point;
    for (int k = 0; k < D; ++k) point[k] = (corner >> k & 1) != 0 ? box.upper[k] : box.lower[k];
    if (!contains(point)) return false;
  }
  return true;
}

}  // namespace ndtree
