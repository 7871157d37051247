// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// State and probability at a point.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <utility>
#include <vector>

#include "ndtree/cell/hit_rate.hpp"
#include "ndtree/cell/moved_points.hpp"
#include "ndtree/cell/occupancy_cell.hpp"
#include "ndtree/core/cancel.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/tree/lattice.hpp"

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

/// Which fraction of the beams that reach the cell of a point end in it; none where nothing was observed.
/// O(depth).
template <class Map>
[[nodiscard]] std::optional<HitRate> hit_rate(const Map& map, const Vector<Map::kDim>& point) {
  const auto leaf = map.tree().find_leaf(point);
  if (!leaf || !leaf->cell().observed()) return std::nullopt;
  return HitRateModel(map.options())(leaf->cell(), map.edge_in_smallest(leaf->index.level));
}

namespace detail {

/// The nodes some levels below a tree's root, by their place: in the order of their lower corners, the first
/// axis first. A larger leaf stands at all places that it covers.
template <class Tree>
class NodesByPlace {
  static constexpr int N = Tree::kBranching;
  static constexpr int D = Tree::kDim;
  using NodeType = typename Tree::NodeType;

 public:
  /// @param limit of the number of nodes, as far as the tree is so deep.
  NodesByPlace(const Tree& tree, std::size_t limit)
      : level_(tree.root().index.level), nodes_{tree.root().node} {
    constexpr auto kNumChildren = static_cast<std::size_t>(Tree::kNumChildren);
    while (level_ > tree.geometry().finest_level() && nodes_.size() * kNumChildren <= limit) divide(tree);
  }

  [[nodiscard]] int level() const { return level_; }
  [[nodiscard]] std::size_t size_of_axis() const { return size_; }
  [[nodiscard]] const NodeType* operator[](std::size_t place) const { return nodes_[place]; }

 private:
  void divide(const Tree& tree) {
    const std::size_t size = size_ * N;
    std::vector<const NodeType*> nodes;
    nodes.reserve(nodes_.size() * static_cast<std::size_t>(Tree::kNumChildren));
    std::array<std::size_t, std::size_t{D}> at{};
    for (std::size_t axis = 0; axis < D;) {
      std::size_t parent = 0;
      std::size_t child = 0;
      for (std::size_t a = D; a-- > 0;) {
        parent = parent * size_ + at[a] / N;
        child = child * N + at[a] % N;
      }
      const NodeType* const node = nodes_[parent];
      nodes.push_back(node->is_leaf() ? node : tree.children(*node) + child);
      for (axis = 0; axis < D && ++at[axis] == size; ++axis) at[axis] = 0;
    }
    nodes_ = std::move(nodes);
    size_ = size;
    --level_;
  }

  int level_;
  std::size_t size_ = 1;
  std::vector<const NodeType*> nodes_;
};

}  // namespace detail

/// Calls `visit(i, cell)` with the cell that contains each of many points, in their order; an unobserved one
/// where there is none. Many points begin where a table leads them, far below the root, and some go down the
/// tree side by side, so that the memory of one is fetched while the others are looked at: several times
/// faster than one by one.
/// @param points D numbers each, contiguous [m].
template <class Map, class Visit>
void for_each_cell_at(const Map& map, const double* points, std::size_t n, Visit&& visit) {
  constexpr std::size_t kSideBySide = 16;
  constexpr std::size_t kPointsOfNode = 8;  // As many are worth an entry of the table.
  constexpr int N = Map::kBranching;
  constexpr int D = Map::kDim;
  using NodeType = typename Map::Tree::NodeType;
  const auto& tree = map.tree();
  const auto& geometry = tree.geometry();
  const CellIndex<D> root = tree.root().index;
  const detail::NodesByPlace<typename Map::Tree> table(tree, n / kPointsOfNode);
  const typename Map::Cell unobserved{};
  std::array<const NodeType*, kSideBySide> nodes;
  std::array<Lattice<D>, kSideBySide>
      offsets;                                 // From the root's lower corner, or, if N is not 2, the node's.
  std::array<std::size_t, kSideBySide> going;  // Points whose leaf is not found yet.
  Pace pace;
  for (std::size_t first = 0; first < n; first += kSideBySide) {
    pace.spend(kSideBySide);
    const std::size_t count = std::min(kSideBySide, n - first);
    std::size_t num_going = 0;
    for (std::size_t i = 0; i < count; ++i) {
      const Vector<D> point = Eigen::Map<const Vector<D>>(points + (first + i) * D);
      nodes[i] = nullptr;
      if (!geometry.in_reach(point)) continue;
      offsets[i] = geometry.coordinates(point);
      if (!geometry.contains(root, offsets[i])) continue;
      std::size_t place = 0;
      for (std::size_t a = D; a-- > 0;) {
        offsets[i][a] -= root.lower[a];
        std::int64_t k = 0;
        if constexpr (N == 2) {
          k = offsets[i][a] >> (table.level() - geometry.finest_level());
        } else {
          k = offsets[i][a] / geometry.edge(table.level());
          offsets[i][a] -= k * geometry.edge(table.level());
        }
        place = place * table.size_of_axis() + static_cast<std::size_t>(k);
      }
      nodes[i] = table[place];
      going[num_going] = i;
      num_going += !nodes[i]->is_leaf();
    }
    for (int level = table.level() - 1; num_going > 0; --level) {
      const std::int64_t edge = geometry.edge(level);
      const int bit = level - geometry.finest_level();  // If N is 2: of the offset, that tells the child.
      std::size_t kept = 0;
      for (std::size_t g = 0; g < num_going; ++g) {
        const std::size_t i = going[g];
        int number = 0;
        for (std::size_t a = D; a-- > 0;) {
          if constexpr (N == 2) {
            number = 2 * number + static_cast<int>(offsets[i][a] >> bit & 1);
          } else {
            const std::int64_t k = Map::Tree::child_place(offsets[i][a], edge);
            offsets[i][a] -= k * edge;
            number = number * N + static_cast<int>(k);
          }
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

/// That what returned at points is not part of what stands, by the map's cells: see the function of this name
/// for any source of probabilities. 0.5 where unknown. @param points D numbers each [m].
template <class Map>
void probability_moved(const Map& map, const double* points, std::size_t n, float* out) {
  constexpr int D = Map::kDim;
  const auto standing_at = [&map](const double* some, std::size_t k, float* of) {
    for_each_cell_at(map, some, k,
                     [of](std::size_t i, const auto& cell) { of[i] = probability_standing(cell); });
  };
  const auto beside_at = [&map](const double* some, std::size_t k, float* of) {
    for_each_cell_at(map, some, k,
                     [of](std::size_t i, const auto& cell) { of[i] = probability_beside(cell); });
  };
  probability_moved<D>(points, n, MovedMargin::of(map.options()), standing_at, beside_at, out);
}
template <class Map>
[[nodiscard]] std::vector<float> probability_moved(const Map& map, const Points<Map::kDim>& points) {
  std::vector<float> moved(static_cast<std::size_t>(points.cols()));
  probability_moved(map, points.data(), moved.size(), moved.data());
  return moved;
}

}  // namespace ndtree
