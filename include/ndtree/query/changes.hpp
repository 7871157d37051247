// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// What is different between two maps of one lattice, as between a map and what it was.
#pragma once

#include <cstdint>
#include <optional>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <vector>

#include "ndtree/cell/occupancy_cell.hpp"
#include "ndtree/cell/thin_things.hpp"
#include "ndtree/core/cancel.hpp"
#include "ndtree/core/option.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/tree/lattice.hpp"

namespace ndtree {

/// What counts as a change: another state, or that as part of a column of cells, see
/// ThinThings::state_in_column(), or whether it is occupied and larger than the smallest, or anything that a
/// cell holds, its size too.
enum class ChangeOf { states, columns, cells };

/// A region whose state, or cell, is another one.
template <int D>
struct Change {
  CellIndex<D> index;  ///< Of the smaller of the two leaves that it lay in, and lies in.
  CellState before = CellState::unknown;
  CellState after = CellState::unknown;
  bool was_large = false;  ///< Of columns: occupied, as a part of a cell larger than the smallest.
  bool is_large = false;
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
  [[nodiscard]] std::int64_t edge() const { return tree_->geometry().edge(index_.level); }
  [[nodiscard]] bool is_leaf() const { return node_ != nullptr ? node_->is_leaf() : !is_around_root_; }
  /// Whether the tree has this very node, not just a larger leaf there.
  [[nodiscard]] bool is_node_of_its_own() const { return is_own_; }
  [[nodiscard]] bool is_smallest() const {
    return is_own_ && index_.level == tree_->geometry().finest_level();
  }
  /// @pre is_leaf(). @param thin what counts as occupied although it is free.
  [[nodiscard]] CellState state(const ThinThings& thin = {}) const {
    return node_ != nullptr ? thin.state_in_column(node_->cell()) : CellState::unknown;
  }
  /// Whether the region is a leaf, or part of one, that says what another tree's says, and is as large if it
  /// was observed. @pre both are leaves.
  [[nodiscard]] bool is_same_cell(const TreeRegion& other) const {
    const auto cell = cell_or_none();
    return cell == other.cell_or_none() && (is_own_ == other.is_own_ || !cell.observed());
  }
  [[nodiscard]] CellIndex<D> child_index(int number) const {
    return tree_->geometry().child(index_, child_offset<Tree::kBranching, D>(number));
  }
  /// A part of the region; of a leaf, the leaf. @param index child_index(number).
  [[nodiscard]] TreeRegion child(int number, const CellIndex<D>& index) const {
    const bool is_leaf = this->is_leaf();
    if (!is_leaf && node_ == nullptr) return TreeRegion(*tree_, index);
    TreeRegion part = *this;
    part.index_ = index;
    if (is_leaf)
      part.is_own_ = false;
    else
      part.node_ = tree_->children(*node_) + number;
    return part;
  }
  /// Whether nothing can be different from another tree's region. @pre neither is a leaf.
  [[nodiscard]] bool shares_all(const TreeRegion& other) const {
    return node_ != nullptr && other.node_ != nullptr && shares_all(*node_, other, *other.node_);
  }
  /// Calls `visit(number)` for the parts that are not for certain the same as another region's: those that do
  /// not share all, and leaves of both for which not `is_same(cell, cell)`. @pre neither is a leaf.
  template <class IsSame, class Visit>
  void for_each_other_child(const TreeRegion& other, const IsSame& is_same, const Visit& visit) const {
    if (node_ == nullptr || other.node_ == nullptr) {
      for (int j = 0; j < Tree::kNumChildren; ++j) visit(j);
      return;
    }
    const NodeType* const own = tree_->children(*node_);
    const NodeType* const others = other.tree_->children(*other.node_);
    for (int j = 0; j < Tree::kNumChildren; ++j) {
      const bool is_leaf = own[j].is_leaf();
      const bool is_same_part =
          is_leaf == others[j].is_leaf() &&
          (is_leaf ? is_same(own[j].cell(), others[j].cell()) : shares_all(own[j], other, others[j]));
      if (!is_same_part) visit(j);
    }
  }

 private:
  using NodeType = typename Tree::NodeType;

  [[nodiscard]] bool shares_all(const NodeType& own, const TreeRegion& other, const NodeType& others) const {
    return tree_->shares_children(own, *other.tree_, others);
  }
  [[nodiscard]] auto cell_or_none() const {
    return node_ != nullptr ? node_->cell() : std::decay_t<decltype(node_->cell())>{};
  }

  const Tree* tree_;
  const NodeType* node_ = nullptr;
  CellIndex<D> index_;
  bool is_around_root_ = false;
  bool is_own_ = false;
};

/// Descends into two regions of the same place, one of each tree. Where one of them is a leaf, calls
/// `visit(a, b)`, which says whether to go on with their parts. Parts that are the same memory are left out,
/// leaves of both for which `is_same(cell, cell)`, and what shares no volume with a box. @param box or none.
template <class Tree, class IsSame, class Visit>
void descend_pair(const TreeRegion<Tree>& a, const TreeRegion<Tree>& b, const LatticeBox<Tree::kDim>* box,
                  Pace& pace, const IsSame& is_same, const Visit& visit) {
  const auto descend = [&](int number) {
    const auto index = a.child_index(number);
    descend_pair(a.child(number, index), b.child(number, index), box, pace, is_same, visit);
  };
  pace.spend();
  if (box != nullptr && !box->overlaps(a.index(), a.edge())) return;
  if (a.is_leaf() || b.is_leaf()) {
    if (!visit(a, b)) return;
    for (int j = 0; j < Tree::kNumChildren; ++j) descend(j);
  } else if (!a.shares_all(b)) {
    pace.spend(Tree::kNumChildren);
    a.for_each_other_child(b, is_same, descend);
  }
}

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

/// Calls `visit(index)` for regions that hold all leaves of two maps that are not the same, by place, size,
/// state, or whether they hold something thin. O(what was written since).
template <class Map, class Visit>
void for_each_difference(const Map& before, const Map& after, const Visit& visit) {
  using Tree = typename Map::Tree;
  using Region = TreeRegion<Tree>;
  check_same_cells(before, after);
  Pace pace;
  const ThinThings in_old(before);
  const ThinThings in_new(after);
  const auto is_same = [&](const auto& old, const auto& now) {
    return old.state() == now.state() && in_old.are_in(old) == in_new.are_in(now);
  };
  for_each_pair(before.tree(), after.tree(), [&](const Region& a, const Region& b) {
    descend_pair(a, b, nullptr, pace, is_same, [&](const Region& old, const Region& now) {
      if (old.is_leaf() != now.is_leaf() || old.state() != now.state() ||
          old.state(in_old) != now.state(in_new))
        visit(now.index());
      return false;
    });
  });
}

}  // namespace detail

/// Calls `visit(change)` for each region whose state, or cell, differs between two maps, depth first. Nothing
/// that is the same memory in both is entered: for a map and its snapshot() that is O(what was written
/// since).
/// @throws std::invalid_argument if their smallest cells or numbers of levels differ; Cancelled.
template <class Map, class Visit>
void for_each_change(const Map& before, const Map& after, const Visit& visit,
                     ChangeOf what = ChangeOf::states,
                     const std::optional<Box<Map::kDim>>& box = std::nullopt) {
  using Tree = typename Map::Tree;
  using Region = detail::TreeRegion<Tree>;
  detail::check_same_cells(before, after);
  const auto& geometry = after.tree().geometry();
  std::optional<LatticeBox<Map::kDim>> cells;
  if (box) cells = geometry.cells_in(*box, geometry.finest_level());
  Pace pace;
  const bool is_cells = what == ChangeOf::cells;
  const bool is_columns = what == ChangeOf::columns;
  const ThinThings in_old = is_columns ? ThinThings(before) : ThinThings();
  const ThinThings in_new = is_columns ? ThinThings(after) : ThinThings();
  const auto is_same = [&](const auto& old, const auto& now) {
    return is_cells ? old == now : in_old.state_in_column(old) == in_new.state_in_column(now);
  };
  detail::for_each_pair(before.tree(), after.tree(), [&](const Region& a, const Region& b) {
    detail::descend_pair(
        a, b, cells ? &*cells : nullptr, pace, is_same, [&](const Region& old, const Region& now) {
          if (!old.is_leaf() || !now.is_leaf()) return true;
          const CellState was = old.state(in_old);
          const CellState is = now.state(in_new);
          const bool was_large = is_columns && was == CellState::occupied && !old.is_smallest();
          const bool is_large = is_columns && is == CellState::occupied && !now.is_smallest();
          if (is_cells ? !old.is_same_cell(now) : was != is || was_large != is_large)
            visit(Change<Map::kDim>{now.index(), was, is, was_large, is_large});
          return false;
        });
  });
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
