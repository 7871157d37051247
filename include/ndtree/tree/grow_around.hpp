// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Room in a tree for a box of cells.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "ndtree/core/types.hpp"
#include "ndtree/tree/lattice.hpp"

namespace ndtree::detail {

/// Grows a tree around a box of cells, of level 0 or below; what the root becomes depends on the box alone,
/// and on what the root was. @throws std::invalid_argument if a cell lies out of reach; only a part of one
/// may.
template <class Tree>
void grow_around(Tree& tree, const LatticeBox<Tree::kDim>& box) {
  Vector<Tree::kDim> first;
  Vector<Tree::kDim> last;
  const double reach = tree.geometry().reach();
  const auto within_reach = [&](double x) {
    return std::abs(x) < reach + tree.geometry().cell_size(0) ? std::clamp(x, -reach, reach) : x;
  };
  for (int a = 0; a < Tree::kDim; ++a) {
    first[a] = within_reach(tree.geometry().border(box.lower[static_cast<std::size_t>(a)]));
    last[a] = within_reach(tree.geometry().border(box.upper[static_cast<std::size_t>(a)] - 1));
  }
  tree.grow_to_contain(first);
  tree.grow_to_contain(last);
}

}  // namespace ndtree::detail
