// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Blocks of a tree's nodes as they were before a change, so that a change that fails can be undone.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstring>
#include <type_traits>
#include <vector>

#include "ndtree/core/inline.hpp"
#include "ndtree/tree/nd_tree.hpp"

namespace ndtree {

/// Blocks of siblings as they were. Invariant: before the children of an inner node change or merge, their
/// block is kept, once. Then undo() restores the whole tree, without allocating.
template <class Tree>
class alignas(kCacheLines) UndoLog {  // One for each thread.
  using NodeType = typename Tree::NodeType;
  static_assert(std::is_trivially_copyable_v<NodeType>);

 public:
  /// Keeps the children of an inner node, and copies their chunk if another tree shares it.
  void keep(Tree& tree, const NodeType& parent) {
    const NodeType* const children = tree.children(parent);  // Copies on write: may throw std::bad_alloc.
    Kept& kept = kept_.emplace_back();
    kept.block = parent.children();
    std::memcpy(kept.bytes, children, sizeof kept.bytes);
  }

  /// Where a tree stood when its logs were empty.
  struct Begin {
    CellIndex<Tree::kDim> root_index;
    NodeType root;
    explicit Begin(const Tree& tree) : root_index(tree.root().index), root(*tree.root().node) {}
  };

  /// Restores a tree. @pre since `begin` there were only splits, merges, growth, and changes of cells and
  /// summaries.
  static void undo(Tree& tree, const Begin& begin, std::vector<UndoLog>& logs) {
    tree.shrink_to(begin.root_index);
    for (UndoLog& log : logs)
      std::sort(log.kept_.begin(), log.kept_.end(),
                [](const Kept& a, const Kept& b) { return a.block < b.block; });
    // Cut new nodes first, so that there is room for the old ones.
    NodeType& root = *tree.root().node;
    cut_new(tree, root, begin.root, logs);
    restore(tree, root, begin.root, logs);
  }

 private:
  struct Kept {
    BlockId block;
    alignas(NodeType) std::byte bytes[sizeof(NodeType) * Tree::kNumChildren];  // Not initialised.

    Kept() {}  // NOLINT(modernize-use-equals-default): that would write zeros.
    [[nodiscard]] NodeType node(int number) const {
      NodeType node;
      std::memcpy(static_cast<void*>(&node), bytes + sizeof(NodeType) * static_cast<std::size_t>(number),
                  sizeof node);
      return node;
    }
  };

  /// The siblings that were in a block; null if they never changed.
  [[nodiscard]] static const Kept* find(const std::vector<UndoLog>& logs, BlockId block) {
    for (const UndoLog& log : logs) {
      const auto at = std::lower_bound(log.kept_.begin(), log.kept_.end(), block,
                                       [](const Kept& kept, BlockId id) { return kept.block < id; });
      if (at != log.kept_.end() && at->block == block) return &*at;
    }
    return nullptr;
  }

  /// Cuts subtrees that were leaves.
  static void cut_new(Tree& tree, NodeType& node, const NodeType& before, const std::vector<UndoLog>& logs) {
    if (before.is_leaf()) {
      tree.cut(node);
      node = before;
    } else if (!node.is_leaf()) {
      if (const Kept* const kept = find(logs, before.children()))
        for (int j = 0; j < Tree::kNumChildren; ++j)
          cut_new(tree, tree.children(node)[j], kept->node(j), logs);
    }
  }
  /// Divides leaves that were inner nodes.
  static void restore(Tree& tree, NodeType& node, const NodeType& before, const std::vector<UndoLog>& logs) {
    if (before.is_leaf()) {
      node = before;
      return;
    }
    if (const Kept* const kept = find(logs, before.children())) {
      if (node.is_leaf()) tree.split_node(node);
      for (int j = 0; j < Tree::kNumChildren; ++j) restore(tree, tree.children(node)[j], kept->node(j), logs);
    }
    node.set_summary_word(before.summary_word());
  }

  std::vector<Kept> kept_;
};

/// Before something changes below an inner node in a scan: its children are kept, and its summary becomes
/// stale until the scan is done. Once, as a summary of 0 is that of a node that was here, or that the scan
/// has split.
/// @param undo null if nothing is kept.
template <class Tree>
void before_change_below(Tree& tree, typename Tree::NodeType& parent, UndoLog<Tree>* undo) {
  if (parent.summary_word() == 0) return;
  if (undo != nullptr) undo->keep(tree, parent);
  parent.set_summary_word(0);
}

}  // namespace ndtree
