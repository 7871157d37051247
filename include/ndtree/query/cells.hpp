// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The cells of a map by place and state, as boxes.
#pragma once

#include <algorithm>
#include <optional>
#include <vector>

#include "ndtree/cell/occupancy_cell.hpp"
#include "ndtree/cell/summary.hpp"
#include "ndtree/cell/thin_things.hpp"
#include "ndtree/core/cancel.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/query/region.hpp"

namespace ndtree {

/// What unknown space, outside the map too, is taken for.
enum class UnknownSpace { free, occupied };

[[nodiscard]] inline bool contains(const RegionStates& states, CellState state) {
  return state == CellState::occupied ? states.occupied
         : state == CellState::free   ? states.free
                                      : states.unknown;
}

/// Whether a node is a leaf of one of these states, or has, or might have, one.
template <class NodeType>
[[nodiscard]] bool may_contain(const RegionStates& states, const NodeType& node) {
  if (node.is_leaf()) return contains(states, states.thin.state_in_column(node.cell()));
  const Summary summary(node.summary_word());
  return (states.occupied &&
          (summary.may_contain(CellState::occupied) || states.thin.may_be_below(summary))) ||
         (states.free && summary.may_contain(CellState::free)) ||
         (states.unknown && summary.may_contain(CellState::unknown));
}

/// Obstacles to a body: occupied cells, cells that hold something thin, and unknown space if it is taken for
/// occupied.
template <class Map>
[[nodiscard]] RegionStates obstacles_of(const Map& map, UnknownSpace unknown) {
  return {true, false, unknown == UnknownSpace::occupied, ThinThings(map)};
}

/// Calls `visit(leaf)` for each leaf of one of these states that shares a point with the closed box, depth
/// first; corners as LatticeGeometry::on_borders() takes them. Nodes without any are not entered.
template <class Map, class Visit>
void for_each_leaf_of(const Map& map, const Box<Map::kDim>& box, const RegionStates& states,
                      const Visit& visit) {
  const Box<Map::kDim> region = map.tree().geometry().on_borders(box);
  Pace pace;
  detail::for_each_node_touching(map.tree(), map.tree().root(), region, [&](const auto& ref, bool) {
    pace.spend();
    const bool is_wanted = may_contain(states, *ref.node);
    if (is_wanted && ref.is_leaf()) visit(ref);
    return is_wanted;
  });
}

/// A box around all cells that were observed, as small as it may be; none if there is no such cell. O(nodes).
template <class Map>
[[nodiscard]] std::optional<Box<Map::kDim>> bounds(const Map& map) {
  std::optional<Box<Map::kDim>> result;
  Pace pace;
  const auto descend = [&](const auto& self, const auto& ref) -> void {
    pace.spend();
    const Box<Map::kDim> box = map.tree().box(ref.index);
    if (result && result->encloses(box)) return;  // It can add nothing.
    if (!ref.is_leaf()) {
      for (int j = 0; j < Map::Tree::kNumChildren; ++j) self(self, map.tree().child(ref, j));
    } else if (ref.cell().observed()) {
      if (!result) result = box;
      result->lower = result->lower.cwiseMin(box.lower);
      result->upper = result->upper.cwiseMax(box.upper);
    }
  };
  descend(descend, map.tree().root());
  return result;
}

/// Of a region, the parts that lie outside a box, as boxes that do not overlap.
template <int D>
[[nodiscard]] std::vector<Box<D>> outside_of(const Box<D>& box, Box<D> region) {
  std::vector<Box<D>> parts;
  for (int a = 0; a < D; ++a) {
    if (region.lower[a] < box.lower[a]) {
      parts.push_back(region);
      parts.back().upper[a] = std::min(region.upper[a], box.lower[a]);
    }
    if (region.upper[a] > box.upper[a]) {
      parts.push_back(region);
      parts.back().lower[a] = std::max(region.lower[a], box.upper[a]);
    }
    region.lower[a] = std::max(region.lower[a], box.lower[a]);
    region.upper[a] = std::min(region.upper[a], box.upper[a]);
    if (!(region.lower[a] < region.upper[a])) break;  // Nothing is left inside.
  }
  return parts;
}

/// The space in a region that has one of these states, as boxes: leaves, as they are, and parts of the space
/// outside the map, which is unknown.
template <class Map>
[[nodiscard]] std::vector<Box<Map::kDim>> boxes_of(const Map& map, const Box<Map::kDim>& box,
                                                   const RegionStates& states) {
  const Box<Map::kDim> region = map.tree().geometry().on_borders(box);
  std::vector<Box<Map::kDim>> boxes;
  for_each_leaf_of(map, region, states,
                   [&](const auto& leaf) { boxes.push_back(map.tree().box(leaf.index)); });
  if (states.unknown) {
    const auto outside = outside_of(map.tree().box(map.tree().root().index), region);
    boxes.insert(boxes.end(), outside.begin(), outside.end());
  }
  return boxes;
}

}  // namespace ndtree
