// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Occupied space near a point, and how near.
#pragma once

#include <cmath>
#include <limits>
#include <optional>
#include <queue>
#include <utility>
#include <vector>

#include "ndtree/cell/occupancy_cell.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/query/region.hpp"

namespace ndtree {

/// Whether some occupied cell is at most `radius` >= 0 [m] away from the point, its border counted in.
template <class Map>
[[nodiscard]] bool occupied_within(const Map& map, const Vector<Map::kDim>& point, double radius) {
  const Box<Map::kDim> around{(point.array() - radius).matrix(), (point.array() + radius).matrix()};
  bool found = false;
  detail::for_each_node_touching(map.tree(), map.tree().root(), around, [&](const auto& ref, bool) {
    if (found || !Summary::of(*ref.node).may_contain(CellState::occupied) ||
        map.tree().box(ref.index).squared_distance(point) > radius * radius)
      return false;
    found = ref.is_leaf();
    return !found;
  });
  return found;
}

/// A place in occupied space, border included.
template <int D>
struct NearestOccupied {
  double distance;  ///< [m]
  Vector<D> point;
};

/// The point of occupied space that is nearest to a point: itself, if it lies in there; none if nothing is at
/// most max_distance [m] away, or the point is not a number. Infinitely far, as are points whose squared
/// distance overflows, everything is at the distance inf. Nodes are taken in the order of their distance.
template <class Map>
[[nodiscard]] std::optional<NearestOccupied<Map::kDim>> nearest_occupied(
    const Map& map, const Vector<Map::kDim>& point,
    double max_distance = std::numeric_limits<double>::infinity()) {
  using Ref = typename Map::Tree::ConstRef;
  using Candidate = std::pair<double, Ref>;
  if (point.hasNaN()) return std::nullopt;
  const auto farther = [](const Candidate& a, const Candidate& b) { return a.first > b.first; };
  std::priority_queue<Candidate, std::vector<Candidate>, decltype(farther)> next(farther);
  const auto consider = [&](const Ref& ref) {
    if (!Summary::of(*ref.node).may_contain(CellState::occupied)) return;
    const double squared = map.tree().box(ref.index).squared_distance(point);
    if (squared <= max_distance * max_distance) next.emplace(squared, ref);
  };
  consider(map.tree().root());
  while (!next.empty()) {
    const auto [squared, ref] = next.top();
    next.pop();
    if (ref.is_leaf()) {
      const Box<Map::kDim> box = map.tree().box(ref.index);
      return NearestOccupied<Map::kDim>{std::sqrt(squared), point.cwiseMax(box.lower).cwiseMin(box.upper)};
    }
    for (int j = 0; j < Map::Tree::kNumChildren; ++j) consider(map.tree().child(ref, j));
  }
  return std::nullopt;
}

/// Distance from the point to the nearest occupied cell, 0 inside one [m]; none if the map has no such cell
/// or the point is not finite.
template <class Map>
[[nodiscard]] std::optional<double> distance_to_occupied(const Map& map, const Vector<Map::kDim>& point) {
  const auto nearest = nearest_occupied(map, point);
  return nearest ? std::optional<double>(nearest->distance) : std::nullopt;
}

}  // namespace ndtree
