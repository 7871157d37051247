// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Occupied space near a point.
#pragma once

#include "ndtree/cell/occupancy_cell.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/tree/visit.hpp"

namespace ndtree {

/// Whether some occupied cell is at most `radius` >= 0 [m] away from the point, its border counted in.
template <class Map>
[[nodiscard]] bool occupied_within(const Map& map, const Vector<Map::kDim>& point, double radius) {
  const Box<Map::kDim> around{(point.array() - radius).matrix(), (point.array() + radius).matrix()};
  return !for_each_leaf_in(map.tree(), around, [&](const auto& leaf) -> bool {
    return leaf.cell().state() != CellState::occupied ||
           map.tree().box(leaf.index).squared_distance(point) > radius * radius;
  });
}

}  // namespace ndtree
