// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The children of an inner node, by number.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ndtree/core/simd.hpp"

namespace ndtree {

/// Finds nodes of children in O(1) and their cells in O(D). The parent must stay where it is, and an inner
/// node.
template <class Tree>
class NodeChildren {
 public:
  using Ref = typename Tree::Ref;

  NDTREE_ALWAYS_INLINE NodeChildren(Tree& tree, const Ref& parent)
      : parent_(parent),
        nodes_(tree.children(*parent.node)),
        edge_(tree.geometry().edge(parent.index.level - 1)) {}

  [[nodiscard]] const Ref& parent() const { return parent_; }
  /// Level of the children.
  [[nodiscard]] int level() const { return parent_.index.level - 1; }
  [[nodiscard]] typename Tree::NodeType& node(int number) const { return nodes_[number]; }
  /// Node and cell of a child.
  [[nodiscard]] NDTREE_ALWAYS_INLINE Ref operator[](int number) const {
    Ref child{nodes_ + number, {parent_.index.lower, level()}};
    auto left = static_cast<unsigned>(number);
    for (std::size_t a = 0; a < Tree::kDim; ++a, left /= Tree::kBranching)
      child.index.lower[a] += static_cast<std::int64_t>(left % Tree::kBranching) * edge_;
    return child;
  }

 private:
  const Ref& parent_;
  typename Tree::NodeType* nodes_;
  std::int64_t edge_;
};

}  // namespace ndtree
