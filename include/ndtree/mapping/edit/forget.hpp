// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Parts of a map become unknown again.
#pragma once

#include "ndtree/cell/evidence_cell.hpp"
#include "ndtree/cell/summary.hpp"
#include "ndtree/core/cancel.hpp"
#include "ndtree/core/forget_rule.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/tree/lattice.hpp"

namespace ndtree::detail {

template <class Cell>
[[nodiscard]] bool is_blank(const Cell& cell) {
  return !cell.observed();
}
[[nodiscard]] inline bool is_blank(const EvidenceCell& cell) {
  return !cell.observed() && !cell.is_partly_seen();
}

/// What a child keeps of a parent that is divided to change a part of it: all of it if it was observed,
/// nothing if it was partly seen.
template <class Cell>
[[nodiscard]] Cell without_parts(const Cell& cell) {
  return cell.observed() ? cell : Cell{};
}

/// Forgets what a rule says of a tree, and keeps its summaries up to date.
template <class Tree, class IsSaturated, class Rule>
class Forgetting {
  static constexpr int D = Tree::kDim;
  using Ref = typename Tree::Ref;

 public:
  Forgetting(Tree& tree, const IsSaturated& is_saturated, const Rule& rule)
      : tree_(tree), is_saturated_(is_saturated), rule_(rule) {}

  void run() { descend(tree_.root()); }

 private:
  /// @returns whether anything changed.
  bool descend(const Ref& ref) {
    if (ref.is_leaf() && is_blank(ref.cell())) return false;
    pace_.spend();
    switch (
        rule_.fate(tree_.box(ref.index), ref.is_leaf(), ref.index.level != tree_.geometry().finest_level())) {
      case Fate::keep:
        return false;
      case Fate::forget:
        tree_.cut(*ref.node);
        return true;
      case Fate::divide:
        break;
    }
    const bool was_leaf = ref.is_leaf();
    const typename Tree::Cell before = was_leaf ? ref.cell() : typename Tree::Cell{};
    if (was_leaf) tree_.split_node(*ref.node, without_parts(before));
    bool changed = was_leaf && !before.observed();  // A partly seen cell loses its parts.
    bool all_blank = true;
    for (int j = 0; j < Tree::kNumChildren; ++j) {
      const Ref child = tree_.child(ref, j);
      changed = descend(child) || changed;
      all_blank = all_blank && child.is_leaf() && is_blank(child.cell());
    }
    if (!changed) {  // The rule takes nothing of it after all.
      if (was_leaf) tree_.cut(*ref.node, before);
      return false;
    }
    if (all_blank)
      tree_.cut(*ref.node);
    else
      summarise(tree_, *ref.node, is_saturated_);
    return true;
  }
  Tree& tree_;
  const IsSaturated& is_saturated_;
  const Rule& rule_;
  Pace pace_;
};

}  // namespace ndtree::detail
