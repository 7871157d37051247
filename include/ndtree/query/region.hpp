// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// What is in a box: which states there are, and how probable an obstacle is.
#pragma once

#include <algorithm>
#include <limits>

#include "ndtree/cell/occupancy_cell.hpp"
#include "ndtree/cell/summary.hpp"
#include "ndtree/cell/thin_things.hpp"
#include "ndtree/core/log_odds.hpp"
#include "ndtree/core/types.hpp"

namespace ndtree {

/// The states that a region contains; space outside the map is unknown.
struct RegionStates {
  bool occupied = false;
  bool free = false;
  bool unknown = false;
  ThinThings
      thin{};  ///< Cells that are looked for as if they were occupied, though free; states_in() sets none.
};

namespace detail {

/// Visits the nodes that share a point with the closed box, parents first, but for the children of those for
/// which `visit(ref, is_inside)` returns false. @param is_inside whether the node's box lies in the region.
template <class Tree, int D, class Visit>
void for_each_node_touching(const Tree& tree, const typename Tree::ConstRef& ref, const Box<D>& region,
                            Visit&& visit) {
  const Box<D> box = tree.box(ref.index);
  if (!region.touches(box)) return;
  if (!visit(ref, region.encloses(box)) || ref.is_leaf()) return;
  for (int j = 0; j < Tree::kNumChildren; ++j)
    for_each_node_touching(tree, tree.child(ref, j), region, visit);
}

template <class Tree, int D>
bool contains(const Tree& tree, const Box<D>& region) {
  return tree.box(tree.root().index).encloses(region);
}

}  // namespace detail

/// Which states the cells have that share a point with the closed box. Nodes that lie in it as a whole
/// are not entered, nor nodes whose summary adds nothing. Corners as LatticeGeometry::on_borders() takes
/// them.
/// @pre lower <= upper.
template <class Map>
[[nodiscard]] RegionStates states_in(const Map& map, const Box<Map::kDim>& box) {
  const Box<Map::kDim> region = map.tree().geometry().on_borders(box);
  RegionStates states;
  states.unknown = !detail::contains(map.tree(), region);
  detail::for_each_node_touching(map.tree(), map.tree().root(), region, [&](const auto& ref, bool is_inside) {
    const Summary summary = Summary::of(*ref.node);
    const bool occupied = summary.may_contain(CellState::occupied) && !states.occupied;
    const bool free = summary.may_contain(CellState::free) && !states.free;
    const bool unknown = summary.may_contain(CellState::unknown) && !states.unknown;
    if (ref.is_leaf() || (is_inside && summary.is_valid())) {
      states.occupied = states.occupied || occupied;
      states.free = states.free || free;
      states.unknown = states.unknown || unknown;
      return false;
    }
    return occupied || free || unknown;
  });
  return states;
}

/// The largest probability of a cell that shares a point with the closed box; 0.5 counts for space outside
/// the map. Nodes without a larger one than was found are not entered. @pre lower <= upper.
template <class Map>
[[nodiscard]] double max_probability(const Map& map, const Box<Map::kDim>& box) {
  const Box<Map::kDim> region = map.tree().geometry().on_borders(box);
  float most = detail::contains(map.tree(), region) ? -std::numeric_limits<float>::infinity() : 0.0f;
  detail::for_each_node_touching(map.tree(), map.tree().root(), region, [&](const auto& ref, bool) {
    if (ref.is_leaf()) {
      most = std::max(most, ref.cell().log_odds());
      return false;
    }
    const Summary summary = Summary::of(*ref.node);
    return !summary.is_valid() || summary.max_log_odds() > most;
  });
  return probability(static_cast<double>(most));
}

}  // namespace ndtree
