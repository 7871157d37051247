// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// What is different between two maps of one lattice, as between a map and what it was.
#pragma once

#include <cstdint>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <vector>

#include "ndtree/cell/occupancy_cell.hpp"
#include "ndtree/core/cancel.hpp"
#include "ndtree/core/option.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/tree/lattice.hpp"

namespace ndtree {

/// What counts as a change: another state, or anything that a cell holds, its size too.
enum class ChangeOf { states, cells };

/// A region whose state, or cell, is another one.
template <int D>
struct Change {
  CellIndex<D> index;  ///< Of the smaller of the two leaves that it lay in, and lies in.
  CellState before = CellState::unknown;
  CellState after = CellState::unknown;
};

namespace detail {

/// A region of a tree: a node, or space around the root, which is a leaf of no state if the root is not in
/// it.
template <class Tree>
class TreeRegion {
  static constexpr int D = Tree::kDim;

 public:
  /// @param index of a node of the tree, or of one that it would have above its root, or outside.
  TreeRegion(const Tree& tree, const CellIndex<D>& index) : tree_(&tree), index_(index) {
    const auto root = tree.root();
    if (root.index.level < index.level) {
      is_around_root_ = tree.geometry().contains(index, root.index.lower);
    } else if (tree.geometry().contains(root.index, index.lower)) {
      auto at = root;
      while (at.index.level > index.level && !at.is_leaf()) at = tree.child_towards(at, index.lower);
      node_ = at.node;
      is_own_ = at.index.level == index.level;
    }
  }

  [[nodiscard]] const CellIndex<D>& index() const { return index_; }
  [[nodiscard]] bool is_leaf() const { return node_ != nullptr ? node_->is_leaf() : !is_around_root_; }
  /// Whether the tree has this very node, not just a larger leaf there.
  [[nodiscard]] bool is_node_of_its_own() const { return is_own_; }
  /// @pre is_leaf().
  [[nodiscard]] CellState state() const {
    return node_ != nullptr ? node_->cell().state() : CellState::unknown;
  }
  /// Whether the region is a leaf, or part of one, that says what another tree's says, and is as large if it
  /// was observed. @pre both are leaves.
  [[nodiscard]] bool is_same_cell(const TreeRegion& other) const {
    const auto cell = cell_or_none();
    return cell == other.cell_or_none() && (is_own_ == other.is_own_ || !cell.observed());
  }
  /// A part of the region; of a leaf, the leaf.
  [[nodiscard]] TreeRegion child(int number) const {
    TreeRegion part = *this;
    part.index_ = tree_->geometry().child(index_, child_offset<Tree::kBranching, D>(number));
    if (is_leaf()) {
      part.is_own_ = false;
      return part;
    }
    if (node_ == nullptr) return TreeRegion(*tree_, part.index_);
    part.node_ = tree_->children(*node_) + number;
    return part;
  }
  /// Whether nothing can be different from another tree's region. @pre neither is a leaf.
  [[nodiscard]] bool shares_all(const TreeRegion& other) const {
    return node_ != nullptr && other.node_ != nullptr &&
           tree_->shares_children(*node_, *other.tree_, *other.node_);
  }

 private:
  [[nodiscard]] auto cell_or_none() const {
    return node_ != nullptr ? node_->cell() : std::decay_t<decltype(node_->cell())>{};
  }

  const Tree* tree_;
  const typename Tree::NodeType* node_ = nullptr;
  CellIndex<D> index_;
  bool is_around_root_ = false;
  bool is_own_ = false;
};

/// Calls `visit(index)` for each node of level 0, the coarsest cells that are ever observed, in a node.
template <class Tree, class Visit>
void for_each_coarsest(const Tree& tree, const typename Tree::ConstRef& ref, const Visit& visit) {
  if (ref.index.level == 0) {
    visit(ref.index);
  } else if (!ref.is_leaf()) {
    for (int j = 0; j < Tree::kNumChildren; ++j) for_each_coarsest(tree, tree.child(ref, j), visit);
  }
}

/// Whether a cell is a node in a root that could grow around it.
template <int N, int D>
[[nodiscard]] bool is_part(const LatticeGeometry<N, D>& geometry, const CellIndex<D>& part,
                           const CellIndex<D>& whole) {
  if (part.level > whole.level || !geometry.contains(whole, part.lower)) return false;
  for (std::size_t a = 0; a < D; ++a)
    if ((part.lower[a] - whole.lower[a]) % geometry.edge(part.level) != 0) return false;
  return true;
}

/// Calls `visit(a, b)` for pairs of regions, one of each tree, that cover all that was observed of either.
/// There are few if one tree has grown from the other.
template <class Tree, class Visit>
void for_each_pair(const Tree& a, const Tree& b, const Visit& visit) {
  using Region = TreeRegion<Tree>;
  const auto& root_of_a = a.root().index;
  const auto& root_of_b = b.root().index;
  const bool is_in_a = is_part(a.geometry(), root_of_b, root_of_a);
  if (is_in_a || is_part(a.geometry(), root_of_a, root_of_b)) {
    const auto& larger = is_in_a ? root_of_a : root_of_b;
    visit(Region(a, larger), Region(b, larger));
    return;
  }
  for_each_coarsest(a, a.root(), [&](const auto& index) { visit(Region(a, index), Region(b, index)); });
  for_each_coarsest(b, b.root(), [&](const auto& index) {
    const Region of_a(a, index);
    if (!of_a.is_node_of_its_own()) visit(of_a, Region(b, index));
  });
}

/// @throws std::invalid_argument if their smallest cells or numbers of levels differ.
template <class Map>
void check_same_cells(const Map& before, const Map& after) {
  const auto& geometry = after.tree().geometry();
  if (before.tree().geometry().unit() != geometry.unit() ||
      before.tree().geometry().finest_level() != geometry.finest_level())
    throw std::invalid_argument(
        "maps with smallest cells of " + describe_number(before.tree().geometry().unit()) + " and " +
        describe_number(geometry.unit()) + " m, largest of " +
        describe_number(before.tree().geometry().cell_size(0)) + " and " +
        describe_number(geometry.cell_size(0)) + " m: changes are those between maps of the same cell sizes");
}

/// Calls `visit(index)` for regions that hold all leaves of two maps that are not the same, by place, size or
/// state. O(what was written since).
template <class Map, class Visit>
void for_each_difference(const Map& before, const Map& after, const Visit& visit) {
  using Tree = typename Map::Tree;
  using Region = TreeRegion<Tree>;
  check_same_cells(before, after);
  Pace pace;
  const auto descend = [&](const auto& self, const Region& old, const Region& now) -> void {
    pace.spend();
    if (old.is_leaf() || now.is_leaf()) {
      if (old.is_leaf() != now.is_leaf() || old.state() != now.state()) visit(now.index());
      return;
    }
    if (old.shares_all(now)) return;
    for (int j = 0; j < Tree::kNumChildren; ++j) self(self, old.child(j), now.child(j));
  };
  for_each_pair(before.tree(), after.tree(),
                [&](const Region& old, const Region& now) { descend(descend, old, now); });
}

}  // namespace detail

/// Calls `visit(change)` for each region whose state differs between two maps, depth first, or for each whose
/// cell does. Nothing that is the same memory in both is entered: for a map and its snapshot() that is O(what
/// was written since).
/// @throws std::invalid_argument if their smallest cells or numbers of levels differ; Cancelled.
template <class Map, class Visit>
void for_each_change(const Map& before, const Map& after, const Visit& visit,
                     ChangeOf what = ChangeOf::states) {
  using Tree = typename Map::Tree;
  using Region = detail::TreeRegion<Tree>;
  detail::check_same_cells(before, after);
  Pace pace;
  const auto descend = [&](const auto& self, const Region& old, const Region& now) -> void {
    pace.spend();
    if (old.is_leaf() && now.is_leaf()) {
      if (what == ChangeOf::states ? old.state() != now.state() : !old.is_same_cell(now))
        visit(Change<Map::kDim>{now.index(), old.state(), now.state()});
      return;
    }
    if (!old.is_leaf() && !now.is_leaf() && old.shares_all(now)) return;
    for (int j = 0; j < Tree::kNumChildren; ++j) self(self, old.child(j), now.child(j));
  };
  detail::for_each_pair(before.tree(), after.tree(),
                        [&](const Region& old, const Region& now) { descend(descend, old, now); });
}

/// All of them.
template <class Map>
[[nodiscard]] std::vector<Change<Map::kDim>> changes(const Map& before, const Map& after,
                                                     ChangeOf what = ChangeOf::states) {
  std::vector<Change<Map::kDim>> result;
  for_each_change(
      before, after, [&](const Change<Map::kDim>& change) { result.push_back(change); }, what);
  return result;
}

}  // namespace ndtree
