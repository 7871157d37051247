// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The smallest tree within a budget: siblings merge where that loses the least information (Sec. V).
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <optional>
#include <queue>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "ndtree/cell/evidence_model.hpp"
#include "ndtree/core/cancel.hpp"
#include "ndtree/core/option.hpp"

namespace ndtree {

/// What a compressed map may lose or hold; at least one limit. With several, none is exceeded, but that
/// max_loss ends the compression even if the map is still larger than the others ask.
struct CompressBudget {
  std::optional<double> max_loss;         ///< Sum over all merges [bits].
  std::optional<std::size_t> max_leaves;  ///< Observed leaves.
  std::optional<std::size_t> max_bytes;   ///< The map's memory_bytes.

  /// @throws std::invalid_argument naming the first limit that is out of bounds.
  void validate() const {
    if (!max_loss && !max_leaves && !max_bytes)
      throw std::invalid_argument("compress: expected max_loss, max_leaves or max_bytes");
    if (max_loss) require_option(*max_loss >= 0.0, "max_loss", *max_loss, ">= 0 bits");
  }
};

/// What compress() did.
struct CompressReport {
  std::size_t leaves_before = 0;  ///< Observed leaves.
  std::size_t leaves = 0;
  std::size_t bytes_before = 0;
  std::size_t bytes = 0;
  std::uint64_t merges = 0;
  double loss = 0.0;  ///< [bits]
};

namespace detail {

/// Merges in the order of what they lose for each observed leaf that they save, the cheapest first, until the
/// budget is met; a merge makes its parent the next candidate. Equal costs go by the order of depth-first
/// visits. What was never observed is not merged with what was.
template <class Tree, class MergeRule>
class Compression {
  using Joined = typename MergeRule::Joined;
  using Ref = typename Tree::Ref;
  using Cell = typename Tree::Cell;
  static constexpr std::size_t kNone = static_cast<std::size_t>(-1);
  static constexpr std::size_t kMergeSteps = 32;  // Of a Pace.

 public:
  /// @param other_bytes what the map holds beside its tree.
  Compression(Tree& tree, const MergeRule& rule, int coarsest_level, std::size_t other_bytes)
      : tree_(tree), rule_(rule), other_bytes_(other_bytes) {
    least_leaves_ = collect(tree.root(), kNone, coarsest_level).leaves;
  }

  /// @throws std::invalid_argument if max_leaves or max_bytes is less than what is left if all is merged that
  ///   may be; the tree is then unchanged.
  CompressReport run(const CompressBudget& budget) {
    budget.validate();
    if (budget.max_leaves && *budget.max_leaves < least_leaves_)
      refuse("max_leaves", *budget.max_leaves, least_leaves_);
    const std::size_t least_bytes = bytes_of(tree_.num_inner_nodes() - most_merges_);
    if (budget.max_bytes && *budget.max_bytes < least_bytes)
      refuse("max_bytes", *budget.max_bytes, least_bytes);
    CompressReport report;
    report.leaves_before = report.leaves = leaves_;
    report.bytes_before = other_bytes_ + tree_.memory_bytes();
    for (std::size_t i = 0; i < inner_nodes_.size(); ++i)
      if (inner_nodes_[i].divided_children == 0) consider(i);
    while (!candidates_.empty()) {
      const Candidate next = candidates_.top();
      const bool small_enough = (budget.max_leaves || budget.max_bytes) &&
                                (!budget.max_leaves || report.leaves <= *budget.max_leaves) &&
                                (!budget.max_bytes || bytes_of(tree_.num_inner_nodes()) <= *budget.max_bytes);
      if (small_enough && next.joined.loss > 0.0) break;
      if (budget.max_loss && report.loss + next.joined.loss > *budget.max_loss) break;
      candidates_.pop();
      pace_.spend(kMergeSteps);
      InnerNode& node = inner_nodes_[next.node];
      tree_.merge(*node.node, next.joined.cell);
      report.loss += next.joined.loss;
      report.leaves -= static_cast<std::size_t>(std::max(0, next.joined.observed - 1));
      ++report.merges;
      if (node.parent != kNone && --inner_nodes_[node.parent].divided_children == 0) consider(node.parent);
    }
    tree_.shrink_to_fit();
    report.bytes = other_bytes_ + tree_.memory_bytes();
    return report;
  }

 private:
  struct InnerNode {
    typename Tree::NodeType* node;
    std::size_t parent;
    int divided_children;
  };
  struct Candidate {
    double cost;  // For each leaf saved.
    std::size_t node;
    Joined joined;
    friend bool operator>(const Candidate& a, const Candidate& b) {
      return a.cost != b.cost ? a.cost > b.cost : a.node > b.node;
    }
  };

  [[nodiscard]] std::size_t bytes_of(std::size_t inner_nodes) const {
    return other_bytes_ + Tree::memory_bytes_of(inner_nodes);
  }
  [[noreturn]] static void refuse(const char* name, std::size_t value, std::size_t least) {
    throw std::invalid_argument(std::string(name) + " = " + std::to_string(value) + ": must be at least " +
                                std::to_string(least) + ", what merging leaves at least");
  }

  /// What a subtree may become: one cell, if all in it may be merged; and how many leaves remain.
  struct Least {
    std::optional<Cell> cell;
    std::size_t leaves = 0;  // Observed.
  };
  Least collect(const Ref& ref, std::size_t parent, int coarsest_level) {
    if (ref.is_leaf()) {
      leaves_ += ref.cell().observed();
      return {ref.cell(), static_cast<std::size_t>(ref.cell().observed())};
    }
    std::size_t here = kNone;
    if (ref.index.level <= coarsest_level) {
      here = inner_nodes_.size();
      inner_nodes_.push_back({ref.node, parent, 0});
      if (parent != kNone) ++inner_nodes_[parent].divided_children;
    }
    pace_.spend(kMergeSteps);
    Least least;
    std::vector<typename Tree::NodeType> merged;
    for (int j = 0; j < Tree::kNumChildren; ++j) {
      const Least child = collect(tree_.child(ref, j), here, coarsest_level);
      least.leaves += child.leaves;
      if (child.cell) merged.emplace_back().become_leaf(*child.cell);
    }
    if (here == kNone || merged.size() < static_cast<std::size_t>(Tree::kNumChildren)) return least;
    const Joined joined = join(merged.data());
    if (joined.mixes_unknown) return least;
    ++most_merges_;
    return {joined.cell, static_cast<std::size_t>(joined.cell.observed())};
  }
  [[nodiscard]] Joined join(const typename Tree::NodeType* siblings) const {
    return rule_.join(siblings, Tree::kNumChildren, kChildrenAcross<Tree>);
  }

  void consider(std::size_t node) {
    const Joined joined = join(tree_.children(*inner_nodes_[node].node));
    if (joined.mixes_unknown) return;
    candidates_.push({joined.loss / std::max(1, joined.observed - 1), node, joined});
  }

  Tree& tree_;
  const MergeRule& rule_;
  std::size_t other_bytes_;
  std::vector<InnerNode> inner_nodes_;  // Of levels that may merge, parents before children.
  std::priority_queue<Candidate, std::vector<Candidate>, std::greater<>> candidates_;
  std::size_t leaves_ = 0;
  std::size_t least_leaves_ = 0;  // Observed ones that merging leaves at least.
  std::size_t most_merges_ = 0;   // Merges until least_leaves_ are left.
  Pace pace_;
};

}  // namespace detail

}  // namespace ndtree
