// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Parts of space that were mapped apart become one map, bit for bit.
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
#include "ndtree/mapping/forget.hpp"
#include "ndtree/tree/lattice.hpp"
#include "ndtree/tree/nd_tree.hpp"

namespace ndtree::detail {

/// Calls `visit(ref)` for each node of level 0, on a tree's lattice the cell of max_cell_size, of which it
/// holds more than one blank leaf.
/// @param window outside which none is visited; null: all are. Cost: nodes of level 0 and above in the
/// window.
template <class Tree, class Visit>
void for_each_cube(const Tree& tree, const LatticeBox<Tree::kDim>* window, const Visit& visit) {
  Pace pace;
  const auto descend = [&](const auto& self, const typename Tree::ConstRef& ref) -> void {
    pace.spend();
    if (window != nullptr && !window->overlaps(ref.index, tree.geometry().edge(ref.index.level))) return;
    if (ref.is_leaf() && is_blank(ref.cell())) return;
    if (ref.index.level == 0) {
      visit(ref);
    } else if (!ref.is_leaf()) {
      for (int j = 0; j < Tree::kNumChildren; ++j) self(self, tree.child(ref, j));
    }
  };
  descend(descend, tree.root());
}

/// The node of level 0 that begins at some place; what is above it is divided where it has to be.
/// @param pass(ref) is called with each node on the way. @pre the place is inside the root.
template <class Tree, class Pass>
[[nodiscard]] typename Tree::Ref cube_at(Tree& tree, const Lattice<Tree::kDim>& lower, const Pass& pass) {
  typename Tree::Ref ref = tree.root();
  while (ref.index.level > 0) {
    if (ref.is_leaf()) tree.split(ref);
    pass(ref);
    ref = tree.child_towards(ref, lower);
  }
  return ref;
}

/// Room for a box of cells; what the root becomes depends on it alone, and on what it was.
template <class Tree>
void grow_around(Tree& tree, const LatticeBox<Tree::kDim>& box) {
  Vector<Tree::kDim> first;
  Vector<Tree::kDim> last;
  const double reach = tree.geometry().reach();  // A large cell may go beyond it.
  for (int a = 0; a < Tree::kDim; ++a) {
    first[a] = std::max(-reach, tree.geometry().border(box.lower[static_cast<std::size_t>(a)]));
    last[a] = std::min(reach, tree.geometry().border(box.upper[static_cast<std::size_t>(a)] - 1));
  }
  tree.grow_to_contain(first);
  tree.grow_to_contain(last);
}

/// Copies the cubes of one tree into another of the same lattice that knows nothing of them; notes on the way
/// become unknown.
template <class Tree>
class Adopting {
  static constexpr auto D = static_cast<std::size_t>(Tree::kDim);
  using NodeType = typename Tree::NodeType;

 public:
  explicit Adopting(Tree& tree) : tree_(tree) {}

  /// @throws std::invalid_argument naming the first cube that both hold.
  void run(const Tree& other, const LatticeBox<Tree::kDim>* window) {
    std::optional<LatticeBox<Tree::kDim>> box;
    const std::int64_t edge = tree_.geometry().edge(0);
    for_each_cube(other, window, [&](const auto& cube) {
      if (!box) box = {cube.index.lower, cube.index.lower};
      for (std::size_t a = 0; a < D; ++a) {
        box->lower[a] = std::min(box->lower[a], cube.index.lower[a]);
        box->upper[a] = std::max(box->upper[a], cube.index.lower[a] + edge);
      }
    });
    if (!box) return;
    grow_around(tree_, *box);
    for_each_cube(other, window, [&](const auto& cube) {
      const auto target =
          cube_at(tree_, cube.index.lower, [](const auto& above) { above.node->set_note(0); });
      if (!target.is_leaf() || !is_blank(target.cell()))
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
    std::string text =
        "both maps hold cells in the cube of " + describe_number(tree_.geometry().cell_size(0)) + " m from (";
    for (std::size_t a = 0; a < D; ++a)
      text += (a > 0 ? ", " : "") + describe_number(tree_.geometry().border(cube.lower[a]));
    return text + ") m: must be one of them";
  }

  Tree& tree_;
  Pace pace_;
};

}  // namespace ndtree::detail
