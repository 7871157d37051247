// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Occupied space near a point.
#pragma once

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

}  // namespace ndtree
