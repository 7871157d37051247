// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// What one sees from a point through faces of cells, one behind another.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>

#include "ndtree/core/types.hpp"

namespace ndtree::detail {

/// The axis on which a face has no extent.
template <int D>
[[nodiscard]] int axis_of(const Box<D>& face) {
  int axis = 0;
  while (axis < D - 1 && face.lower[axis] != face.upper[axis]) ++axis;
  return axis;
}

/// All directions that go through each of some axis-parallel faces: in the plane of each two axes they lie
/// between two directions, as a face is a box. O(D) a face, whatever lies between.
template <int D>
class Cone {
 public:
  /// Of no direction.
  [[nodiscard]] static Cone empty() {
    Cone cone;
    cone.is_empty_ = true;
    return cone;
  }
  /// Keeps the directions that go through a face, too. @param from point from which one looks.
  void narrow(const Box<D>& face, const Vector<D>& from) {
    const int axis = axis_of(face);
    const double ahead = face.lower[axis] - from[axis];
    for (int other = 0; other < D; ++other) {
      if (other == axis || is_empty_) continue;
      const double low = face.lower[other] - from[other];
      const double high = face.upper[other] - from[other];
      if (ahead == 0.0) {  // From a point of the face, all of the cell behind it is seen.
        is_empty_ = low > 0.0 || high < 0.0;
        continue;
      }
      const bool turns = (axis < other) == (ahead > 0.0);
      narrow(axis, other, ahead, turns ? low : high, turns ? high : low);
    }
  }
  /// The point of a face that is seen and nearest to another of its points, on each axis alone.
  [[nodiscard]] Vector<D> moved_into(Vector<D> point, const Box<D>& face, const Vector<D>& from) const {
    const int axis = axis_of(face);
    const double ahead = face.lower[axis] - from[axis];
    if (is_empty_ || ahead == 0.0) return point;
    for (int other = 0; other < D; ++other) {
      if (other == axis) continue;
      const bool in_order = axis < other;
      const auto along = [&](const Arm& arm) {
        return from[other] + ahead * (in_order ? arm[1] / arm[0] : arm[0] / arm[1]);
      };
      const Plane& plane = planes_[in_order ? number(axis, other) : number(other, axis)];
      const auto [low, high] = std::minmax({along(plane.first), along(plane.last)});
      const double inside = kInside * (high - low);
      point[other] = std::clamp(point[other], low + inside, high - inside);
    }
    return point;
  }
  [[nodiscard]] bool contains(const Vector<D>& direction) const {
    if (is_empty_) return false;
    for (int i = 0; i < D; ++i)
      for (int j = i + 1; j < D; ++j)
        if (!planes_[number(i, j)].contains({direction[i], direction[j]})) return false;
    return true;
  }

 private:
  using Arm = std::array<double, 2>;
  struct Plane {
    Arm first{}, last{};  // Counterclockwise, less than half a turn; 0 at the beginning: all directions.
    [[nodiscard]] bool contains(const Arm& arm) const {
      return cross(first, arm) >= 0.0 && cross(arm, last) >= 0.0;
    }
  };
  static constexpr double kInside = 1e-9;  // From the border, of the width, lest rounding leads out.

  [[nodiscard]] static double cross(const Arm& a, const Arm& b) { return a[0] * b[1] - a[1] * b[0]; }
  [[nodiscard]] static std::size_t number(int i, int j) { return static_cast<std::size_t>(i + j - 1); }

  void narrow(int axis, int other, double ahead, double first, double last) {
    const bool in_order = axis < other;
    const Arm begin = in_order ? Arm{ahead, first} : Arm{first, ahead};
    const Arm end = in_order ? Arm{ahead, last} : Arm{last, ahead};
    Plane& plane = planes_[in_order ? number(axis, other) : number(other, axis)];
    const Plane here{begin, end};
    if (plane.first == Arm{}) {
      plane = here;
      return;
    }
    const bool begins_in = plane.contains(begin);
    is_empty_ = !begins_in && !here.contains(plane.first);
    if (plane.contains(end)) plane.last = end;
    if (begins_in) plane.first = begin;
  }

  std::array<Plane, std::size_t{D} * (D - 1) / 2> planes_{};
  bool is_empty_ = false;
};

}  // namespace ndtree::detail
