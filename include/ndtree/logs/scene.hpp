// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Builds simulated worlds from parts that stand upright: blocks, posts, round bodies, walls with openings.
#pragma once

#include <Eigen/Core>
#include <cmath>
#include <vector>

#include "ndtree/core/types.hpp"
#include "ndtree/logs/path.hpp"
#include "ndtree/logs/shape.hpp"

namespace ndtree {

/// The solids of a world before it is built, and a way through it that keeps clear of them.
template <int D>
struct Scene {
  std::vector<Shape<D>> shapes;
  std::vector<Waypoint> path;
};

/// A place in a scene with its own x and y axes, which adds parts given in them [m, rad].
/// Heights are above the map's z = 0; in 2-D they mean nothing and the parts are their footprints.
template <int D>
class Place {
 public:
  explicit Place(Scene<D>& scene, double yaw = 0.0) : scene_(&scene), yaw_(yaw) {}

  /// A place given in this one.
  [[nodiscard]] Place at(double x, double y, double yaw = 0.0) const {
    Place inner(*scene_, yaw_ + yaw);
    inner.position_ = position_in_map(x, y);
    return inner;
  }

  [[nodiscard]] Eigen::Vector2d position_in_map(double x, double y) const {
    const double c = std::cos(yaw_);
    const double s = std::sin(yaw_);
    return position_ + Eigen::Vector2d(c * x - s * y, s * x + c * y);
  }

  /// A box with its middle at (x, y).
  void block(double x, double y, double size_x, double size_y, double bottom = 0.0, double top = 1.0) const {
    add(x, y, size_x, size_y, bottom, top, 0);
  }
  /// An upright cylinder.
  void post(double x, double y, double radius, double bottom = 0.0, double top = 1.0) const {
    add(x, y, 2.0 * radius, 2.0 * radius, bottom, top, 2);
  }
  /// An ellipsoid that fills the block of these numbers.
  void ellipsoid(double x, double y, double size_x, double size_y, double bottom, double top) const {
    add(x, y, size_x, size_y, bottom, top, D);
  }
  /// Four square legs whose centres are the corners of a rectangle around this place.
  void legs(double size_x, double size_y, double thickness, double top = 1.0) const {
    for (const double x : {-0.5 * size_x, 0.5 * size_x})
      for (const double y : {-0.5 * size_y, 0.5 * size_y}) block(x, y, thickness, thickness, 0.0, top);
  }
  /// The way goes on to here.
  void pass(double x, double y, double spin = 0.0) const {
    const Eigen::Vector2d position = position_in_map(x, y);
    scene_->path.push_back({position.x(), position.y(), spin});
  }

 private:
  void add(double x, double y, double size_x, double size_y, double bottom, double top,
           int round_axes) const {
    const Eigen::Vector2d middle = position_in_map(x, y);
    Shape<D> shape;
    shape.center.template head<2>() = middle;
    shape.half.template head<2>() << 0.5 * size_x, 0.5 * size_y;
    if constexpr (D == 3) {
      shape.center[2] = 0.5 * (bottom + top);
      shape.half[2] = 0.5 * (top - bottom);
    }
    shape.heading << std::cos(yaw_), std::sin(yaw_);
    shape.round_axes = round_axes;
    scene_->shapes.push_back(shape);
  }

  Scene<D>* scene_;
  Eigen::Vector2d position_ = Eigen::Vector2d::Zero();
  double yaw_ = 0.0;
};

/// A hole in a wall: a stretch of its length, and of its height [m].
struct Opening {
  double from = 0.0;
  double to = 0.0;
  double bottom = 0.0;
  double top = 0.0;
};

/// A wall along the x axis of a place, from x = 0, half its thickness on either side. The openings are in
/// order and do not overlap; in 2-D each is open whatever its height.
template <int D>
void add_wall(const Place<D>& place, double length, double thickness, double bottom, double top,
              const std::vector<Opening>& openings = {}) {
  const auto piece = [&](double from, double to, double low, double high) {
    if (from < to && low < high) place.block(0.5 * (from + to), 0.0, to - from, thickness, low, high);
  };
  double done = 0.0;
  for (const Opening& opening : openings) {
    piece(done, opening.from, bottom, top);
    if constexpr (D == 3) {
      piece(opening.from, opening.to, bottom, opening.bottom);
      piece(opening.from, opening.to, opening.top, top);
    }
    done = opening.to;
  }
  piece(done, length, bottom, top);
}

}  // namespace ndtree
