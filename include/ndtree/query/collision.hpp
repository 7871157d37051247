// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Whether a body meets an obstacle, in one pose or on its way through many.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>

#include "ndtree/cell/occupancy_cell.hpp"
#include "ndtree/cell/summary.hpp"
#include "ndtree/core/body.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/query/cells.hpp"
#include "ndtree/query/region.hpp"

namespace ndtree {

/// Whether some obstacle shares a point with a shape, borders counted in: an occupied cell, or, if unknown
/// space is taken for occupied, one that is not free, or space outside the map. Nodes without any are not
/// entered.
template <class Map>
[[nodiscard]] bool collides(const Map& map, const BodyPart<Map::kDim>& part,
                            UnknownSpace unknown = UnknownSpace::free) {
  const Box<Map::kDim> around = bounds_of(part);
  const bool mind_unknown = unknown == UnknownSpace::occupied;
  if (mind_unknown && !detail::contains(map.tree(), around)) return true;
  bool found = false;
  detail::for_each_node_touching(map.tree(), map.tree().root(), around, [&](const auto& ref, bool) {
    if (found) return false;
    const Summary summary = Summary::of(*ref.node);
    if (!summary.may_contain(CellState::occupied) &&
        !(mind_unknown && summary.may_contain(CellState::unknown)))
      return false;
    if (!touch(part, map.tree().box(ref.index))) return false;
    found = ref.is_leaf();
    return !found;
  });
  return found;
}

/// The same of a body in a pose.
template <class Map>
[[nodiscard]] bool collides(const Map& map, const Body<Map::kDim>& body, const Pose<Map::kDim>& pose,
                            UnknownSpace unknown = UnknownSpace::free) {
  for (const BodyPart<Map::kDim>& part : body)
    if (collides(map, moved(part, pose), unknown)) return true;
  return false;
}

/// Between two poses: the translation in equal parts, and the rotation by equal angles, the shorter way.
[[nodiscard]] inline Pose<2> between(const Pose<2>& from, const Pose<2>& to, double share) {
  const Eigen::Matrix2d turn = to.rotation * from.rotation.transpose();
  const double angle = share * std::atan2(turn(1, 0), turn(0, 0));
  Eigen::Matrix2d part;
  part << std::cos(angle), -std::sin(angle), std::sin(angle), std::cos(angle);
  return {part * from.rotation, from.translation + share * (to.translation - from.translation)};
}
[[nodiscard]] inline Pose<3> between(const Pose<3>& from, const Pose<3>& to, double share) {
  const Eigen::Matrix3d turn = to.rotation * from.rotation.transpose();
  Vector<3> axis(turn(2, 1) - turn(1, 2), turn(0, 2) - turn(2, 0), turn(1, 0) - turn(0, 1));
  const double sine = 0.5 * axis.norm();
  const double cosine = 0.5 * (turn.trace() - 1.0);
  const double angle = std::atan2(sine, cosine);
  if (sine > 1e-9) {
    axis /= 2.0 * sine;
  } else if (cosine < 0.0) {  // Half a turn: turn + 1 = 2 axis axis^T.
    Eigen::Index longest = 0;
    turn.diagonal().maxCoeff(&longest);
    axis = turn.col(longest) + Vector<3>::Unit(longest);
    axis.normalize();
  } else {
    axis.setZero();
  }
  Eigen::Matrix3d cross;
  cross << 0.0, -axis[2], axis[1], axis[2], 0.0, -axis[0], -axis[1], axis[0], 0.0;
  const double part = share * angle;  // Rodrigues' formula.
  const Eigen::Matrix3d rotation =
      Eigen::Matrix3d::Identity() + std::sin(part) * cross + (1.0 - std::cos(part)) * cross * cross;
  return {rotation * from.rotation, from.translation + share * (to.translation - from.translation)};
}

/// The angle between two poses' rotations [rad], in [0, pi].
template <int D>
[[nodiscard]] double angle_between(const Pose<D>& from, const Pose<D>& to) {
  const double chord = (to.rotation - from.rotation).norm() / std::sqrt(8.0);  // sin of half the angle.
  return 2.0 * std::asin(std::min(1.0, chord));
}

/// Whether a body meets an obstacle on its way from one pose to the next, both ends counted in, see
/// between(). The way is looked at in steps in which no point of the body moves farther than half a smallest
/// cell; so the corner of an obstacle may be missed that reaches less than a quarter of a cell into the way.
template <class Map>
[[nodiscard]] bool collides_between(const Map& map, const Body<Map::kDim>& body, const Pose<Map::kDim>& from,
                                    const Pose<Map::kDim>& to, UnknownSpace unknown = UnknownSpace::free) {
  double reach = 0.0;
  for (const auto& part : body) reach = std::max(reach, reach_of(part));
  const double way = (to.translation - from.translation).norm() + reach * angle_between(from, to);
  const double steps = std::max(1.0, std::ceil(2.0 * way / map.tree().geometry().unit()));
  for (double i = 0.0; i <= steps; i += 1.0)
    if (collides(map, body, between(from, to, i / steps), unknown)) return true;
  return false;
}

}  // namespace ndtree
