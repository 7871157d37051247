// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Parts of space that were mapped apart become one tree, bit for bit: of a map, or of a layer.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <stdexcept>
#include <string>

#include "ndtree/core/cancel.hpp"
#include "ndtree/core/option.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/tree/cube_set.hpp"
#include "ndtree/tree/lattice.hpp"
#include "ndtree/tree/nd_tree.hpp"

namespace ndtree::detail {

/// Wants the cubes of a set, or all others; see for_each_cube().
template <int D>
[[nodiscard]] auto inside(const CubeSet<D>& cubes) {
  return [&cubes](const CellIndex<D>& cell, std::int64_t edge) {
    return cell.level > 0 || cubes.overlaps(cell, edge);
  };
}
template <int D>
[[nodiscard]] auto outside(const CubeSet<D>& cubes) {
  return [&cubes](const CellIndex<D>& cell, std::int64_t edge) {
    return cell.level > 0 || !cubes.overlaps(cell, edge);
  };
}

/// Calls `visit(ref)` for each node of a level, at most 0, that is more than one blank leaf.
/// @param is_blank(cell) whether a leaf holds nothing. @param is_wanted(cell, edge) whether there may be
/// wanted nodes in a cell. Cost: nodes of the level and above that are wanted.
template <class Tree, class IsBlank, class IsWanted, class Visit>
void for_each_cube(const Tree& tree, int level, const IsBlank& is_blank, const IsWanted& is_wanted,
                   const Visit& visit) {
  Pace pace;
  const auto descend = [&](const auto& self, const typename Tree::ConstRef& ref) -> void {
    pace.spend();
    if (!is_wanted(ref.index, tree.geometry().edge(ref.index.level))) return;
    if (ref.is_leaf() && is_blank(ref.cell())) return;
    if (ref.index.level == level) {
      visit(ref);
    } else if (!ref.is_leaf()) {
      for (int j = 0; j < Tree::kNumChildren; ++j) self(self, tree.child(ref, j));
    }
  };
  descend(descend, tree.root());
}

/// The node of a level that begins at some place; what is above it is divided where it has to be.
/// @param pass(ref) is called with each node on the way. @pre the place is inside the root.
template <class Tree, class Pass>
[[nodiscard]] typename Tree::Ref cube_at(Tree& tree, int level, const Lattice<Tree::kDim>& lower,
                                         const Pass& pass) {
  typename Tree::Ref ref = tree.root();
  while (ref.index.level > level) {
    if (ref.is_leaf()) tree.split(ref);
    pass(ref);
    ref = tree.child_towards(ref, lower);
  }
  return ref;
}

/// Copies the cubes of one tree into another of the same lattice in which they are unknown; summaries on the
/// way become stale.
template <class Tree, class IsBlank>
class Adopting {
  static constexpr auto D = static_cast<std::size_t>(Tree::kDim);
  using NodeType = typename Tree::NodeType;

 public:
  /// @param level of the cubes: that of the largest cells that are ever updated. @param is_blank see
  /// for_each_cube().
  Adopting(Tree& tree, int level, const IsBlank& is_blank)
      : tree_(tree), level_(level), is_blank_(is_blank) {}

  /// @throws std::invalid_argument naming the first cube that both hold.
  /// @param is_wanted see for_each_cube().
  template <class IsWanted>
  void run(const Tree& other, const IsWanted& is_wanted) {
    std::optional<LatticeBox<Tree::kDim>> box;
    const std::int64_t edge = tree_.geometry().edge(level_);
    for_each_cube(other, level_, is_blank_, is_wanted, [&](const auto& cube) {
      if (!box) box = {cube.index.lower, cube.index.lower};
      for (std::size_t a = 0; a < D; ++a) {
        box->lower[a] = std::min(box->lower[a], cube.index.lower[a]);
        box->upper[a] = std::max(box->upper[a], cube.index.lower[a] + edge);
      }
    });
    if (!box) return;
    grow_around(tree_, *box);
    for_each_cube(other, level_, is_blank_, is_wanted, [&](const auto& cube) {
      const auto target = cube_at(tree_, level_, cube.index.lower,
                                  [](const auto& above) { above.node->set_summary_word(0); });
      if (!target.is_leaf() || !is_blank_(target.cell()))
        throw std::invalid_argument(held_by_both(cube.index));
      copy(other, *cube.node, *target.node);
    });
  }

 private:
  void copy(const Tree& other, const NodeType& source, NodeType& target) {
    if (source.is_leaf()) {
      target.become_leaf(source.cell());
      return;
    }
    pace_.spend(Tree::kNumChildren);
    tree_.split_node(target);
    for (int j = 0; j < Tree::kNumChildren; ++j)
      copy(other, other.children(source)[j], tree_.children(target)[j]);
  }
  [[nodiscard]] std::string held_by_both(const CellIndex<Tree::kDim>& cube) const {
    std::string text = "both maps hold cells in the cube of " +
                       describe_number(tree_.geometry().cell_size(level_)) + " m from (";
    for (std::size_t a = 0; a < D; ++a)
      text += (a > 0 ? ", " : "") + describe_number(tree_.geometry().border(cube.lower[a]));
    return text + ") m: must be one of them";
  }

  Tree& tree_;
  int level_;
  IsBlank is_blank_;
  Pace pace_;
};

}  // namespace ndtree::detail
