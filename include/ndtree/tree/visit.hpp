// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Depth-first visits of a tree's nodes and leaves: of all, or of the ones that touch a box.
#pragma once

#include "ndtree/core/cancel.hpp"
#include "ndtree/core/inline.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/tree/nd_tree.hpp"

namespace ndtree {

/// Calls `visit(ref)` for every node, parents before children, children by number.
template <class Tree, class Visit>
void for_each_node(Tree& tree, Visit&& visit) {
  Pace pace;
  // Compilers would inline the recursion into itself, several levels deep: much code, which is no faster.
  const auto descend = [&](const auto& self, const auto& ref) NDTREE_NEVER_INLINE -> void {
    pace.spend(Tree::kNumChildren);
    for (int j = 0; j < Tree::kNumChildren; ++j) {
      const auto child = tree.child(ref, j);
      visit(child);
      if (!child.is_leaf()) self(self, child);
    }
  };
  const auto root = tree.root();
  visit(root);
  if (!root.is_leaf()) descend(descend, root);
}

/// Calls `visit(leaf)` for every leaf, in the order of for_each_node().
template <class Tree, class Visit>
void for_each_leaf(Tree& tree, Visit&& visit) {
  for_each_node(tree, [&](const auto& ref) {
    if (ref.is_leaf()) visit(ref);
  });
}

/// Calls `visit(leaf)` for every leaf whose closed cell touches the closed box. Subtrees that do not are not
/// entered. A visit that returns bool stops everything by returning false.
/// @returns false if it was stopped.
template <class Tree, class Visit>
bool for_each_leaf_in(Tree& tree, const Box<Tree::kDim>& region, Visit&& visit) {
  Pace pace;
  const auto descend = [&](const auto& self, const auto& ref) -> bool {
    pace.spend();
    if (!region.touches(tree.box(ref.index))) return true;
    if (ref.is_leaf()) {
      if constexpr (std::is_same_v<decltype(visit(ref)), bool>) {
        return visit(ref);
      } else {
        visit(ref);
        return true;
      }
    }
    for (int j = 0; j < Tree::kNumChildren; ++j)
      if (!self(self, tree.child(ref, j))) return false;
    return true;
  };
  return descend(descend, tree.root());
}

}  // namespace ndtree
