// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Convex free space along a path, as optimizers of trajectories take it.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <stdexcept>
#include <string>
#include <variant>
#include <vector>

#include "ndtree/core/body.hpp"
#include "ndtree/core/cancel.hpp"
#include "ndtree/core/option.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/planning/sweep.hpp"
#include "ndtree/query/cells.hpp"

namespace ndtree {

/// All points x with normal · x <= offset.
template <int D>
struct HalfSpace {
  Vector<D> normal;  ///< Of length 1.
  double offset;     ///< [m]
};

namespace detail {

/// How far a part of a body reaches in a direction [m].
template <int D>
[[nodiscard]] double reach_along(const BodyPart<D>& part, const Vector<D>& direction) {
  if (const auto* const capsule = std::get_if<Capsule<D>>(&part))
    return std::max(capsule->a.dot(direction), capsule->b.dot(direction)) + capsule->radius;
  const auto& box = std::get<OrientedBox<D>>(part);
  return box.center.dot(direction) + box.half_size.dot((box.axes.transpose() * direction).cwiseAbs());
}

/// Cuts a convex set of places around a segment free of obstacles.
template <int D>
class CorridorCell {
 public:
  /// @param limits all places of the set lie in it.
  CorridorCell(const Body<D>& body, const Vector<D>& from, const Vector<D>& to, const Box<D>& limits)
      : body_(body), from_(from), to_(to) {
    for (int a = 0; a < D; ++a) {
      planes_.push_back({Vector<D>::Unit(a), limits.upper[a]});
      planes_.push_back({-Vector<D>::Unit(a), -limits.lower[a]});
    }
  }
  /// Takes obstacles away, the nearest first: a plane at right angles to the shortest way from the swept body
  /// to an obstacle lets no part beyond it, and mostly keeps others out as well.
  void cut(const std::vector<Box<D>>& obstacles) {
    for (const BodyPart<D>& part : body_) {
      const Sweep<D> sweep = sweep_of<D>(part, from_, to_);
      std::vector<Obstacle> nearest;
      for (const Box<D>& box : obstacles) {
        SweepDistance<D> distance(sweep, box);
        while (distance.refine()) {
        }
        nearest.push_back({distance.least(), distance.way(), &box});
      }
      std::stable_sort(nearest.begin(), nearest.end(),
                       [](const Obstacle& a, const Obstacle& b) { return a.squared < b.squared; });
      for (const Obstacle& obstacle : nearest) cut(part, obstacle);
    }
    widen(obstacles);
    for (HalfSpace<D>& plane : planes_)  // Rounding may put one a little before the segment.
      plane.offset = std::max({plane.offset, plane.normal.dot(from_), plane.normal.dot(to_)});
  }
  [[nodiscard]] const std::vector<HalfSpace<D>>& planes() const { return planes_; }

 private:
  struct Obstacle {
    double squared;  // Of the distance from the swept body [m²].
    Vector<D> way;   // From its nearest point [m].
    const Box<D>* box;
  };

  /// Of a plane, so that from before it a part meets no point of a box behind it.
  [[nodiscard]] static double largest_offset(const Vector<D>& normal, const BodyPart<D>& part,
                                             const Box<D>& box) {
    return normal.dot(0.5 * (box.lower + box.upper)) -
           (0.5 * (box.upper - box.lower)).dot(normal.cwiseAbs()) - reach_along(part, normal);
  }
  /// Whether a plane, other than one, has a box behind it.
  [[nodiscard]] bool is_behind_any(const BodyPart<D>& part, const Box<D>& box,
                                   const HalfSpace<D>* other_than) const {
    return std::any_of(planes_.begin(), planes_.end(), [&](const HalfSpace<D>& plane) {
      return &plane != other_than && largest_offset(plane.normal, part, box) >= plane.offset;
    });
  }
  void cut(const BodyPart<D>& part, const Obstacle& obstacle) {
    if (is_behind_any(part, *obstacle.box, nullptr)) return;
    const double length = obstacle.way.norm();
    if (!(length > 0.0)) throw std::invalid_argument("path: the body meets an obstacle on a segment");
    const Vector<D> normal = obstacle.way / length;
    planes_.push_back({normal, largest_offset(normal, part, *obstacle.box)});
  }
  /// Moves each plane out to the first of the boxes that are behind no other; a plane without one goes. What
  /// only one plane has behind it then stays so: none could be moved after all were.
  void widen(const std::vector<Box<D>>& obstacles) {
    for (auto plane = planes_.begin() + 2 * D; plane != planes_.end();) {
      plane->offset = std::numeric_limits<double>::infinity();
      for (const BodyPart<D>& part : body_)
        for (const Box<D>& box : obstacles) {
          const double offset = largest_offset(plane->normal, part, box);
          if (offset < plane->offset && !is_behind_any(part, box, &*plane)) plane->offset = offset;
        }
      plane = std::isfinite(plane->offset) ? plane + 1 : planes_.erase(plane);
    }
  }

  const Body<D>& body_;
  Vector<D> from_;
  Vector<D> to_;
  std::vector<HalfSpace<D>> planes_;
};

}  // namespace detail

/// For each segment of a path, a convex set of places of the body that contains the segment, so that
/// neighbours share the point between them. From no place in a set does the body overlap an obstacle, as each
/// obstacle is behind one of the planes as a whole. In this sense a set is as large as it can be: where a
/// plane was left out, or moved out, an obstacle would be behind none. The planes are at right angles to
/// shortest ways from the swept body to obstacles, the nearest first.
/// @param path two points at least, free for the body, as Path::points. @param reach how far sets go beyond
/// the segment on each axis, > 0 [m].
/// @throws std::invalid_argument if the body meets an obstacle on the path, or `reach` is not > 0 and finite.
/// Cancelled, see CancelScope.
/// O(segments · obstacles around · planes²).
template <class Map>
[[nodiscard]] std::vector<std::vector<HalfSpace<Map::kDim>>> corridors(
    const Map& map, const Body<Map::kDim>& body, const std::vector<Vector<Map::kDim>>& path, double reach,
    UnknownSpace unknown = UnknownSpace::occupied) {
  constexpr int D = Map::kDim;
  if (!(reach > 0.0) || !std::isfinite(reach))
    throw std::invalid_argument("reach = " + describe_number(reach) + " m: must be > 0 and finite");
  const RegionStates obstacles = obstacles_of(map, unknown);
  const double extent = reach_of(body);
  std::vector<std::vector<HalfSpace<D>>> result;
  for (std::size_t i = 0; i + 1 < path.size(); ++i) {
    checkpoint();
    if (sweep_collides(map, body, path[i], path[i + 1], unknown))
      throw std::invalid_argument("path: the body meets an obstacle in segment " + std::to_string(i));
    const Box<D> around{path[i].cwiseMin(path[i + 1]), path[i].cwiseMax(path[i + 1])};
    detail::CorridorCell<D> cell(body, path[i], path[i + 1], around.inflated(reach));
    cell.cut(boxes_of(map, around.inflated(reach + extent), obstacles));
    result.push_back(cell.planes());
  }
  return result;
}

}  // namespace ndtree
