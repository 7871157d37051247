// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The evidence of two maps of the same place, added up.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <optional>

#include "ndtree/cell/evidence_cell.hpp"
#include "ndtree/cell/evidence_merge.hpp"
#include "ndtree/cell/occupancy_cell.hpp"
#include "ndtree/core/cancel.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/mapping/edit/forget.hpp"
#include "ndtree/mapping/insert/coverage.hpp"
#include "ndtree/mapping/map_options.hpp"
#include "ndtree/tree/adopt.hpp"
#include "ndtree/tree/lattice.hpp"
#include "ndtree/tree/nd_tree.hpp"
#include "ndtree/tree/visit.hpp"

namespace ndtree::detail {

/// A box around all cells with any evidence, in units of the smallest cell; none without such a cell.
template <class Tree>
[[nodiscard]] std::optional<LatticeBox<Tree::kDim>> known_cells(const Tree& tree) {
  constexpr auto D = static_cast<std::size_t>(Tree::kDim);
  std::optional<LatticeBox<Tree::kDim>> box;
  for_each_leaf(tree, [&](const auto& leaf) {
    if (is_blank(leaf.cell())) return;
    const std::int64_t edge = tree.geometry().edge(leaf.index.level);
    if (!box) box = {leaf.index.lower, leaf.index.lower};
    for (std::size_t a = 0; a < D; ++a) {
      box->lower[a] = std::min(box->lower[a], leaf.index.lower[a]);
      box->upper[a] = std::max(box->upper[a], leaf.index.lower[a] + edge);
    }
  });
  return box;
}

/// Adds the evidence of trees of the same lattice into a new one, which does not depend
/// on their order.
template <class Tree, class Refinement>
class Joining {
  static constexpr int D = Tree::kDim;
  using Cell = typename Tree::Cell;
  using NodeType = typename Tree::NodeType;
  using Ref = typename Tree::Ref;

 public:
  Joining(const MapOptions& options, const Refinement& refinement)
      : refinement_(refinement),
        log_odds_min_(static_cast<float>(options.log_odds_min)),
        log_odds_max_(static_cast<float>(options.log_odds_max)),
        tree_(options.min_cell_size, options.num_levels(Tree::kBranching)),
        coarsest_(Refinement::coarsest_level(tree_.geometry().finest_level())) {
    tree_.limit_memory(options.memory_limit());
  }

  /// Room for the cells of both, in any order.
  void grow_around(const Tree& one, const Tree& other) {
    std::optional<LatticeBox<D>> box = known_cells(one);
    if (const auto more = known_cells(other)) {
      if (!box) box = more;
      for (std::size_t a = 0; a < D; ++a) {
        box->lower[a] = std::min(box->lower[a], more->lower[a]);
        box->upper[a] = std::max(box->upper[a], more->upper[a]);
      }
    }
    if (box) detail::grow_around(tree_, *box);
  }
  void add(const Tree& other) { add_below(other, other.root()); }
  /// Merges siblings where the refinement's rule does. @returns how often.
  std::uint64_t merge() {
    merge_below(tree_.root());
    return merges_;
  }
  [[nodiscard]] Tree& tree() { return tree_; }

 private:
  void add_below(const Tree& other, const typename Tree::ConstRef& ref) {
    if (ref.index.level == 0) {
      if (is_blank_below(other, *ref.node)) return;
      const Ref target = cube_at(tree_, 0, ref.index.lower, [](const Ref&) {});
      add_node(target, other, *ref.node);
    } else if (!ref.is_leaf()) {
      for (int j = 0; j < Tree::kNumChildren; ++j) add_below(other, other.child(ref, j));
    }
  }
  [[nodiscard]] static bool is_blank_below(const Tree& tree, const NodeType& node) {
    if (node.is_leaf()) return is_blank(node.cell());
    const NodeType* const children = tree.children(node);
    return std::all_of(children, children + Tree::kNumChildren,
                       [&](const NodeType& child) { return is_blank_below(tree, child); });
  }
  void add_node(const Ref& target, const Tree& other, const NodeType& node) {
    if (node.is_leaf()) {
      add_cell(target, adopted(node.cell()));
      return;
    }
    pace_.spend();
    if (target.is_leaf()) divide(target);
    for (int j = 0; j < Tree::kNumChildren; ++j)
      add_node(tree_.child(target, j), other, other.children(node)[j]);
  }
  void add_cell(const Ref& target, const Cell& cell) {
    if (is_blank(cell)) return;
    if (target.is_leaf()) {
      target.cell() = joined(target.cell(), cell, tree_.geometry().edge(target.index.level));
      return;
    }
    pace_.spend();
    for (int j = 0; j < Tree::kNumChildren; ++j) add_cell(tree_.child(target, j), part_of(cell, j));
  }
  void divide(const Ref& leaf) {
    const Cell whole = leaf.cell();
    tree_.split(leaf);
    for (int j = 0; j < Tree::kNumChildren; ++j) tree_.child(leaf, j).cell() = part_of(whole, j);
  }
  void merge_below(const Ref& ref) {
    if (ref.is_leaf()) return;
    pace_.spend();
    bool are_leaves = true;
    for (int j = 0; j < Tree::kNumChildren; ++j) {
      const Ref child = tree_.child(ref, j);
      merge_below(child);
      are_leaves = are_leaves && child.is_leaf();
    }
    if (!are_leaves || ref.index.level > coarsest_) return;
    if (const auto cell = merged_siblings<Tree>(refinement_, tree_.children(*ref.node))) {
      tree_.merge(*ref.node, *cell);
      ++merges_;
    }
  }

  [[nodiscard]] OccupancyCell joined(const OccupancyCell& one, const OccupancyCell& other,
                                     std::int64_t /*edge*/) const {
    if (!one.observed()) return other;
    if (!other.observed()) return one;
    OccupancyCell both;
    both.set_counts(one.hits() + other.hits(), one.misses() + other.misses());
    both.set_log_odds(std::clamp(one.log_odds() + other.log_odds(), log_odds_min_, log_odds_max_));
    return both;
  }
  [[nodiscard]] EvidenceCell joined(const EvidenceCell& one, const EvidenceCell& other,
                                    std::int64_t edge) const {
    if (is_blank(one)) return other;
    if (is_blank(other)) return one;
    const bool is_observed = one.observed() || other.observed();
    const std::uint32_t parts = one.seen_parts() | other.seen_parts();  // If neither is.
    const bool is_enough = is_observed || refinement_.coverage.template are_enough<Tree::kBranching, D>(
                                              parts, static_cast<double>(edge));
    return refinement_.model.joined(one, other, is_enough ? std::nullopt : std::optional(parts));
  }
  /// A cell of a map of other options, within the bounds of these.
  [[nodiscard]] OccupancyCell adopted(OccupancyCell cell) const {
    if (cell.observed()) cell.set_log_odds(std::clamp(cell.log_odds(), log_odds_min_, log_odds_max_));
    return cell;
  }
  [[nodiscard]] EvidenceCell adopted(const EvidenceCell& cell) const {
    return refinement_.model.adopted(cell);
  }
  /// A child's part of a cell about whose inside nothing is known.
  [[nodiscard]] static OccupancyCell part_of(const OccupancyCell& whole, int /*child*/) { return whole; }
  [[nodiscard]] EvidenceCell part_of(const EvidenceCell& whole, int child) const {
    return refinement_.model.part_of(whole, kChildrenAcross<Tree>,
                                     CellParts<Tree::kBranching, D>::of_child(child));
  }

  const Refinement& refinement_;
  float log_odds_min_;
  float log_odds_max_;
  Tree tree_;
  int coarsest_;
  std::uint64_t merges_ = 0;
  Pace pace_;
};

}  // namespace ndtree::detail
