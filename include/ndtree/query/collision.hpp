// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Whether a body meets an obstacle, in one pose or on its way through many.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <variant>

#include "ndtree/cell/occupancy_cell.hpp"
#include "ndtree/cell/summary.hpp"
#include "ndtree/core/body.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/query/cells.hpp"
#include "ndtree/query/region.hpp"
#include "ndtree/tree/child_index.hpp"

namespace ndtree {

namespace detail {

/// How a cube lies to a shape, as far as its centre and edge tell.
enum class Nearness { apart, open, touching, inside };

/// That of cubes to the points around a segment.
template <int D>
class NearnessToCapsule {
 public:
  explicit NearnessToCapsule(const Capsule<D>& capsule) : capsule_(capsule), way_(capsule.b - capsule.a) {
    const double length = way_.squaredNorm();
    constexpr double kPoint = 1e-300;  // Shorter ones are taken for points.
    per_length_ = length > kPoint ? 1.0 / length : 0.0;
  }

  /// @param half of the cube's edge. @param corner how far the cube's corners are from its centre.
  /// @param rounding by which all may be wrong [m].
  [[nodiscard]] Nearness operator()(const Vector<D>& centre, double half, double corner,
                                    double rounding) const {
    const Vector<D> from_a = centre - capsule_.a;
    const double fraction = std::clamp(from_a.dot(way_) * per_length_, 0.0, 1.0);
    const double squared = (from_a - fraction * way_).squaredNorm();
    const auto is_within = [squared](double distance) {
      return distance > 0.0 && squared <= distance * distance;
    };
    if (!is_within(capsule_.radius + corner + rounding)) return Nearness::apart;
    if (is_within(capsule_.radius - corner - rounding)) return Nearness::inside;
    return is_within(capsule_.radius + half - rounding) ? Nearness::touching : Nearness::open;
  }

 private:
  Capsule<D> capsule_;
  Vector<D> way_;
  double per_length_;
};

/// That of cubes to a box in any pose.
template <int D>
class NearnessToBox {
 public:
  explicit NearnessToBox(const OrientedBox<D>& box) : box_(box), axes_(box.axes.transpose()) {}

  /// As of a capsule.
  [[nodiscard]] Nearness operator()(const Vector<D>& centre, double half, double corner,
                                    double rounding) const {
    const Vector<D> beyond = (axes_ * (centre - box_.center)).cwiseAbs() - box_.half_size;
    if (beyond.maxCoeff() <= -(corner + rounding)) return Nearness::inside;
    const double squared = beyond.cwiseMax(0.0).squaredNorm();
    if (squared > (corner + rounding) * (corner + rounding)) return Nearness::apart;
    const double near = half - rounding;
    return squared <= near * near ? Nearness::touching : Nearness::open;
  }

 private:
  OrientedBox<D> box_;
  Eigen::Matrix<double, D, D> axes_;
};

template <int D>
[[nodiscard]] NearnessToCapsule<D> nearness_to(const Capsule<D>& capsule) {
  return NearnessToCapsule<D>(capsule);
}
template <int D>
[[nodiscard]] NearnessToBox<D> nearness_to(const OrientedBox<D>& box) {
  return NearnessToBox<D>(box);
}

/// All points within a radius of a box: around a shape, and of a ball nothing but the ball.
template <int D>
struct RoundedBox {
  Box<D> core;
  double radius;
};
template <int D>
[[nodiscard]] RoundedBox<D> rounded_box_around(const Capsule<D>& capsule) {
  return {{capsule.a.cwiseMin(capsule.b), capsule.a.cwiseMax(capsule.b)}, capsule.radius};
}
template <int D>
[[nodiscard]] RoundedBox<D> rounded_box_around(const OrientedBox<D>& box) {
  return {bounds_of<D>(box), 0.0};
}

/// Whether a shape shares a point with an obstacle of a tree, see obstacles_of().
template <class Tree, class Shape>
class CollisionSearch {
  static constexpr int D = Tree::kDim;
  static constexpr int N = Tree::kBranching;
  using Ref = typename Tree::ConstRef;

 public:
  CollisionSearch(const Tree& tree, const Shape& shape, const RegionStates& obstacles)
      : tree_(tree),
        shape_(shape),
        nearness_(nearness_to(shape)),
        around_(rounded_box_around(shape)),
        diagonal_(std::sqrt(double{D})),
        rounding_(kRounding * tree.geometry().unit()),
        obstacles_(obstacles) {
    const double reach = around_.radius + rounding_;
    squared_reach_ = reach * reach;
    centre_ = 0.5 * (around_.core.lower + around_.core.upper);
  }

  [[nodiscard]] bool any() const {
    const Ref root = tree_.root();
    return root.is_leaf() ? may_contain(obstacles_, *root.node) && touch(shape_, tree_.box(root.index))
                          : any_below(root);
  }

 private:
  // In smallest cells: more than errors of rounding, far from 0, too.
  static constexpr double kRounding = 1e-5;

  /// @pre `parent` is no leaf.
  [[nodiscard]] bool any_below(const Ref& parent) const {
    const auto& geometry = tree_.geometry();
    const int level = parent.index.level - 1;
    const std::int64_t edge = geometry.edge(level);
    std::array<std::array<double, std::size_t{N}>, std::size_t{D}> squared;  // Distances along each axis.
    Offset<D> nearest{};  // First where an obstacle is likely to be met, if there is one.
    for (std::size_t a = 0; a < D; ++a) {
      const double low = around_.core.lower[static_cast<int>(a)];
      const double high = around_.core.upper[static_cast<int>(a)];
      std::int64_t at = parent.index.lower[a];
      double border = geometry.border(at);
      for (double& value : squared[a]) {
        const double next = geometry.border(at += edge);
        const double gap = std::max({0.0, low - next, border - high});
        value = gap * gap;
        border = next;
        nearest[a] += next < centre_[static_cast<int>(a)];
      }
      nearest[a] = std::min(nearest[a], N - 1);
    }
    const auto* const children = tree_.children(*parent.node);
    const int first = child_number<N, D>(nearest);
    for (int i = 0; i < Tree::kNumChildren; ++i) {
      const int j = child_from<N, D>(first, i);
      const auto offset = child_offset<N, D>(j);
      double sum = 0.0;
      for (std::size_t a = 0; a < D; ++a) sum += squared[a][static_cast<std::size_t>(offset[a])];
      if (sum > squared_reach_ || !may_contain(obstacles_, children[j])) continue;
      const Ref child = tree_.child(parent, j);
      if (collides(child, geometry.cell_size(level))) return true;
    }
    return false;
  }
  [[nodiscard]] bool collides(const Ref& ref, double size) const {
    const double half = 0.5 * size;
    Vector<D> centre;
    for (int a = 0; a < D; ++a)
      centre[a] = tree_.geometry().border(ref.index.lower[static_cast<std::size_t>(a)]) + half;
    const Nearness nearness = nearness_(centre, half, half * diagonal_, rounding_);
    if (nearness == Nearness::apart) return false;
    if (ref.is_leaf()) return nearness != Nearness::open || touch(shape_, tree_.box(ref.index));
    if (nearness == Nearness::inside && has_for_certain(Summary::of(*ref.node))) return true;
    return any_below(ref);
  }

  /// Whether an inner node that may have an obstacle is certain to have one: summaries only say that there
  /// may be something thin.
  [[nodiscard]] bool has_for_certain(const Summary& summary) const {
    return summary.is_valid() && (summary.may_contain(CellState::occupied) ||
                                  (obstacles_.unknown && summary.may_contain(CellState::unknown)));
  }

  const Tree& tree_;
  const Shape& shape_;
  decltype(nearness_to(std::declval<const Shape&>())) nearness_;
  RoundedBox<D> around_;
  double squared_reach_;
  Vector<D> centre_;
  double diagonal_;
  double rounding_;
  RegionStates obstacles_;
};

}  // namespace detail

/// Whether some obstacle shares a point with a shape, borders counted in: an occupied cell, one that holds
/// something thin, or, if unknown space is taken for occupied, an unknown one, or space outside the map.
/// Nodes without any are not entered.
template <class Map>
[[nodiscard]] bool collides(const Map& map, const BodyPart<Map::kDim>& part,
                            UnknownSpace unknown = UnknownSpace::free) {
  const RegionStates obstacles = obstacles_of(map, unknown);
  if (obstacles.unknown && !detail::contains(map.tree(), bounds_of(part))) return true;
  return std::visit(
      [&](const auto& shape) { return detail::CollisionSearch(map.tree(), shape, obstacles).any(); }, part);
}

/// Whether a body collides in a pose, otherwise as above.
template <class Map>
[[nodiscard]] bool collides(const Map& map, const Body<Map::kDim>& body, const Pose<Map::kDim>& pose,
                            UnknownSpace unknown = UnknownSpace::free) {
  for (const BodyPart<Map::kDim>& part : body)
    if (collides(map, moved(part, pose), unknown)) return true;
  return false;
}

/// Between two poses: the translation in equal parts, and the rotation by equal angles, the shorter way.
[[nodiscard]] inline Pose<2> between(const Pose<2>& from, const Pose<2>& to, double fraction) {
  const Eigen::Matrix2d turn = to.rotation * from.rotation.transpose();
  const double angle = fraction * std::atan2(turn(1, 0), turn(0, 0));
  Eigen::Matrix2d part;
  part << std::cos(angle), -std::sin(angle), std::sin(angle), std::cos(angle);
  return {part * from.rotation, from.translation + fraction * (to.translation - from.translation)};
}
[[nodiscard]] inline Pose<3> between(const Pose<3>& from, const Pose<3>& to, double fraction) {
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
  const double part = fraction * angle;  // Rodrigues' formula.
  const Eigen::Matrix3d rotation =
      Eigen::Matrix3d::Identity() + std::sin(part) * cross + (1.0 - std::cos(part)) * cross * cross;
  return {rotation * from.rotation, from.translation + fraction * (to.translation - from.translation)};
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
  const double way = (to.translation - from.translation).norm() + reach_of(body) * angle_between(from, to);
  const double steps = std::max(1.0, std::ceil(2.0 * way / map.tree().geometry().unit()));
  for (double i = 0.0; i <= steps; i += 1.0)
    if (collides(map, body, between(from, to, i / steps), unknown)) return true;
  return false;
}

}  // namespace ndtree
