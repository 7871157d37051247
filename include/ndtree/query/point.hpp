// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// What a map knows at a point.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>

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

/// Calls `visit(i, cell)` with the cell that contains each of many points, in their order; an unobserved one
/// where there is none. Some points go down the tree side by side, so that the memory of one is fetched while
/// the others are looked at: several times faster than one by one where the map is larger than the caches.
/// @param points D numbers each, contiguous [m].
template <class Map, class Visit>
void for_each_cell_at(const Map& map, const double* points, std::size_t n, Visit&& visit) {
  constexpr std::size_t kSideBySide = 16;
  constexpr int N = Map::kBranching;
  constexpr int D = Map::kDim;
  using NodeType = typename Map::Tree::NodeType;
  const auto& tree = map.tree();
  const auto& geometry = tree.geometry();
  const typename Map::Tree::ConstRef root = tree.root();
  const typename Map::Cell unobserved{};
  std::array<const NodeType*, kSideBySide> nodes;
  std::array<Lattice<D>, kSideBySide> offsets;  // From the node's lower corner.
  std::array<std::size_t, kSideBySide> going;   // Those of which the leaf is not found yet.
  for (std::size_t first = 0; first < n; first += kSideBySide) {
    const std::size_t count = std::min(kSideBySide, n - first);
    std::size_t num_going = 0;
    for (std::size_t i = 0; i < count; ++i) {
      const Vector<D> point = Eigen::Map<const Vector<D>>(points + (first + i) * D);
      nodes[i] = nullptr;
      if (!geometry.in_reach(point)) continue;
      offsets[i] = geometry.coordinates(point);
      if (!geometry.contains(root.index, offsets[i])) continue;
      for (std::size_t a = 0; a < D; ++a) offsets[i][a] -= root.index.lower[a];
      nodes[i] = root.node;
      if (!root.is_leaf()) going[num_going++] = i;
    }
    for (int level = root.index.level - 1; num_going > 0; --level) {
      const std::int64_t edge = geometry.edge(level);
      std::size_t kept = 0;
      for (std::size_t g = 0; g < num_going; ++g) {
        const std::size_t i = going[g];
        int number = 0;
        for (std::size_t a = D; a-- > 0;) {
          const std::int64_t k = Map::Tree::child_place(offsets[i][a], edge);
          offsets[i][a] -= k * edge;
          number = number * N + static_cast<int>(k);
        }
        nodes[i] = tree.children(*nodes[i]) + number;
        going[kept] = i;
        kept += !nodes[i]->is_leaf();
      }
      num_going = kept;
    }
    for (std::size_t i = 0; i < count; ++i)
      visit(first + i, nodes[i] == nullptr ? unobserved : nodes[i]->cell());
  }
}

}  // namespace ndtree
