// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Parts of a map get a state that is given.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <stdexcept>
#include <string>
#include <vector>

#include "ndtree/cell/child_initialisation.hpp"
#include "ndtree/cell/evidence_cell.hpp"
#include "ndtree/cell/occupancy_cell.hpp"
#include "ndtree/cell/summary.hpp"
#include "ndtree/core/cancel.hpp"
#include "ndtree/core/forget_rule.hpp"
#include "ndtree/core/log_odds.hpp"
#include "ndtree/mapping/forget.hpp"
#include "ndtree/mapping/map_options.hpp"

namespace ndtree::detail {

/// @throws std::invalid_argument if cells cannot be marked so.
inline void check_mark(CellState state, int beams) {
  if (state == CellState::unknown)
    throw std::invalid_argument("state = unknown: must be free or occupied; clear() makes cells unknown");
  if (beams < 1 || beams > kMostMarkBeams)
    throw std::invalid_argument("beams = " + std::to_string(beams) + ": must be from 1 to " +
                                std::to_string(kMostMarkBeams));
}

/// Gives the cells that a rule would forget a state, in place of what they hold.
///
/// A smallest cell gets the evidence of `beams` beams. A larger one gets what its smallest cells would have
/// together, k levels above them N^(k (D - 1)) times as much, since a split divides evidence by N^(D-1); what
/// is more than a cell remembers is lost. So that none is lost of an obstacle, occupied cells are no larger
/// than their evidence is remembered; in paper maps, whose splits keep nothing, they are smallest ones.
/// Invariant: siblings that are all marked are one marked cell, if it may be as large; so the result depends
/// on the marked space alone. Cost: O(what is marked before, and cells on the border).
template <class Tree, class Refinement, class IsSaturated, class Rule>
class Marking {
  using Cell = typename Tree::Cell;
  using Ref = typename Tree::Ref;

 public:
  /// @param state, beams checked, see check_mark().
  Marking(Tree& tree, const MapOptions& options, const Refinement& refinement,
          const IsSaturated& is_saturated, const Rule& rule, CellState state, int beams)
      : tree_(tree),
        is_saturated_(is_saturated),
        rule_(rule),
        finest_(tree.geometry().finest_level()),
        coarsest_(finest_) {
    const int coarsest = Refinement::coarsest_level(finest_);
    double worth = beams;
    marks_.push_back(mark(options, refinement, Cell{}, state, worth));
    while (coarsest_ < coarsest) {
      worth *= kChildrenAcross<Tree>;
      if (state == CellState::occupied && !may_be_larger(refinement, Cell{}, worth)) return;
      marks_.push_back(mark(options, refinement, Cell{}, state, worth));
      ++coarsest_;
    }
  }

  /// @pre the tree contains all that the rule would forget. Summaries above what changes become stale.
  void run() { descend(tree_.root()); }

 private:
  /// @returns whether anything changed.
  bool descend(const Ref& ref) {
    pace_.spend();
    const int level = ref.index.level;
    const Fate fate = rule_.fate(tree_.box(ref.index), ref.is_leaf(), level != finest_);
    if (fate == Fate::keep) return false;
    if (fate == Fate::forget && level <= coarsest_) return become(ref);
    const bool was_leaf = ref.is_leaf();
    const Cell before = was_leaf ? ref.cell() : Cell{};
    if (was_leaf) tree_.split_node(*ref.node, without_parts(before));
    bool changed = false;
    bool all_marked = level <= coarsest_;
    for (int j = 0; j < Tree::kNumChildren; ++j) {
      const Ref child = tree_.child(ref, j);
      changed = descend(child) || changed;
      all_marked = all_marked && child.is_leaf() && child.cell() == mark_of(level - 1);
    }
    if (!changed) {  // It is touched but for rounding.
      if (was_leaf) tree_.cut(*ref.node, before);
      return false;
    }
    if (all_marked) return become(ref);
    summarise(tree_, *ref.node, is_saturated_);
    return true;
  }
  bool become(const Ref& ref) {
    const Cell& cell = mark_of(ref.index.level);
    if (ref.is_leaf() && ref.cell() == cell) return false;
    tree_.cut(*ref.node, cell);
    return true;
  }
  /// @pre the level is one of cells that may be marked.
  [[nodiscard]] const Cell& mark_of(int level) const {
    return marks_[static_cast<std::size_t>(level - finest_)];
  }

  // By the kind of cell, which the third argument is of.
  [[nodiscard]] static EvidenceCell mark(const MapOptions& /*options*/, const Refinement& refinement,
                                         const EvidenceCell& /*kind*/, CellState state, double beams) {
    return refinement.model.marked(state, beams);
  }
  [[nodiscard]] static OccupancyCell mark(const MapOptions& options, const Refinement& /*refinement*/,
                                          const OccupancyCell& /*kind*/, CellState state, double beams) {
    const bool is_occupied = state == CellState::occupied;
    const double of_beam = log_odds(is_occupied ? options.probability_max : options.probability_min);
    const auto count =
        static_cast<std::uint32_t>(std::min(beams, static_cast<double>(OccupancyCell::kMaxCount)));
    OccupancyCell cell;
    cell.set_counts(is_occupied ? count : 0, is_occupied ? 0 : count);
    cell.set_log_odds(
        static_cast<float>(std::clamp(beams * of_beam, options.log_odds_min, options.log_odds_max)));
    return cell;
  }
  [[nodiscard]] static bool may_be_larger(const Refinement& refinement, const EvidenceCell& /*kind*/,
                                          double beams) {
    return refinement.model.remembers_hits(beams);
  }
  [[nodiscard]] static bool may_be_larger(const Refinement& /*refinement*/, const OccupancyCell& /*kind*/,
                                          double /*beams*/) {
    return false;
  }

  Tree& tree_;
  const IsSaturated& is_saturated_;
  const Rule& rule_;
  int finest_;
  int coarsest_;             // Level of the largest cells that are marked.
  std::vector<Cell> marks_;  // By level, from the finest.
  Pace pace_;
};

}  // namespace ndtree::detail
