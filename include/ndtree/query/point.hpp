// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// What a map knows at a point.
#pragma once

#include "ndtree/cell/occupancy_cell.hpp"
#include "ndtree/core/types.hpp"

namespace ndtree {

/// The cell that contains a point; an unobserved one outside the map. O(depth).
template <class Map>
[[nodiscard]] typename Map::Cell cell_at(const Map& map, const Vector<Map::kDim>& point) {
  const auto leaf = map.tree().find_leaf(point);
  return leaf ? leaf->cell() : typename Map::Cell{};
}

/// Unknown, free or occupied; unknown outside the map and for points that are not finite.
template <class Map>
[[nodiscard]] CellState state(const Map& map, const Vector<Map::kDim>& point) {
  return cell_at(map, point).state();
}

/// Probability of being occupied; 0.5 where unknown.
template <class Map>
[[nodiscard]] double probability(const Map& map, const Vector<Map::kDim>& point) {
  return cell_at(map, point).probability();
}

}  // namespace ndtree
