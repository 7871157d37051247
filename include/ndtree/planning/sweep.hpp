// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// A body that moves along a segment without turning: whether it meets an obstacle anywhere on the way, and
/// how near it comes to one, exactly.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <variant>

#include "ndtree/cell/summary.hpp"
#include "ndtree/core/body.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/query/cells.hpp"
#include "ndtree/query/collision.hpp"
#include "ndtree/tree/child_index.hpp"

namespace ndtree {

namespace detail {

/// All points that a part of a body touches on its way: those within `radius` of a zonotope, the sum of
/// `count` segments through 0 with these ends, and their opposites, around a centre.
template <int D>
struct Sweep {
  Vector<D> center;
  std::array<Vector<D>, std::size_t{D} + 1> ends;
  int count = 0;
  double radius = 0.0;

  void add(const Vector<D>& end) {
    if (!end.isZero(0.0)) ends[static_cast<std::size_t>(count++)] = end;
  }
  /// Of the zonotope, along each axis.
  [[nodiscard]] Vector<D> half_size() const {
    Vector<D> sum = Vector<D>::Zero();
    for (int k = 0; k < count; ++k) sum += ends[static_cast<std::size_t>(k)].cwiseAbs();
    return sum;
  }
};

template <int D>
[[nodiscard]] Sweep<D> sweep_of(const BodyPart<D>& part, const Vector<D>& from, const Vector<D>& to) {
  Sweep<D> sweep;
  const Vector<D> half_way = 0.5 * (to - from);
  sweep.center = from + half_way;
  sweep.add(half_way);
  if (const auto* const capsule = std::get_if<Capsule<D>>(&part)) {
    sweep.center += 0.5 * (capsule->a + capsule->b);
    sweep.add(0.5 * (capsule->b - capsule->a));
    sweep.radius = capsule->radius;
  } else {
    const auto& box = std::get<OrientedBox<D>>(part);
    sweep.center += box.center;
    for (int k = 0; k < D; ++k) sweep.add(box.axes.col(k) * box.half_size[k]);
  }
  return sweep;
}

/// Squared distance [m²] between a box and the zonotope of a sweep, by coordinate descent over the places on
/// the segments that add up to its nearest point: the distance to a box is convex and smooth, so the descent
/// ends at the least. The gap between the two along the direction of the distance bounds it from below.
template <int D>
class SweepDistance {
 public:
  SweepDistance(const Sweep<D>& sweep, const Box<D>& box)
      : sweep_(sweep),
        center_(sweep.center - 0.5 * (box.lower + box.upper)),
        half_(0.5 * (box.upper - box.lower)),
        point_(center_) {}

  /// Moves on by one round. @returns whether the bounds are still apart, and another round may help.
  bool refine() {
    const auto before = at_;
    for (int k = 0; k < sweep_.count; ++k) {
      std::array<double, kSegments> along{};
      along[static_cast<std::size_t>(k)] = 1.0;
      slide(along);
    }
    if (sweep_.count > 1 && rounds_ > 0) {  // And along what all of these have done together (Powell, 1964).
      std::array<double, kSegments> along;
      for (std::size_t k = 0; k < kSegments; ++k) along[k] = at_[k] - before[k];
      slide(along);
    }
    const Vector<D> away = point_ - nearest();
    most_ = away.squaredNorm();
    double gap = away.dot(center_ - nearest());
    for (int k = 0; k < sweep_.count; ++k)
      gap -= std::abs(away.dot(sweep_.ends[static_cast<std::size_t>(k)]));
    if (gap > 0.0) least_ = std::max(least_, gap * gap / most_);
    return sweep_.count > 1 && ++rounds_ < kMostRounds && least_ < most_ * (1.0 - 1e-12);
  }
  /// Bounds of the squared distance.
  [[nodiscard]] double least() const { return least_; }
  [[nodiscard]] double most() const { return most_; }
  /// The shortest way from the zonotope to the box.
  [[nodiscard]] Vector<D> way() const { return nearest() - point_; }

 private:
  static constexpr auto kSegments = std::size_t{D} + 1;
  static constexpr int kMostRounds = 64;

  [[nodiscard]] Vector<D> nearest() const { return point_.cwiseMax(-half_).cwiseMin(half_); }
  /// Moves along a direction, given by steps on all segments, to where the distance to the box is least: half
  /// its slope is linear between the planes of the box.
  void slide(const std::array<double, kSegments>& along) {
    Vector<D> way = Vector<D>::Zero();
    double low = -std::numeric_limits<double>::infinity();
    double high = -low;
    for (int k = 0; k < sweep_.count; ++k) {
      const auto i = static_cast<std::size_t>(k);
      if (along[i] == 0.0) continue;
      way += along[i] * sweep_.ends[i];
      const double one = (1.0 - at_[i]) / along[i];
      const double other = (-1.0 - at_[i]) / along[i];
      low = std::max(low, std::min(one, other));
      high = std::min(high, std::max(one, other));
    }
    if (!(low < high) || !std::isfinite(low) || !std::isfinite(high)) return;
    const double t = least_on(way, low, high);
    for (std::size_t i = 0; i < kSegments; ++i) at_[i] = std::clamp(at_[i] + t * along[i], -1.0, 1.0);
    point_ = center_;
    for (int k = 0; k < sweep_.count; ++k)
      point_ += at_[static_cast<std::size_t>(k)] * sweep_.ends[static_cast<std::size_t>(k)];
  }
  [[nodiscard]] double least_on(const Vector<D>& way, double low, double high) const {
    const auto slope = [&](double t) {
      double sum = 0.0;
      for (int a = 0; a < D; ++a) {
        const double x = point_[a] + t * way[a];
        sum += way[a] * (x - std::clamp(x, -half_[a], half_[a]));
      }
      return sum;
    };
    if (slope(low) >= 0.0) return low;
    if (slope(high) <= 0.0) return high;
    for (int a = 0; a < D; ++a)
      for (const double plane : {-half_[a], half_[a]}) {
        if (way[a] == 0.0) continue;
        const double t = (plane - point_[a]) / way[a];
        if (!(t > low) || !(t < high)) continue;
        (slope(t) < 0.0 ? low : high) = t;
      }
    const double falls = slope(low);
    const double rises = slope(high);
    return rises > falls ? low + (high - low) * falls / (falls - rises) : low;
  }

  const Sweep<D>& sweep_;
  Vector<D> center_;  // As points below from the box's centre, so that little is rounded far from 0.
  Vector<D> half_;
  Vector<D> point_;
  std::array<double, kSegments> at_{};
  int rounds_ = 0;
  double least_ = 0.0;
  double most_ = std::numeric_limits<double>::infinity();
};

/// Whether the sweep comes within a radius of a closed box; where rounding leaves it open, it does.
template <int D>
[[nodiscard]] bool comes_within(const Sweep<D>& sweep, double radius, const Box<D>& box) {
  SweepDistance<D> distance(sweep, box);
  bool goes_on = true;
  while (goes_on) {
    goes_on = distance.refine();
    if (distance.most() <= radius * radius) return true;
    if (distance.least() > radius * radius) return false;
  }
  return distance.least() <= radius * radius;
}

template <int D>
[[nodiscard]] bool touch(const Sweep<D>& sweep, const Box<D>& box) {
  return comes_within(sweep, sweep.radius, box);
}

/// What CollisionSearch asks of a shape.
template <int D>
class NearnessToSweep {
 public:
  explicit NearnessToSweep(const Sweep<D>& sweep) : sweep_(sweep) {}
  [[nodiscard]] Nearness operator()(const Vector<D>& centre, double half, double, double rounding) const {
    const Box<D> cube{(centre.array() - half).matrix(), (centre.array() + half).matrix()};
    return comes_within(sweep_, sweep_.radius + rounding, cube) ? Nearness::touching : Nearness::apart;
  }

 private:
  Sweep<D> sweep_;
};
template <int D>
[[nodiscard]] NearnessToSweep<D> nearness_to(const Sweep<D>& sweep) {
  return NearnessToSweep<D>(sweep);
}
template <int D>
[[nodiscard]] RoundedBox<D> rounded_box_around(const Sweep<D>& sweep) {
  const Vector<D> half = sweep.half_size();
  return {{sweep.center - half, sweep.center + half}, sweep.radius};
}

/// Calls `enter(box, is_leaf)` for the nodes of a tree that may hold an obstacle and come nearer than
/// `squared_reach()` [m²] to a box, nearest first: whether to go on to what is below.
template <class Tree, class SquaredReach, class Enter>
class ObstacleWalk {
  static constexpr int D = Tree::kDim;
  static constexpr int N = Tree::kBranching;
  using Ref = typename Tree::ConstRef;

 public:
  ObstacleWalk(const Tree& tree, const Box<D>& around, const RegionStates& obstacles,
               const SquaredReach& squared_reach, const Enter& enter)
      : tree_(tree),
        around_(around),
        centre_(0.5 * (around.lower + around.upper)),
        obstacles_(obstacles),
        squared_reach_(squared_reach),
        enter_(enter) {}

  void run() {
    const Ref root = tree_.root();
    const Box<D> box = tree_.box(root.index);
    if (!may_contain(obstacles_, *root.node) || !(around_.squared_distance(box) < squared_reach_())) return;
    if (enter_(box, root.is_leaf())) below(root);
  }

 private:
  /// @pre `parent` is no leaf.
  void below(const Ref& parent) {
    const auto& geometry = tree_.geometry();
    const std::int64_t edge = geometry.edge(parent.index.level - 1);
    std::array<std::array<double, std::size_t{N} + 1>, std::size_t{D}> border;
    std::array<std::array<double, std::size_t{N}>, std::size_t{D}> squared;  // Distances along each axis.
    Offset<D> nearest{};
    for (std::size_t a = 0; a < D; ++a) {
      const auto b = static_cast<int>(a);
      for (std::size_t k = 0; k <= N; ++k)
        border[a][k] = geometry.border(parent.index.lower[a] + static_cast<std::int64_t>(k) * edge);
      for (std::size_t k = 0; k < N; ++k) {
        const double gap =
            std::max({0.0, around_.lower[b] - border[a][k + 1], border[a][k] - around_.upper[b]});
        squared[a][k] = gap * gap;
        nearest[a] += border[a][k + 1] < centre_[b];
      }
      nearest[a] = std::min(nearest[a], N - 1);
    }
    const auto* const children = tree_.children(*parent.node);
    const int first = child_number<N, D>(nearest);
    for (int i = 0; i < Tree::kNumChildren; ++i) {
      const int j = child_from<N, D>(first, i);
      if (!may_contain(obstacles_, children[j])) continue;
      const auto offset = child_offset<N, D>(j);
      Box<D> box;
      double sum = 0.0;
      for (std::size_t a = 0; a < D; ++a) {
        const auto k = static_cast<std::size_t>(offset[a]);
        sum += squared[a][k];
        box.lower[static_cast<int>(a)] = border[a][k];
        box.upper[static_cast<int>(a)] = border[a][k + 1];
      }
      if (!(sum < squared_reach_())) continue;
      const Ref child = tree_.child(parent, j);
      if (enter_(box, child.is_leaf())) below(child);
    }
  }

  const Tree& tree_;
  Box<D> around_;
  Vector<D> centre_;
  RegionStates obstacles_;
  const SquaredReach& squared_reach_;
  const Enter& enter_;
};

/// The distance [m] from a sweep to the border of a tree, beyond which all is unknown; 0 if it reaches there.
template <class Tree>
[[nodiscard]] double room_inside(const Tree& tree, const Sweep<Tree::kDim>& sweep) {
  const Box<Tree::kDim> box = rounded_box_around(sweep).core;
  const Box<Tree::kDim> root = tree.box(tree.root().index);
  const double inside = std::min((box.lower - root.lower).minCoeff(), (root.upper - box.upper).minCoeff());
  return std::max(0.0, inside - sweep.radius);
}

/// The distance [m] from a sweep to a box, at most `most`.
template <int D>
[[nodiscard]] double nearer_of(double most, const Sweep<D>& sweep, const Box<D>& box) {
  const double reach = most + sweep.radius;
  SweepDistance<D> distance(sweep, box);
  while (distance.refine() && distance.least() < reach * reach) {
  }
  if (distance.least() >= reach * reach) return most;
  return std::min(most, std::max(0.0, std::sqrt(distance.least()) - sweep.radius));
}

/// The least distance [m] from a sweep to an obstacle of a tree, at most `most`.
template <class Tree>
[[nodiscard]] double clearance_of(const Tree& tree, const Sweep<Tree::kDim>& sweep,
                                  const RegionStates& obstacles, double most) {
  constexpr int D = Tree::kDim;
  const Box<D> around = rounded_box_around(sweep).core;
  if (obstacles.unknown) most = std::min(most, room_inside(tree, sweep));
  const auto squared_reach = [&] { return (most + sweep.radius) * (most + sweep.radius); };
  const auto enter = [&](const Box<D>& box, bool is_leaf) {
    const double nearer = nearer_of(most, sweep, box);
    if (is_leaf) most = nearer;
    return !is_leaf && nearer < most;
  };
  ObstacleWalk(tree, around, obstacles, squared_reach, enter).run();
  return most;
}

}  // namespace detail

/// Whether a body that keeps its orientation meets an obstacle on its way along a segment, both ends counted
/// in: of the whole volume that it sweeps, not of poses on the way.
template <class Map>
[[nodiscard]] bool sweep_collides(const Map& map, const Body<Map::kDim>& body, const Vector<Map::kDim>& from,
                                  const Vector<Map::kDim>& to, UnknownSpace unknown = UnknownSpace::free) {
  constexpr int D = Map::kDim;
  const RegionStates obstacles = obstacles_of(map, unknown);
  for (const BodyPart<D>& part : body) {
    const auto* const capsule = std::get_if<Capsule<D>>(&part);
    if (capsule != nullptr && capsule->a == capsule->b) {  // A ball sweeps a capsule.
      if (collides(map, BodyPart<D>(Capsule<D>{from + capsule->a, to + capsule->a, capsule->radius}),
                   unknown))
        return true;
      continue;
    }
    const detail::Sweep<D> sweep = detail::sweep_of<D>(part, from, to);
    const auto around = detail::rounded_box_around(sweep);
    if (obstacles.unknown && !detail::contains(map.tree(), around.core.inflated(around.radius))) return true;
    if (detail::CollisionSearch(map.tree(), sweep, obstacles).any()) return true;
  }
  return false;
}

/// How near a body comes to an obstacle on such a way [m]; 0 if it meets one. @param most that matters.
template <class Map>
[[nodiscard]] double sweep_clearance(const Map& map, const Body<Map::kDim>& body,
                                     const Vector<Map::kDim>& from, const Vector<Map::kDim>& to,
                                     UnknownSpace unknown, double most) {
  constexpr int D = Map::kDim;
  const RegionStates obstacles = obstacles_of(map, unknown);
  for (const BodyPart<D>& part : body) {
    const detail::Sweep<D> sweep = detail::sweep_of<D>(part, from, to);
    most = detail::clearance_of(map.tree(), sweep, obstacles, most);
  }
  return most;
}

/// A body that is larger by a distance on all sides: a box becomes a larger box, whose corners reach farther.
template <int D>
[[nodiscard]] Body<D> inflated(const Body<D>& body, double by) {
  Body<D> result = body;
  for (BodyPart<D>& part : result) {
    if (auto* const capsule = std::get_if<Capsule<D>>(&part))
      capsule->radius += by;
    else
      std::get<OrientedBox<D>>(part).half_size.array() += by;
  }
  return result;
}

}  // namespace ndtree
