// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Free places around a pose of a body, and what is in its way there.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <queue>
#include <string>
#include <utility>
#include <vector>

#include "ndtree/core/body.hpp"
#include "ndtree/core/cancel.hpp"
#include "ndtree/core/option.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/planning/place_cell.hpp"
#include "ndtree/planning/place_walk.hpp"
#include "ndtree/planning/sweep.hpp"
#include "ndtree/query/collision.hpp"
#include "ndtree/query/point.hpp"

namespace ndtree::detail {

/// All smallest cells that come within a distance of a point, both in smallest cells.
template <int D>
[[nodiscard]] LatticeBox<D> cells_near(const Vector<D>& at, double reach) {
  LatticeBox<D> box;
  for (std::size_t a = 0; a < D; ++a) {
    box.lower[a] = static_cast<std::int64_t>(std::floor(at[static_cast<int>(a)] - reach)) - 1;
    box.upper[a] = static_cast<std::int64_t>(std::ceil(at[static_cast<int>(a)] + reach)) + 1;
  }
  return box;
}

/// Where a search may begin or end: at a pose, in smallest cells, or, if its cell is not free as a whole, at
/// the nearest places in cells that are. @param goes_to whether the body can go straight to such a place.
template <class Space, class GoesTo>
[[nodiscard]] std::vector<Anchor<Space::D>> anchors_at(Space& space, const Vector<Space::D>& at,
                                                       const GoesTo& goes_to) {
  constexpr int D = Space::D;
  constexpr std::size_t kMost = 16;
  constexpr double kFarthest = 16.0;
  const PlaceCell<D> own = space.cell_at(cell_ahead<D>(at, Vector<D>::Zero()));
  if (own.passage != Passage::blocked) return {{at, own, 0.0}};
  std::vector<Anchor<D>> found;
  for (double reach = 2.0; reach <= kFarthest && found.empty(); reach *= 2.0) {
    std::vector<Anchor<D>> candidates;
    space.for_each_in(cells_near<D>(at, reach), [&](const PlaceCell<D>& cell) {
      const Vector<D> place = nearest_in(common_box(cell, cell), at);
      candidates.push_back({place, cell, (place - at).norm()});
    });
    std::sort(candidates.begin(), candidates.end(), [](const Anchor<D>& a, const Anchor<D>& b) {
      return a.way != b.way ? a.way < b.way : a.cell.number < b.cell.number;
    });
    for (const Anchor<D>& anchor : candidates) {
      if (found.size() == kMost) break;
      if (goes_to(anchor.point)) found.push_back(anchor);
    }
  }
  return found;
}

/// Of the obstacles that a part of a body meets, that nearest to the middle of its bounds.
template <class Tree>
[[nodiscard]] std::optional<Box<Tree::kDim>> nearest_met(const Tree& tree, const BodyPart<Tree::kDim>& part,
                                                         const RegionStates& obstacles) {
  constexpr int D = Tree::kDim;
  const Box<D> bounds = bounds_of(part);
  const Vector<D> centre = 0.5 * (bounds.lower + bounds.upper);
  double least = std::numeric_limits<double>::infinity();
  std::optional<Box<D>> found;
  const auto squared_reach = [&] { return least; };
  const auto enter = [&](const Box<D>& box, bool is_leaf) {
    if (!touch(part, box)) return false;
    if (!is_leaf) return true;
    least = box.squared_distance(centre);
    found = box;
    return false;
  };
  ObstacleWalk(tree, Box<D>{centre, centre}, obstacles, squared_reach, enter).run();
  return found;
}
/// Whether a body meets one obstacle from all places in a cube, as far as one tells: the places from which a
/// part meets a box are convex, so those at the cube's corners are asked. @param half of the cube's edge [m].
template <class Map>
[[nodiscard]] bool meets_one_from_all(const Map& map, const Body<Map::kDim>& body,
                                      const Vector<Map::kDim>& middle, double half, UnknownSpace unknown) {
  constexpr int D = Map::kDim;
  const RegionStates obstacles = obstacles_of(map, unknown);
  const Box<D> root = map.tree().box(map.tree().root().index);
  Pose<D> pose;
  pose.translation = middle;
  for (const BodyPart<D>& part : moved(body, pose)) {
    const Box<D> bounds = bounds_of(part);
    if (obstacles.unknown && ((bounds.lower.array() + half < root.lower.array()).any() ||
                              (bounds.upper.array() - half > root.upper.array()).any()))
      return true;
    const std::optional<Box<D>> met = nearest_met(map.tree(), part, obstacles);
    bool meets = met.has_value();
    for (unsigned corner = 0; corner < 1u << D && meets; ++corner) {
      Vector<D> away;
      for (int a = 0; a < D; ++a) away[a] = (corner >> a & 1u) != 0 ? half : -half;
      meets = touch(part, Box<D>{met->lower + away, met->upper + away});
    }
    if (meets) return true;
  }
  return false;
}

/// The place nearest to a point where a body is free, by the exact test; none if none was found. The space's
/// cubes are looked at from the nearest on, by branch and bound: one that is not blocked as a whole, and is
/// free neither at its nearest point nor in its middle, is divided. What is narrower than the smallest ones,
/// kFinest, may be missed; but for that, no place is nearer by more than kFinest. Points are in smallest
/// cells.
/// @param space that takes no free place for blocked. @param is_blocked whether the body is free nowhere in
/// the cube with a centre and half an edge, as far as it tells. @throws Cancelled
template <class Space, class IsFree, class IsBlocked>
[[nodiscard]] std::optional<Vector<Space::D>> nearest_free(const Space& space, const Vector<Space::D>& at,
                                                           const IsFree& is_free,
                                                           const IsBlocked& is_blocked) {
  constexpr int D = Space::D;
  constexpr double kFinest = 1.0 / 32.0;
  struct Cube {
    double distance;
    Vector<D> lower;
    double edge;
    bool operator<(const Cube& other) const {  // The top of a queue is the greatest.
      if (distance != other.distance) return distance > other.distance;
      if (edge != other.edge) return edge > other.edge;
      return std::lexicographical_compare(other.lower.begin(), other.lower.end(), lower.begin(), lower.end());
    }
  };
  const auto nearest_in_cube = [&](const Vector<D>& lower, double edge) {
    return nearest_in(Box<D>{lower, (lower.array() + edge).matrix()}, at);
  };
  std::priority_queue<Cube> open;
  const auto add = [&](const Vector<D>& lower, double edge) {
    open.push({(nearest_in_cube(lower, edge) - at).norm(), lower, edge});
  };
  Vector<D> first;
  for (int a = 0; a < D; ++a) first[a] = static_cast<double>(space.root().lower[static_cast<std::size_t>(a)]);
  add(first, std::ldexp(1.0, space.root().level));
  double least = std::numeric_limits<double>::infinity();
  std::optional<Vector<D>> found;
  Pace pace;
  for (; !open.empty() && open.top().distance < least - kFinest / 2.0;) {
    pace.spend(30);
    const Cube cube = open.top();
    open.pop();
    const double half = 0.5 * cube.edge;
    const Vector<D> middle = (cube.lower.array() + half).matrix();
    if (cube.edge >= 1.0 &&
        space.is_blocked({cell_ahead<D>(cube.lower, Vector<D>::Zero()), std::ilogb(cube.edge)}))
      continue;
    for (const Vector<D>& place : {nearest_in_cube(cube.lower, cube.edge), middle}) {
      const double distance = (place - at).norm();
      if (!(distance < least) || !is_free(place)) continue;
      least = distance;
      found = place;
    }
    if (cube.edge <= kFinest || is_blocked(middle, half)) continue;
    for (unsigned j = 0; j < 1u << D; ++j) {
      Vector<D> lower = cube.lower;
      for (int a = 0; a < D; ++a)
        if ((j >> a & 1u) != 0) lower[a] += half;
      add(lower, half);
    }
  }
  return found;
}

/// The nearest cell that a body meets at a point. @pre it meets one, or unknown space outside the map.
template <class Map>
[[nodiscard]] std::string obstacle_in_words(const Map& map, const Body<Map::kDim>& body,
                                            const Vector<Map::kDim>& point, UnknownSpace unknown) {
  constexpr int D = Map::kDim;
  Pose<D> pose;
  pose.translation = point;
  const RegionStates obstacles = obstacles_of(map, unknown);
  std::optional<Box<D>> found;
  for (const BodyPart<D>& part : moved(body, pose)) {
    const std::optional<Box<D>> met = nearest_met(map.tree(), part, obstacles);
    if (met && (!found || met->squared_distance(point) < found->squared_distance(point))) found = met;
  }
  if (!found) return "unknown space outside the map";
  const CellState met = state(map, Vector<D>(0.5 * (found->lower + found->upper)));
  const std::string kind = met == CellState::occupied  ? "occupied cell"
                           : met == CellState::unknown ? "unknown cell"
                                                       : "cell with something thin in it";
  return "the " + kind + " from " + describe_point(found->lower) + " to " + describe_point(found->upper);
}

}  // namespace ndtree::detail
